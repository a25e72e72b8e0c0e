"""Colour pictures of the performer: skin, lips, brows, lids, irises, hair, in the light of a room."""

from __future__ import annotations

import cv2
import numpy as np

from ..camera import Camera
from ..rendering import Hits, Light, shade
from .scene import EYES, MOUTH, SKIN, TORSO, Scene


class Painter:
    """Colours of one performer; ``paint`` draws a frame."""

    def __init__(self, scene: Scene, seed: int) -> None:
        rng = np.random.default_rng([seed, 0xC010])
        tone = rng.uniform(0, 1)
        skin = np.array([236, 188, 160]) * (1 - tone) + np.array([120, 78, 58]) * tone
        colours = np.empty((len(scene.part), 3))
        colours[scene.part == SKIN] = skin
        colours[scene.part == EYES] = 235
        colours[scene.part == MOUTH] = (60, 22, 22)
        colours[scene.part == TORSO] = rng.uniform(40, 180, 3)
        self._colours, self._scene = colours, scene
        self._background = rng.uniform(120, 200) + rng.uniform(-15, 15, 3)

    def paint(self, hits: Hits, vertices: np.ndarray, camera: Camera, rng: np.random.Generator) -> np.ndarray:
        """(H, W, 3) uint8 RGB of the whole image; vertices (n, 3) of the scene in the camera frame."""
        image = np.empty((camera.height, camera.width, 3), np.uint8)
        image[:] = self._background.astype(np.uint8)
        u0, v0, u1, v1 = hits.window
        drawn = shade(
            hits, vertices, self._scene.triangles, self._colours, camera=camera, background=image[v0:v1, u0:u1], light=Light()
        )
        image[v0:v1, u0:u1] = cv2.GaussianBlur(drawn, (3, 3), 0.5)
        return image
