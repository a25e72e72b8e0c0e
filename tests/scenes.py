"""Small scenes with known truth for the tracker's tests: a head of the embedded model, ray-cast to depth."""

from __future__ import annotations

import numpy as np

from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import Features2D, RgbdFrame
from adaptiveface.geometry.mesh import rotation_vector_matrix, surface_points, transform_points
from adaptiveface.geometry.rendering import ray_cast
from adaptiveface.model.actor import Actor
from adaptiveface.model.face_model import embedded_face_model

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)


def exact_actor(identity_seed: int = 0) -> Actor:
    """A rig whose neutral and blendshapes are those that the frames are rendered from."""
    model = embedded_face_model()
    neutral = model.neutral(0.7 * np.random.default_rng(identity_seed).normal(size=20))
    return Actor.untransferred(model, neutral)


def head_pose(rotation=(0.0, 0.0, 0.0), translation=(0.0, 0.0, 600.0)) -> np.ndarray:
    """Head-to-camera pose of a head that faces the camera, turned by a rotation vector (rad) in the camera frame."""
    pose = np.eye(4)
    pose[:3, :3] = rotation_vector_matrix(np.array(rotation, float)) @ np.diag([1.0, -1.0, -1.0])
    pose[:3, 3] = translation
    return pose


def render_frame(
    actor: Actor,
    shape: np.ndarray,
    pose: np.ndarray,
    index: int = 0,
    noise: float = 0.0,
    pixel_noise: float = 0.0,
    camera: Camera = CAMERA,
) -> RgbdFrame:
    """A depth frame (Gaussian noise in mm) with the 40 projected features (noise in px); one seed per index."""
    rng = np.random.default_rng(1000 + index)
    vertices = transform_points(pose, shape)
    hits = ray_cast(camera, vertices, actor.triangles)
    depth = np.where(hits.mask, hits.depth + noise * rng.normal(size=hits.depth.shape), 0.0).astype(np.float32)
    points = surface_points(vertices, actor.feature_triangles, actor.feature_weights)
    pixels = camera.project(points) + pixel_noise * rng.normal(size=(40, 2))
    return RgbdFrame(depth, camera, None, index, index / 30.0, Features2D(pixels, np.ones(40)))


def coefficients(actor: Actor, **values: float) -> np.ndarray:
    """(A,) coefficients by expression name."""
    x = np.zeros(len(actor.blendshapes))
    for name, value in values.items():
        x[actor.expression_names.index(name)] = value
    return x


def posed_shape(actor: Actor, x: np.ndarray) -> np.ndarray:
    """(N, 3) b0 + B x."""
    return actor.neutral + np.tensordot(x, actor.blendshapes, axes=1)
