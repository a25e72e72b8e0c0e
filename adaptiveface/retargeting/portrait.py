"""Pictures of characters by the headless renderer."""

from __future__ import annotations

import numpy as np

from ..camera import Camera
from ..mesh import rotation_vector_matrix
from ..rendering import Light, picture
from .character import Character

#: Facing the camera: head frame (y up, z out of the face) to camera frame (y down, z forward).
FACING = np.diag([1.0, -1.0, -1.0])
SKIN = (205, 170, 150)
_LIGHT = Light(ambient=0.34, head=0.40, key=0.36, specular=0.10)


def portrait(
    character: Character, vertices: np.ndarray, size: int = 480, rotation: np.ndarray | None = None, yaw: float = 0.0,
    rays: int = 2, background: tuple[int, int, int] = (255, 255, 255), zoom: float = 1.0,
) -> np.ndarray:
    """(size, size, 3) uint8: ``vertices`` (V, 3) of a character's head frame, seen from the front.

    ``rotation`` (3, 3) turns the head (head to camera, as in ``rigid``); None faces the camera; ``yaw`` degrees more;
    ``rays`` per pixel and axis: 2 for edges without steps, 1 for four times the speed.
    """
    middle, extent = framing(character)
    turn = FACING if rotation is None else rotation
    turn = turn @ rotation_vector_matrix(np.array([0.0, np.radians(yaw), 0.0]))
    distance = 4.0 * extent
    fine = rays * size
    focal = zoom * 0.92 * fine * distance / (1.12 * extent)
    camera = Camera(fine, fine, focal, focal, (fine - 1) / 2, (fine - 1) / 2)
    points = (vertices - middle) @ turn.T + [0.0, 0.0, distance]
    colours = SKIN if character.colours is None else character.colours.astype(float)
    image = picture(camera, points, character.triangles, colours, light=_LIGHT, background=background)
    if rays == 1:
        return image
    image = image.astype(np.uint32).reshape(size, rays, size, rays, 3)
    return (image.sum(axis=(1, 3)) // rays**2).astype(np.uint8)


def framing(character: Character) -> tuple[np.ndarray, float]:
    """Middle (3,) and extent, mm, of what a portrait shows."""
    low, high = character.neutral.min(axis=0), character.neutral.max(axis=0)
    return (low + high) / 2, float((high - low)[:2].max())
