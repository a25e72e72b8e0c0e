"""Draw the tracked face by ray casting, without OpenGL: overlays on the colour image, heat maps, portraits of the rig."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from ..geometry.camera import Camera
from ..geometry.mesh import transform_points
from ..geometry.rendering import covering_window, heat_map, ray_cast, shade
from ..insides import Insides, make_insides

SKIN = (205, 170, 150)
_WIRE = np.array([86, 220, 233], float)
_MOUTH = (58, 34, 34)


@dataclass(frozen=True)
class View:
    """A magnified window of an image, with the ``camera`` of the magnified image and the ``window`` u0, v0, u1, v1, px."""

    camera: Camera
    window: tuple[int, int, int, int]

    def crop(self, colour: np.ndarray | None, depth: np.ndarray) -> np.ndarray:
        """(h, w, 3) uint8 magnified colour image, or a grey picture of the depth if there is no colour image."""
        u0, v0, u1, v1 = self.window
        source = depth_picture(depth) if colour is None else colour
        size = (self.camera.width, self.camera.height)
        return cv2.resize(np.ascontiguousarray(source[v0:v1, u0:u1]), size, interpolation=cv2.INTER_CUBIC)


def face_view(camera: Camera, meshes: np.ndarray, width: int, aspect: float = 1.25) -> View:
    """Choose a view that contains meshes.

    Parameters
    ----------
    camera : Camera
    meshes : (F, n, 3) array
        Vertices in the camera frame, mm.
    width : int
        Width of the view, px.
    aspect : float
        Height of the view as a multiple of its width.

    Returns
    -------
    View
    """
    u0, v0, u1, v1 = covering_window(camera, meshes.reshape(-1, 3), margin=14)
    w = min(max(u1 - u0, (v1 - v0) / aspect, 16), camera.width, camera.height / aspect)
    h = w * aspect
    u0 = int(np.clip((u0 + u1 - w) / 2, 0, camera.width - w))
    v0 = int(np.clip((v0 + v1 - h) / 2, 0, camera.height - h))
    u1, v1 = int(u0 + w), int(v0 + h)
    cropped = Camera(u1 - u0, v1 - v0, camera.fx, camera.fy, camera.cx - u0, camera.cy - v0)
    return View(_magnified(cropped, width / (u1 - u0)), (u0, v0, u1, v1))


def _magnified(camera: Camera, times: float) -> Camera:
    """The same view with ``times`` as many pixels; pixel centres stay at integers."""
    cx, cy = (camera.cx + 0.5) * times - 0.5, (camera.cy + 0.5) * times - 0.5
    size = round(camera.width * times), round(camera.height * times)
    return Camera(*size, camera.fx * times, camera.fy * times, cx, cy)


def depth_picture(depth: np.ndarray) -> np.ndarray:
    """(H, W, 3) uint8 picture of depth (H, W), mm: near is light, far is dark, and pixels without a measurement are black."""
    seen = depth > 0
    if not seen.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = np.percentile(depth[seen], [1, 80])
    grey = np.where(seen, 235 - 180 * np.clip((depth - near) / max(far - near, 1), 0, 1), 0)
    return np.repeat(grey[..., None], 3, axis=2).astype(np.uint8)


def frontal_triangles(actor) -> np.ndarray:
    """Return the (t, 3) triangles whose three vertices deform."""
    return actor.triangles[actor.frontal[actor.triangles].all(axis=1)]


def wire_overlay(background: np.ndarray, view: View, vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Draw the mesh's edges over an image (h, w, 3). The vertices (N, 3) are in the camera frame."""
    camera, times = view.camera, 3
    hits = ray_cast(_magnified(camera, times), vertices, triangles, cull=True)
    # Near an edge one barycentric weight is small. Divided by its change per pixel, it gives the distance in pixels.
    smallest = hits.barycentric.min(axis=2)
    down, right = np.abs(np.diff(smallest, axis=0)), np.abs(np.diff(smallest, axis=1))
    change = np.zeros_like(smallest)
    for steps, near, far in ((down, np.s_[:-1], np.s_[1:]), (right, np.s_[:, :-1], np.s_[:, 1:])):
        change[near] = np.maximum(change[near], steps)
        change[far] = np.maximum(change[far], steps)
    lines = np.where(hits.mask, np.clip(1.6 - smallest / np.maximum(change, 1e-6), 0, 1), 0)
    strength = cv2.resize(lines, (camera.width, camera.height), interpolation=cv2.INTER_AREA)[..., None] * 0.8
    return (background * (1 - strength) + _WIRE * strength).astype(np.uint8)


def shaded_overlay(background: np.ndarray, view: View, vertices: np.ndarray, triangles: np.ndarray, albedo=SKIN) -> np.ndarray:
    """Draw the shaded mesh over an image (h, w, 3). The albedo is (3,) or (N, 3) in 0..255."""
    hits = ray_cast(view.camera, vertices, triangles, cull=True)
    return shade(hits, vertices, triangles, albedo, camera=view.camera, background=background)


