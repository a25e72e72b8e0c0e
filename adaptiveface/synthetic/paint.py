"""Colour pictures of the performer: skin, lips, brows, lids, irises, hair, in the light of a room."""

from __future__ import annotations

import cv2
import numpy as np

from ..geometry.camera import Camera
from ..geometry.mesh import surface_points, vertex_normals
from ..geometry.rendering import Hits, gather, illuminate, seen_surface, unit
from .lamp import Lamp, lamp
from .look import Look
from .makeup import BLUSH, BROWS, FRECKLES, HAIR, LASHES, LIPS, TEXTURE, make_makeup
from .photographic import KINDS, PhotographicSkin, Surface, shade_photographic, to_linear
from .scene import EYES, MOUTH, SKIN, TORSO, Scene
from .video_camera import VideoCamera

# Typical sRGB colours; each performer's lie between neighbours of a row.
_SKIN_TONES = np.array([[242, 203, 181], [224, 176, 146], [188, 138, 106], [132, 92, 70]], float)
_HAIR_TONES = np.array([[30, 24, 22], [62, 42, 30], [110, 78, 50], [120, 112, 106]], float)
_IRIS_TONES = np.array([[70, 44, 26], [96, 84, 48], [86, 116, 136]], float)

#: Angles at the centre of the eyeball, degrees.
_PUPIL, _IRIS = 8.5, 22.0


#: Gloss of the wet eyes beside that of photographic skin.
_WET = 0.5


