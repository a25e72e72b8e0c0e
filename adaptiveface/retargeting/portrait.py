"""Draw pictures of characters with the renderer that needs no display."""

from __future__ import annotations

import numpy as np

from ..geometry.camera import Camera
from ..geometry.mesh import rotation_vector_matrix
from ..geometry.painting import lit, paint
from ..geometry.rendering import Light, picture
from .character import Character

#: Rotation of a head that faces the camera, from the head frame (y up, z out of the face) to the camera frame (y down, z
#: forward).
FACING = np.diag([1.0, -1.0, -1.0])
SKIN = (205, 170, 150)
_LIGHT = Light(ambient=0.34, head=0.40, key=0.36, specular=0.10)


def portrait(
    character: Character,
    vertices: np.ndarray,
    size: int = 480,
    rotation: np.ndarray | None = None,
    yaw: float = 0.0,
    rays: int = 2,
    background: tuple[int, int, int] = (255, 255, 255),
    zoom: float = 1.0,
) -> np.ndarray:
    """Draw a character from the front.

    Parameters
    ----------
    vertices : (V, 3)
        In the head frame, mm.
    size : int
        Width and height of the picture, px.
    rotation : (3, 3), optional
        From the head to the camera frame, as in ``head_pose``. By default, the head faces the camera.
    yaw : float
        Further turn about the vertical axis, degrees.
    rays : int
        Rays per pixel and axis: 2 smooths edges, 1 is four times as fast.
    background : (3,)
        sRGB, 0 to 255.
    zoom : float
        Magnification.

    Returns
    -------
    (size, size, 3) uint8
        RGB.
    """
    turn = FACING if rotation is None else rotation
    turn = turn @ rotation_vector_matrix(np.array([0.0, np.radians(yaw), 0.0]))
    camera, points = _view(character, vertices, rays * size, turn, zoom)
    image = picture(camera, points, character.triangles, _albedo(character), light=_LIGHT, background=background)
    if rays == 1:
        return image
    image = image.astype(np.uint32).reshape(size, rays, size, rays, 3)
    return (image.sum(axis=(1, 3)) // rays**2).astype(np.uint8)


def painted_portrait(character: Character, vertices: np.ndarray, size: int, rotation: np.ndarray) -> np.ndarray:
    """Draw as :func:`portrait` does, with one ray per pixel on white, and light computed at the vertices.

    This takes a fifth of the time, and serves for films.
    """
    camera, points = _view(character, vertices, size, rotation)
    colours = lit(points, character.triangles, _albedo(character), _LIGHT)
    return paint(camera, points, np.ascontiguousarray(character.triangles, np.int64), colours, cull=True)


def _albedo(character: Character) -> np.ndarray:
    return np.array(SKIN, float) if character.colours is None else character.colours.astype(float)


def _view(
    character: Character, vertices: np.ndarray, size: int, turn: np.ndarray, zoom: float = 1.0
) -> tuple[Camera, np.ndarray]:
    """A camera of ``size`` x ``size`` pixels that frames a character, and the vertices (V, 3) in its frame, mm."""
    middle, extent = framing(character)
    distance = 4.0 * extent
    focal = zoom * 0.92 * size * distance / (1.12 * extent)
    camera = Camera(size, size, focal, focal, (size - 1) / 2, (size - 1) / 2)
    return camera, (vertices - middle) @ turn.T + [0.0, 0.0, distance]


def framing(character: Character) -> tuple[np.ndarray, float]:
    """Middle (3,) and extent of what a portrait shows, mm."""
    low, high = character.neutral.min(axis=0), character.neutral.max(axis=0)
    return (low + high) / 2, float((high - low)[:2].max())
