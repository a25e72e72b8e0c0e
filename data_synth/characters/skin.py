"""The skin of a character: sculpting, wrinkles, warts and colours on the tracking mesh."""

from __future__ import annotations

import numpy as np

from adaptiveface.geometry.mesh import surface_points, vertex_normals
from adaptiveface.model.face_model import FaceModel

from .recipes import Recipe, bump


class Landmarks:
    """Named points of a head ``vertices`` (V, 3) on the tracking mesh."""

    def __init__(self, model: FaceModel, vertices: np.ndarray):
        points = surface_points(vertices, model.feature_triangles, model.feature_weights)
        self._features = dict(zip(model.feature_ids.tolist(), points, strict=True))
        front = model.frontal
        middle = front & (np.abs(vertices[:, 0] - points[:, 0].mean()) < 8)
        lips, eyes = points[20:].mean(axis=0), points[8:20].mean(axis=0)
        between = middle & (vertices[:, 1] > lips[1] + 6) & (vertices[:, 1] < eyes[1])
        below = middle & (vertices[:, 1] < lips[1] - 14)
        self.nose = vertices[np.flatnonzero(between)[vertices[between, 2].argmax()]]
        self.chin = vertices[np.flatnonzero(below)[vertices[below, 2].argmax()]]
        self.scalp = vertices[vertices[:, 1].argmax()]
        self.lips, self.eyes = lips, eyes
        level = np.abs(vertices[:, 1] - self.nose[1]) < 45
        self.ears = {s: vertices[np.flatnonzero(level)[(s * vertices[level, 0]).argmax()]] for s in (1, -1)}

    def __getitem__(self, name) -> np.ndarray:
        if isinstance(name, int):
            return self._features[name]
        return self.ears[name[1]] if isinstance(name, tuple) else getattr(self, name)


def sculpt(points: np.ndarray, marks: Landmarks, recipe: Recipe) -> np.ndarray:
    """(n, 3) displacement of points (n, 3) by the recipe's fields."""
    out = np.zeros_like(points)
    for anchor, offset, radius, displacement in recipe.sculpt:
        out += bump(points, marks[anchor] + np.array(offset, float), radius)[:, None] * np.array(displacement, float)
    return out


def relief(vertices: np.ndarray, model: FaceModel, marks: Landmarks, recipe: Recipe) -> np.ndarray:
    """(V,) mm along the normal: wrinkles of the forehead and beside the eyes and mouth, and warts."""
    height = np.zeros(len(vertices))
    x, y = vertices[:, 0], vertices[:, 1]
    if recipe.wrinkles:
        brow = np.mean([marks[i] for i in range(18, 26)], axis=0)
        forehead = bump(vertices, brow + [0, 24, 0], 52)
        height -= recipe.wrinkles * 1.5 * forehead * np.clip(np.cos(2 * np.pi * (y + 0.0016 * x**2) / 13), 0, 1)
        for corner, side in ((marks[36], -1), (marks[45], 1)):
            centre = corner + [11 * side, -1, -6]
            around = np.arctan2(y - corner[1], side * (x - corner[0]))
            height -= recipe.wrinkles * 0.9 * bump(vertices, centre, 17) * np.clip(np.cos(9 * around), 0, 1)
        # Radial pleats around the mouth, up to the lips' contour.
        lips = marks.lips
        angle = np.arctan2((y - lips[1]) * 1.6, x - lips[0])
        ring = bump(vertices, lips, 48) * np.clip((np.hypot((x - lips[0]) / 27, (y - lips[1]) / 13) - 1) / 0.25, 0, 1)
        height -= recipe.wrinkles * 1.3 * ring * np.clip(np.cos(16 * angle), 0, 1) ** 2
    for anchor, offset, radius, size in recipe.warts:
        target = marks[anchor] + np.array(offset, float)
        nearest = vertices[np.linalg.norm(vertices - target, axis=1).argmin()]
        height += 0.9 * size * bump(vertices, nearest, 1.9 * radius)
    return height


def add_relief(vertices: np.ndarray, model: FaceModel, height: np.ndarray) -> np.ndarray:
    """Vertices moved along their normals by ``height`` (V,) mm."""
    return vertices + height[:, None] * vertex_normals(vertices, model.triangles)


def paint(vertices: np.ndarray, model: FaceModel, anatomy, marks: Landmarks, height: np.ndarray, recipe: Recipe):
    """(V, 3) sRGB 0..255."""
    tone = {name: np.array(value, float) for name, value in recipe.colours.items()}
    colours = np.repeat(tone["skin"][None], len(vertices), axis=0)

    def mix(weight, colour):
        """Paint over what there is, where ``weight`` (V,) says."""
        nonlocal colours
        weight = np.clip(weight, 0, 1)[:, None]
        colours = (1 - weight) * colours + weight * colour

    for side, eye in ((-1, 36), (1, 45)):
        cheek = 0.5 * (marks[eye] + marks[48 if side < 0 else 54]) + [3 * side, -4, 2]
        mix(0.7 * bump(vertices, cheek, 34), tone["blush"])
    mix(0.7 * bump(vertices, marks.nose, 22), 0.5 * tone["blush"] + 0.5 * tone["skin"])
    lid = np.clip(1 - anatomy.lid_distance / 9.0, 0, 1)
    mix(0.45 * lid, 0.72 * tone["skin"])
    mix(np.clip(1.4 - anatomy.lip_distance / 1.6, 0, 1), tone["lips"])
    mix(anatomy.inner_lip * 0.6, 0.55 * tone["lips"])
    if recipe.hair:
        mix(recipe.hair * _brows(vertices, marks), tone["hair"] * 0.8)
        mix(recipe.hair * _hairline(vertices, marks), tone["hair"])
    mix(np.clip(-height / 2.2, 0, 0.6), 0.55 * tone["skin"])
    mix(np.clip((height - 0.6) / 2.5, 0, 0.8), 0.75 * tone["blush"])
    return np.clip(colours, 0, 255)


def _brows(vertices: np.ndarray, marks: Landmarks) -> np.ndarray:
    weight = np.zeros(len(vertices))
    for chain in ((18, 19, 20, 21), (22, 23, 24, 25)):
        curve = np.array([marks[i] for i in chain])
        t = np.linspace(0, 3, 25)
        points = np.stack([np.interp(t, range(4), curve[:, k]) for k in range(3)], axis=1)
        distance = np.linalg.norm(vertices[:, None, :] - points[None], axis=2).min(axis=1)
        weight = np.maximum(weight, np.clip((5.0 - distance) / 3.0, 0, 1))
    return weight


def _hairline(vertices: np.ndarray, marks: Landmarks) -> np.ndarray:
    """Scalp behind a line from the top of the forehead over the ears to the nape."""
    brow = marks[20][1]
    top, back = marks.scalp[1], vertices[:, 2].min()
    front = marks[20][2]
    depth = (front - vertices[:, 2]) / (front - back)
    height = (vertices[:, 1] - brow) / (top - brow)
    behind = height + 1.6 * depth - 1.05
    nape = vertices[:, 1] - (marks.nose[1] - 5)
    return np.clip(behind / 0.12, 0, 1) * np.clip(nape / 10, 0, 1)