class Painter:
    """Colours of one performer, drawn from ``seed``; :meth:`paint` draws a frame, as ``look`` says.

    ``fps`` tells at what time the light in the room is which.
    """

    def __init__(self, scene: Scene, seed: int, camera: Camera, look: Look, fps: float) -> None:
        rng = np.random.default_rng([seed, 0xC010])
        performer = scene.performer
        self._scene, self._look, self._fps = scene, look, fps
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
        self._photographic = PhotographicSkin(look.skin, seed, neutral, landmarks) if look.skin in KINDS else None
        if look.skin == "even":
            fields[:, [BLUSH, TEXTURE, FRECKLES]] = 0.0
        self._makeup = fields.shape[1]
        if self._photographic is not None:
            fields = np.concatenate([fields, self._photographic.fields], axis=1)
        self._fields = np.zeros((len(scene.part), fields.shape[1]))
        self._fields[: scene.skin] = fields
        eyes = np.tile(scene.eye_directions, (len(performer.eye_radii), 1))
        self._fields[scene.part == EYES, :3] = eyes
        wall = np.linspace(1.05, 0.9, camera.height)[:, None, None] * (rng.uniform(110, 200) + rng.uniform(-12, 12, 3))
        self._background = np.broadcast_to(np.clip(wall, 0, 255), (camera.height, camera.width, 3)).astype(np.uint8)
        self._camera = VideoCamera(look.light, fps)
        self._grain = rng.normal(0, 1.5, (camera.height + 64, camera.width + 64, 3)).round().astype(np.int8)

    def paint(
        self,
        hits: Hits,
        vertices: np.ndarray,
        camera: Camera,
        rng: np.random.Generator,
        index: int,
        motion: np.ndarray,
        rotation: np.ndarray,
    ) -> np.ndarray:
        """Paint frame ``index`` as a (H, W, 3) uint8 RGB image.

        ``vertices`` (n, 3) are those of the scene in the camera frame, mm. ``motion`` (n, 3) is how far each moves from one
        frame to the next, mm. ``rotation`` (3, 3) turns the head frame to the camera frame.
        """
        room = lamp(self._look.light, index / self._fps)
        struck, fields = self._struck(hits)
        if self._photographic is None:
            lit = self._drawn(hits, struck, fields, vertices, camera, room)
        else:
            lit = self._photographed(self._photographic, hits, struck, fields, vertices, camera, room, rotation)
        image = self._background
        u0, v0, u1, v1 = hits.window
        if self._look.camera == "plain":
            image = image.copy() if self._look.light == "steady" else self._lit_background(room).astype(np.uint8)
            image[v0:v1, u0:u1] = _through_lens(image[v0:v1, u0:u1], hits.mask, np.clip(lit, 0, 255))
            du, dv = rng.integers(0, 64, 2)
            grain = self._grain[dv : dv + camera.height, du : du + camera.width]
            return cv2.add(image, grain, dtype=cv2.CV_8U)
        image = self._lit_background(room)
        image[v0:v1, u0:u1] = _through_lens(image[v0:v1, u0:u1], hits.mask, lit)
        return self._camera.develop(image, self._pixel_motion(hits, vertices, motion, camera), index, rng)

    def _struck(self, hits: Hits) -> tuple[np.ndarray, np.ndarray]:
        """Parts (P,) of the scene that the rays hit, and their fields (P, k)."""
        triangles, hit = self._scene.triangles, hits.mask
        struck = hits.triangle[hit]
        return self._scene.part[triangles[struck, 2]], gather(self._fields, triangles, struck, hits.barycentric[hit])

    def _drawn(self, hits: Hits, part: np.ndarray, fields: np.ndarray, vertices: np.ndarray, camera: Camera, room: Lamp):
        """(P, 3) colours of the hits, 0 to 255 and above, with the simple skin."""
        albedo, gloss = self._plain_parts(part, fields)
        albedo[part == SKIN], gloss[part == SKIN] = self._skin_albedo(fields[part == SKIN])
        lit = illuminate(hits, vertices, self._scene.triangles, albedo, camera, room.light, gloss)
        return lit if self._look.light == "steady" else lit * room.colour

    def _plain_parts(self, part: np.ndarray, fields: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P, 3) colour and (P,) gloss of all that is not skin."""
        albedo = np.zeros((len(part), 3))
        gloss = np.ones(len(part))
        albedo[part == TORSO], gloss[part == TORSO] = self._shirt, 0.0
        albedo[part == MOUTH], gloss[part == MOUTH] = (70, 24, 24), 0.0
        albedo[part == EYES] = self._eye_albedo(fields[part == EYES, :3])
        return albedo, gloss

    def _photographed(
        self,
        photographic: PhotographicSkin,
        hits: Hits,
        part: np.ndarray,
        fields: np.ndarray,
        vertices: np.ndarray,
        camera: Camera,
        room: Lamp,
        rotation: np.ndarray,
    ) -> np.ndarray:
        """(P, 3) colours of the hits, 0 to 255 and above, with photographic skin."""
        normals, towards = seen_surface(hits, vertices, self._scene.triangles, camera)
        facing = np.clip(np.abs(np.einsum("pd,pd->p", normals, towards)), 0.3, 1)
        footprint = hits.depth[hits.mask] / camera.fx / facing
        albedo, gloss = self._plain_parts(part, fields)
        albedo, gloss, skin = to_linear(albedo), _WET * gloss, part == SKIN
        makeup, own = fields[skin, : self._makeup], fields[skin, self._makeup :]
        albedo[skin], gloss[skin] = photographic.albedo(makeup, own, footprint[skin])
        normals[skin] = unit(normals[skin] + photographic.relief(own, footprint[skin], rotation))
        return shade_photographic(albedo, gloss, photographic, Surface(normals, towards, footprint), room)

    def _lit_background(self, room: Lamp) -> np.ndarray:
        """(H, W, 3) float32 wall in the light of the room, 0 to 255."""
        share = room.brightness / lamp("steady", 0.0).brightness
        if self._photographic is not None:
            share = share ** (1 / 2.2)
        return np.minimum(self._background * share, 255.0).astype(np.float32)

    def _pixel_motion(self, hits: Hits, vertices: np.ndarray, motion: np.ndarray, camera: Camera) -> np.ndarray:
        """(H, W, 2) px that what a pixel shows moves from one frame to the next; 0 on the wall."""
        out = np.zeros((camera.height, camera.width, 2), np.float32)
        u0, v0, u1, v1 = hits.window
        shift = camera.project(vertices + 0.5 * motion) - camera.project(vertices - 0.5 * motion)
        out[v0:v1, u0:u1][hits.mask] = hits.interpolate(shift, self._scene.triangles)
        # Edges smear over what lies beside them.
        return cv2.blur(out, (5, 5))

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


def _through_lens(window: np.ndarray, hit: np.ndarray, colours: np.ndarray) -> np.ndarray:
    """The window (h, w, 3) with ``colours`` (P, 3) where the rays ``hit`` (h, w), in its own type, as sharp as a lens is.

    A lens spreads a point over about a pixel; without it, edges are jagged as no camera's are.
    """
    drawn = window.copy()
    drawn[hit] = colours.astype(window.dtype)
    return cv2.GaussianBlur(drawn, (3, 3), 0.55)


def _between(rng: np.random.Generator, tones: np.ndarray) -> np.ndarray:
    t = rng.uniform(0, len(tones) - 1)
    k = min(int(t), len(tones) - 2)
    return tones[k] + (t - k) * (tones[k + 1] - tones[k])


def _edge(distance: np.ndarray, softness: float) -> np.ndarray:
    return np.clip(distance / softness + 0.5, 0, 1)


def _mix(below: np.ndarray, above: np.ndarray, share: np.ndarray) -> np.ndarray:
    return below + (above - below) * share[:, None]
