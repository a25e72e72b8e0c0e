"""Headless rendering: rays through the pixel centres against a triangle mesh, and plain shading. No display, no OpenGL.

Deforming meshes change every frame, so a ray tracer would spend its time rebuilding its search tree. Here each
triangle visits the few pixels it covers (a z-buffer) and intersects their rays exactly: homogeneous edge functions
(Olano & Greer 1997, "Triangle scan conversion using 2D homogeneous coordinates") give the barycentric coordinates of
the hit in space. The kernels are serial and cached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..caches.compiled import compiled
from .camera import Camera
from .mesh import vertex_normals

#: Triangles with a vertex nearer than this are left out, mm.
NEAR = 10.0
#: Triangles are larger by this barycentric share, so that rounding lets no ray through at a vertex.
EDGE_SLACK = 1e-9


@dataclass(frozen=True)
class Hits:
    """What the rays of a window hit first; h, w are the window's size.

    depth (h, w) float64 mm along z, 0 = miss; triangle (h, w) int32, -1 = miss; barycentric (h, w, 3) float64
    weights of the triangle's vertices at the hit, 0 = miss; window: u0, v0, u1, v1, pixels, the end excluded.
    """

    depth: np.ndarray
    triangle: np.ndarray
    barycentric: np.ndarray
    window: tuple[int, int, int, int]

    @property
    def mask(self) -> np.ndarray:
        """(h, w) bool: the ray hit the mesh."""
        return self.triangle >= 0

    def interpolate(self, values: np.ndarray, triangles: np.ndarray) -> np.ndarray:
        """(P, C) values at the P hits, in the order of ``mask``, from values (N, C) at the vertices."""
        hit = self.mask
        return gather(np.asarray(values, float), triangles, self.triangle[hit], self.barycentric[hit])


def covering_window(camera: Camera, vertices: np.ndarray, margin: int = 1) -> tuple[int, int, int, int]:
    """Smallest pixel window u0, v0, u1, v1 (end excluded) that holds the projected vertices (N, 3), plus a margin."""
    x, y, z = vertices[vertices[:, 2] > NEAR].T
    if len(z) == 0:
        return 0, 0, 0, 0
    u0, u1 = _span(camera.fx * x / z + camera.cx, camera.width, margin)
    v0, v1 = _span(camera.fy * y / z + camera.cy, camera.height, margin)
    return u0, v0, u1, v1


def _span(pixels: np.ndarray, size: int, margin: int) -> tuple[int, int]:
    low, high = np.clip([np.floor(pixels.min()) - margin, np.ceil(pixels.max()) + margin + 1], 0, size)
    return int(low), int(high)


def ray_cast(camera: Camera, vertices: np.ndarray, triangles: np.ndarray, window=None, cull: bool = False) -> Hits:
    """First hit of the ray through every pixel centre of a window.

    vertices (N, 3) mm in the camera frame, triangles (T, 3); ``window`` u0, v0, u1, v1 inside the image, end excluded
    (the whole image where None; only the part that the mesh covers costs time); ``cull`` passes through surfaces seen
    from behind. Raises ValueError for a window outside the image.
    """
    u0, v0, u1, v1 = (0, 0, camera.width, camera.height) if window is None else (int(w) for w in window)
    if not (0 <= u0 <= u1 <= camera.width and 0 <= v0 <= v1 <= camera.height):
        raise ValueError(f"window {window} does not lie inside the {camera.width} x {camera.height} image")
    shape = (v1 - v0, u1 - u0)
    depth, triangle, barycentric = np.zeros(shape), np.full(shape, -1, np.int32), np.zeros((*shape, 3))
    _rasterise(
        np.ascontiguousarray(vertices, np.float64),
        np.ascontiguousarray(triangles, np.int64),
        camera.fx,
        camera.fy,
        camera.cx,
        camera.cy,
        u0,
        v0,
        cull,
        depth,
        triangle,
        barycentric,
    )
    return Hits(depth, triangle, barycentric, (u0, v0, u1, v1))


@compiled
def _rasterise(vertices, triangles, fx, fy, cx, cy, u0, v0, cull, depth, triangle, barycentric):
    """Fill depth, triangle and barycentric (window-sized, cleared) with the nearest hits.

    With the ray r = (x, y, 1) and vertices p_k, w_k = r . (p_i x p_j) is linear in the pixel, the hit has weights
    w_k / sum(w), and its depth is p_0 . (p_1 x p_2) / sum(w). Edges belong to both neighbours, so no ray slips between.
    """
    height, width = depth.shape
    plane = np.empty((3, 3))
    for t in range(len(triangles)):
        p = vertices[triangles[t, 0]]
        q = vertices[triangles[t, 1]]
        s = vertices[triangles[t, 2]]
        if p[2] < NEAR or q[2] < NEAR or s[2] < NEAR:
            continue
        up, uq, us = fx * p[0] / p[2] + cx - u0, fx * q[0] / q[2] + cx - u0, fx * s[0] / s[2] + cx - u0
        vp, vq, vs = fy * p[1] / p[2] + cy - v0, fy * q[1] / q[2] + cy - v0, fy * s[1] / s[2] + cy - v0
        first_u, last_u = max(0, math.ceil(min(up, uq, us))), min(width - 1, math.floor(max(up, uq, us)))
        first_v, last_v = max(0, math.ceil(min(vp, vq, vs))), min(height - 1, math.floor(max(vp, vq, vs)))
        if first_u > last_u or first_v > last_v:
            continue
        _cross(q, s, plane[0])
        _cross(s, p, plane[1])
        _cross(p, q, plane[2])
        volume = p[0] * plane[0, 0] + p[1] * plane[0, 1] + p[2] * plane[0, 2]
        if volume == 0.0 or (cull and volume > 0.0):
            continue
        if volume < 0.0:
            volume = -volume
            plane *= -1.0
        for v in range(first_v, last_v + 1):
            y = (v + v0 - cy) / fy
            a0 = plane[0, 1] * y + plane[0, 2]
            a1 = plane[1, 1] * y + plane[1, 2]
            a2 = plane[2, 1] * y + plane[2, 2]
            for u in range(first_u, last_u + 1):
                x = (u + u0 - cx) / fx
                w0 = plane[0, 0] * x + a0
                w1 = plane[1, 0] * x + a1
                w2 = plane[2, 0] * x + a2
                total = w0 + w1 + w2
                slack = -EDGE_SLACK * total
                if total <= 0.0 or w0 < slack or w1 < slack or w2 < slack:
                    continue
                z = volume / total
                if triangle[v, u] < 0 or z < depth[v, u]:
                    depth[v, u] = z
                    triangle[v, u] = t
                    barycentric[v, u, 0] = w0 / total
                    barycentric[v, u, 1] = w1 / total
                    barycentric[v, u, 2] = w2 / total


@compiled
def _cross(a, b, out):
    out[0] = a[1] * b[2] - a[2] * b[1]
    out[1] = a[2] * b[0] - a[0] * b[2]
    out[2] = a[0] * b[1] - a[1] * b[0]


@compiled
def _gather(values, corners, weights):
    out = np.empty((len(corners), values.shape[1]))
    for i in range(len(corners)):
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        for k in range(values.shape[1]):
            out[i, k] = weights[i, 0] * values[a, k] + weights[i, 1] * values[b, k] + weights[i, 2] * values[c, k]
    return out


def gather(values: np.ndarray, triangles: np.ndarray, triangle: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """(P, C) values at P surface points (triangle numbers (P,), weights (P, 3)) from values (N, C) at the vertices."""
    return _gather(np.ascontiguousarray(values), triangles[triangle], np.ascontiguousarray(weights))


@dataclass(frozen=True)
class Light:
    """Soft ambient light, a light at the camera and one key light; the shares are those of a matt white surface.

    ``key_direction`` (3,): camera frame, from the surface to the light.
    """

    ambient: float = 0.30
    head: float = 0.45
    key: float = 0.30
    key_direction: tuple[float, float, float] = (-0.45, -0.75, -0.5)
    specular: float = 0.06
    shininess: float = 18.0


def unit(vectors: np.ndarray) -> np.ndarray:
    """(P, 3) vectors of length 1."""
    return vectors / np.maximum(np.sqrt(np.einsum("pd,pd->p", vectors, vectors)), 1e-9)[:, None]


def irradiance(normals: np.ndarray, towards_camera: np.ndarray, light: Light) -> tuple[np.ndarray, np.ndarray]:
    """Diffuse (P,) and specular (P,) share of the light for unit normals and unit directions to the camera, (P, 3).

    Normals that point away from the camera are turned round, so that open meshes show both sides (Blinn-Phong).
    """
    facing = np.einsum("pd,pd->p", normals, towards_camera)
    normals = normals * np.where(facing < 0, -1.0, 1.0)[:, None]
    facing = np.abs(facing)
    key = np.asarray(light.key_direction, float)
    key = key / np.linalg.norm(key)
    # A wrapped cosine stands for the light that skin scatters into the shadow.
    wrapped = np.clip((normals @ key + 0.35) / 1.35, 0, None)
    diffuse = light.ambient + light.head * facing + light.key * wrapped
    half = unit(towards_camera + key)
    specular = light.specular * np.clip(np.einsum("pd,pd->p", normals, half), 0, 1) ** light.shininess
    return diffuse, specular


def seen_surface(hits: Hits, vertices: np.ndarray, triangles: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Smooth normals and directions to the camera (P, 3), unit vectors of the P hits (in the order of ``hits.mask``)."""
    normals = hits.interpolate(vertex_normals(vertices, triangles), triangles)
    v, u = np.nonzero(hits.mask)
    u0, v0 = hits.window[:2]
    ray = np.stack([(u + u0 - camera.cx) / camera.fx, (v + v0 - camera.cy) / camera.fy, np.ones(len(u))], axis=1)
    return unit(normals), unit(-ray)