def completed(
    insides: Insides | None, head: np.ndarray, triangles: np.ndarray, colours: np.ndarray, gaze: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Add the parts inside a head to its mesh.

    Parameters
    ----------
    insides : Insides or None
        The parts. None leaves the mesh as it is.
    head : (N, 3) array
        Vertices in the head frame, mm.
    triangles : (T, 3) array
        Triangles of the mesh.
    colours : (N, 3) array
        RGB in 0..255.
    gaze : (2, 2) array, optional
        As for :meth:`Insides.at`.

    Returns
    -------
    vertices, triangles, colours
        Of the whole mesh.
    """
    if insides is None:
        return head, triangles, colours
    return (
        np.concatenate([head, insides.at(head, gaze)]),
        np.concatenate([triangles, insides.triangles + len(head)]),
        np.concatenate([colours, insides.colours]),
    )


def heat_overlay(
    background: np.ndarray, view: View, vertices: np.ndarray, triangles: np.ndarray, values: np.ndarray, limits
) -> np.ndarray:
    """Draw the shaded mesh over a darkened image. Its colours show ``values`` (N,) between ``limits``."""
    hits = ray_cast(view.camera, vertices, triangles, cull=True)
    dark = (background * 0.35).astype(np.uint8)
    return shade(hits, vertices, triangles, values, camera=view.camera, limits=limits, background=dark)


class Portraits:
    """Draws portraits of heads in the head frame on a transparent background.

    Eyes, teeth and tongue are drawn if the actor's mesh is the embedded model's.

    Parameters
    ----------
    actor : Actor
        The rig.
    size : tuple of int
        Width and height, px.
    whole : bool
        Whether to frame the whole head instead of the face.
    sampling : int
        Rays per pixel along each axis.
    """

    def __init__(self, actor, size: tuple[int, int], whole: bool = False, sampling: int = 2):
        self.actor, self.size = actor, size
        framed = actor.neutral if whole else actor.neutral[actor.frontal]
        low, high = framed.min(axis=0), framed.max(axis=0)
        self._centre = (low + high) / 2
        extent = high - low
        width = np.hypot(extent[0], extent[2]) * 0.88 if whole else extent[0] * 1.25
        width, distance = max(width, extent[1] * 1.05 * size[0] / size[1]), 900.0
        wide, tall = size[0] * sampling, size[1] * sampling
        focal = wide / width * distance
        self.camera = Camera(wide, tall, focal, focal, (wide - 1) / 2, (tall - 1) / 2)
        self._insides = make_insides(actor.neutral, actor.triangles)

    def draw(self, head: np.ndarray, values: np.ndarray | None = None, limits=None, turn: float = 0.0) -> np.ndarray:
        """Draw a head.

        Parameters
        ----------
        head : (N, 3) array
            Vertices in the head frame, mm.
        values : (N,) array, optional
            Values that colour the skin, between ``limits``.
        limits : tuple of float, optional
            Ends of the colour scale.
        turn : float
            Turn about the vertical, degrees.

        Returns
        -------
        (h, w, 4) uint8 array
            RGBA.
        """
        colours = np.tile(np.array(SKIN, float), (len(head), 1)) if values is None else heat_map(values, limits)
        vertices, triangles, colours = completed(self._insides, head, self.actor.triangles, colours)
        vertices = transform_points(self._pose(turn), vertices)
        hits = ray_cast(self.camera, vertices, triangles, cull=True)
        # Through the open mouth, rays hit the inside of the back of the head. These pixels get the dark colour of the mouth.
        inside = ray_cast(self.camera, vertices, self.actor.triangles).mask & ~hits.mask
        rgb = shade(hits, vertices, triangles, colours, camera=self.camera, background=_MOUTH)
        rgba = np.dstack([rgb, np.where(hits.mask | inside, 255, 0).astype(np.uint8)])
        return _shrink(rgba, self.size)

    def _pose(self, degrees: float) -> np.ndarray:
        """(4, 4) head to camera for a head that faces the camera, turned about the vertical by ``degrees``."""
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        pose = np.eye(4)
        pose[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ [[c, 0, s], [0, 1, 0], [-s, 0, c]]
        pose[:3, 3] = [0, 0, 900.0] - pose[:3, :3] @ self._centre
        return pose


def on_backdrop(rgba: np.ndarray, colour=(52, 58, 68)) -> np.ndarray:
    """Return a (h, w, 3) uint8 picture of an RGBA picture over a background of one colour."""
    alpha = rgba[..., 3:] / 255
    return (rgba[..., :3] * alpha + np.array(colour) * (1 - alpha)).astype(np.uint8)


def _shrink(rgba: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Area-averaged downsampling with premultiplied alpha, so that the silhouette gets no dark rim."""
    alpha = rgba[..., 3:].astype(np.float32) / 255
    premultiplied = np.dstack([rgba[..., :3] * alpha, alpha * 255])
    small = cv2.resize(premultiplied, size, interpolation=cv2.INTER_AREA)
    colours = small[..., :3] / np.maximum(small[..., 3:] / 255, 1e-6)
    return np.clip(np.rint(np.dstack([colours, small[..., 3:]])), 0, 255).astype(np.uint8)
