"""Colour pictures of the performer: skin, lips, brows, lids, irises, hair, in the light of a room."""

from __future__ import annotations

import cv2
import numpy as np

from ..geometry.camera import Camera
from ..geometry.mesh import surface_points, vertex_normals
from ..geometry.rendering import Hits, Light, gather, illuminate
from .makeup import BLUSH, BROWS, FRECKLES, HAIR, LASHES, LIPS, TEXTURE, make_makeup
from .scene import EYES, MOUTH, SKIN, TORSO, Scene

# Typical sRGB colours; each performer's lie between neighbours of a row.
_SKIN_TONES = np.array([[242, 203, 181], [224, 176, 146], [188, 138, 106], [132, 92, 70]], float)
_HAIR_TONES = np.array([[30, 24, 22], [62, 42, 30], [110, 78, 50], [120, 112, 106]], float)
_IRIS_TONES = np.array([[70, 44, 26], [96, 84, 48], [86, 116, 136]], float)

#: Angles at the centre of the eyeball, degrees.
_PUPIL, _IRIS = 8.5, 22.0


class Painter:
    """Colours of one performer, drawn from ``seed``; :meth:`paint` draws a frame."""

    def __init__(self, scene: Scene, seed: int, camera: Camera) -> None:
        rng = np.random.default_rng([seed, 0xC010])
        performer = scene.performer
        self._scene = scene
        self._skin, self._hair, self._iris = (_between(rng, t) for t in (_SKIN_TONES, _HAIR_TONES, _IRIS_TONES))
        self._lips = self._skin * rng.uniform([0.76, 0.5, 0.52], [0.88, 0.62, 0.66])
        self._shirt = rng.uniform(40, 190, 3)
        self._freckled = rng.uniform(0.0, 0.35)
        neutral = performer.surface(np.zeros(len(performer.expression_names)))
        normals = vertex_normals(neutral, performer.surface_triangles)
        model = performer.model
        landmarks = surface_points(performer.neutral, model.feature_triangles, model.feature_weights)
        lids = [performer.neutral[loop] for loop in performer.lid_loops]
        mouth = None if performer.mouth_loop is None else performer.neutral[performer.mouth_loop]
        fields = make_makeup(rng, neutral, normals, landmarks, lids, mouth).fields
        self._fields = np.zeros((len(scene.part), fields.shape[1]))
        self._fields[: scene.skin] = fields
        eyes = np.tile(scene.eye_directions, (len(performer.eye_radii), 1))
        self._fields[scene.part == EYES, :3] = eyes
        wall = np.linspace(1.05, 0.9, camera.height)[:, None, None] * (rng.uniform(110, 200) + rng.uniform(-12, 12, 3))
        self._background = np.broadcast_to(np.clip(wall, 0, 255), (camera.height, camera.width, 3)).astype(np.uint8)
        self._grain = rng.normal(0, 1.5, (camera.height + 64, camera.width + 64, 3)).round().astype(np.int8)

    def paint(self, hits: Hits, vertices: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
        """(H, W, 3) uint8 RGB of the whole image; vertices (n, 3) of the scene in the camera frame."""
        image = self._background.copy()
        u0, v0, u1, v1 = hits.window
        hit, triangles = hits.mask, self._scene.triangles
        struck = hits.triangle[hit]
        part = self._scene.part[triangles[struck, 2]]
        fields = gather(self._fields, triangles, struck, hits.barycentric[hit])
        albedo = np.empty((len(struck), 3))
        gloss = np.ones(len(struck))
        albedo[part == TORSO], gloss[part == TORSO] = self._shirt, 0.0
        albedo[part == MOUTH], gloss[part == MOUTH] = (70, 24, 24), 0.0
        albedo[part == EYES] = self._eye_albedo(fields[part == EYES, :3])
        albedo[part == SKIN], gloss[part == SKIN] = self._skin_albedo(fields[part == SKIN])
        lit = illuminate(hits, vertices, triangles, albedo, camera, Light(), gloss)
        drawn = image[v0:v1, u0:u1]
        drawn[hit] = np.clip(lit, 0, 255).astype(np.uint8)
        # A lens spreads a point over about a pixel; without it, edges are jagged as no camera's are.
        image[v0:v1, u0:u1] = cv2.GaussianBlur(drawn, (3, 3), 0.55)
        du, dv = rng.integers(0, 64, 2)
        grain = self._grain[dv : dv + camera.height, du : du + camera.width]
        return cv2.add(image, grain, dtype=cv2.CV_8U)

    def _skin_albedo(self, fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, 3) colour and (P,) gloss of skin pixels with makeup fields (P, 7)."""
        tint = 0.035 * fields[:, TEXTURE] + 0.02 * fields[:, BLUSH]
        colour = self._skin * (1 + tint[:, None])
        colour[:, 1:] *= 1 - 0.035 * np.clip(fields[:, BLUSH], -1, 1)[:, None]
        colour *= 1 - self._freckled * np.clip(fields[:, FRECKLES], 0, 1)[:, None] * [0.5, 0.8, 0.9]
        colour = _mix(colour, self._lips * (1 + 0.5 * tint[:, None]), _edge(fields[:, LIPS] - 0.2, 0.6))
        hair = self._hair * (1 + 0.18 * fields[:, TEXTURE, None])
        strands = fields[:, BROWS] - 0.25 * np.abs(fields[:, TEXTURE])
        colour = _mix(colour, 0.85 * hair, 0.9 * _edge(strands, 0.7))
        colour = _mix(colour, 0.35 * self._hair + 8, 0.85 * _edge(0.9 - fields[:, LASHES], 0.5))
        on_head = _edge(fields[:, HAIR], 2.0)
        return _mix(colour, hair, on_head), 1 - 0.8 * on_head

    def _eye_albedo(self, directions: np.ndarray) -> np.ndarray:
        """(P, 3) colour of eyeball pixels from directions (P, 3) in the eyeball's own frame; the gaze is +z."""
        cosine = directions[:, 2] / np.maximum(np.linalg.norm(directions, axis=1), 1e-9)
        angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
        colour = np.tile([226.0, 220.0, 216.0], (len(angle), 1))
        rim = np.clip((angle - 0.7 * _IRIS) / (0.3 * _IRIS), 0, 1)[:, None]
        colour = _mix(colour, self._iris * (1 - 0.45 * rim), _edge(_IRIS - angle, 1.5))
        return _mix(colour, np.array([14.0, 12.0, 12.0]), _edge(_PUPIL - angle, 1.5))


def _between(rng: np.random.Generator, tones: np.ndarray) -> np.ndarray:
    t = rng.uniform(0, len(tones) - 1)
    k = min(int(t), len(tones) - 2)
    return tones[k] + (t - k) * (tones[k + 1] - tones[k])


def _edge(distance: np.ndarray, softness: float) -> np.ndarray:
    return np.clip(distance / softness + 0.5, 0, 1)


def _mix(below: np.ndarray, above: np.ndarray, share: np.ndarray) -> np.ndarray:
    return below + (above - below) * share[:, None]