def illuminate(
    hits: Hits, vertices: np.ndarray, triangles: np.ndarray, albedo: np.ndarray, camera: Camera, light: Light, gloss=1.0
) -> np.ndarray:
    """(P, 3) lit colours, 0..255 and above, of the P hits (in the order of ``hits.mask``) with smooth normals.

    vertices (N, 3) in the camera frame, triangles (T, 3): the mesh of the hits; albedo (P, 3) or (3,) in 0..255; gloss:
    factor of the specular light, a number or (P,).
    """
    diffuse, specular = irradiance(*seen_surface(hits, vertices, triangles, camera), light)
    return albedo * diffuse[:, None] + 255 * (gloss * specular)[:, None]


def shade(
    hits: Hits,
    vertices: np.ndarray,
    triangles: np.ndarray,
    colours=(205, 170, 150),
    *,
    camera: Camera,
    limits: tuple[float, float] | None = None,
    colourmap: str = "viridis",
    light: Light | None = None,
    background=(255, 255, 255),
) -> np.ndarray:
    """(h, w, 3) uint8 picture of what ``ray_cast`` hit, with smooth normals.

    vertices (N, 3), triangles (T, 3): the mesh of the hits; ``colours``: one RGB triple in 0..255, (N, 3) of them, or
    (N,) scalars shown with a Matplotlib ``colourmap`` between ``limits`` (a heat map; NaN is grey); ``background``:
    RGB, or an (h, w, 3) image to draw over.
    """
    h, w = hits.depth.shape
    image = np.empty((h, w, 3), np.uint8)
    image[:] = np.asarray(background, np.uint8)
    hit = hits.mask
    if not hit.any():
        return image
    colours = np.asarray(colours, float)
    if colours.ndim == 1 and len(colours) == len(vertices):
        colours = heat_map(colours, limits, colourmap)
    albedo = colours[:3] if colours.ndim == 1 else hits.interpolate(colours, triangles)
    lit = illuminate(hits, vertices, triangles, albedo, camera, light or Light())
    image[hit] = np.clip(lit, 0, 255).astype(np.uint8)
    return image


def heat_map(values: np.ndarray, limits: tuple[float, float] | None = None, colourmap: str = "viridis") -> np.ndarray:
    """(N, 3) RGB in 0..255 of scalars (N,) between ``limits`` (their range where None); NaN is grey."""
    from matplotlib import colormaps

    values = np.asarray(values, float)
    finite = np.isfinite(values)
    low, high = limits if limits is not None else (values[finite].min(initial=0), values[finite].max(initial=1))
    scaled = np.clip((np.where(finite, values, low) - low) / max(high - low, 1e-12), 0, 1)
    rgb = colormaps[colourmap](scaled)[:, :3] * 255
    rgb[~finite] = 160
    return rgb


def picture(camera: Camera, vertices: np.ndarray, triangles: np.ndarray, colours=(205, 170, 150), **options) -> np.ndarray:
    """(H, W, 3) uint8 whole image of a mesh in the camera frame; options as in :func:`shade`."""
    hits = ray_cast(camera, vertices, triangles, cull=True)
    return shade(hits, vertices, triangles, colours, camera=camera, **options)
