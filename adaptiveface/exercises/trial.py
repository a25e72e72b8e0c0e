"""The tracker with a learner's function among its stages: a short performance with known truth, tracked twice."""

from __future__ import annotations

import functools
import time
from dataclasses import dataclass

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.mesh import rotation_vector_matrix, surface_points, transform_points
from ..geometry.rendering import ray_cast
from ..model.actor import Actor
from ..model.face_model import embedded_face_model
from ..tracking.stages import Stages
from ..tracking.tracker import FaceTracker

CAMERA = Camera(400, 320, 400.0, 400.0, 199.5, 159.5)


@dataclass(frozen=True)
class Trial:
    """Two runs of the tracker over the same frames; distances are means over the frontal region, mm.

    ``error``, ``package_error``: to the truth (NaN where none is known); ``difference``: largest distance of a vertex
    between the two runs; ``tracked`` of ``frames`` frames; ``ms``, ``package_ms``: median time of a frame;
    ``failure``: what it raised, or "".
    """

    frames: int
    tracked: int
    error: float
    package_error: float
    difference: float
    ms: float
    package_ms: float
    failure: str = ""

    @property
    def passed(self) -> bool:
        """Nothing raised, every frame tracked, as near to the truth (or to the package's run) as noise allows."""
        if self.failure or self.tracked < self.frames:
            return False
        return self.difference < 1.0 if np.isnan(self.error) else self.error < 1.1 * self.package_error + 0.02

    def __str__(self) -> str:
        if self.failure:
            return f"In the tracker it failed: {self.failure}"
        lines = [f"The tracker with it: {self.tracked} of {self.frames} frames tracked."]
        if not np.isnan(self.error):
            lines.append(f"Mean distance to the truth: {self.error:.2f} mm (the package's own: {self.package_error:.2f} mm).")
        lines.append(f"Largest difference to the package's run: {self.difference:.3f} mm.")
        lines.append(f"Time: {self.ms:.0f} ms a frame (the package's own: {self.package_ms:.0f} ms).")
        return "\n".join(lines)

    __repr__ = __str__


class BuiltInPerformance:
    """A head of the embedded model that smiles, opens its jaw and turns, with a cheek that no blendshape can make.

    Rendered to depth (noise 0.6 mm) with the 40 projected features (noise 0.4 px). ``actor`` is its exact rig.
    """

    def __init__(self, seed: int = 0) -> None:
        model = embedded_face_model()
        self.seed = seed
        neutral = model.neutral(0.7 * np.random.default_rng(seed).normal(size=min(20, len(model.identity_modes))))
        self.actor = Actor.untransferred(model, neutral)

    def truth(self, index: int) -> np.ndarray:
        """(N, 3) true vertices of a frame in the camera frame, mm."""
        actor, phase = self.actor, 0.5 - 0.5 * np.cos(2 * np.pi * index / 16)
        x = np.zeros(len(actor.blendshapes))
        for name, value in (("jawOpen", 0.35), ("mouthSmileLeft", 0.6)):
            x[list(actor.expression_names).index(name)] = value * phase
        away = np.linalg.norm((actor.neutral - [38.0, -20.0, 0.0])[:, :2], axis=1)
        cheek = 5.0 * phase * np.exp(-((away / 18.0) ** 2))[:, None] * [0.5, 0.0, 0.87] * actor.frontal[:, None]
        pose = np.eye(4)
        turn = rotation_vector_matrix(np.array([0.05 * np.sin(index / 5), 0.2 * np.sin(index / 6), 0.0]))
        pose[:3, :3], pose[:3, 3] = turn @ np.diag([1.0, -1.0, -1.0]), (6 * np.sin(index / 4), 0.0, 600.0)
        return transform_points(pose, actor.neutral + np.tensordot(x, actor.blendshapes, axes=1) + cheek)

    def read(self, index: int) -> RgbdFrame:
        """Frame ``index``, with one random seed per frame."""
        rng = np.random.default_rng([self.seed, index])
        vertices = self.truth(index)
        hits = ray_cast(CAMERA, vertices, self.actor.triangles)
        depth = np.where(hits.mask, hits.depth + 0.6 * rng.normal(size=hits.depth.shape), 0.0).astype(np.float32)
        points = surface_points(vertices, self.actor.feature_triangles, self.actor.feature_weights)
        pixels = CAMERA.project(points) + 0.4 * rng.normal(size=(len(points), 2))
        return RgbdFrame(depth, CAMERA, None, index, index / 30.0, Features2D(pixels, np.ones(len(points))))


@functools.lru_cache(maxsize=1)
def built_in_performance() -> BuiltInPerformance:
    """The one built-in performance."""
    return BuiltInPerformance()


def run_trial(stages: Stages, images, actor, parameters, frames: int) -> Trial:
    """Track with the package's own stages and with ``stages``; see :meth:`Exercise.track`."""
    performance = None
    if images is None:
        performance = built_in_performance()
        images, actor = [performance.read(index) for index in range(frames)], performance.actor
    images = images[:frames]
    package, package_ms = _run(None, images, actor, parameters)
    try:
        own, ms = _run(stages, images, actor, parameters)
    except Exception as error:  # noqa: BLE001 - whatever the learner's code raises belongs into the answer
        return Trial(len(images), 0, np.nan, np.nan, np.nan, np.nan, package_ms, f"{type(error).__name__}: {error}")
    region = actor.frontal & actor.depth_valid
    difference = max(
        float(np.linalg.norm(a.vertices - b.vertices, axis=1)[region].max()) for a, b in zip(own, package, strict=True)
    )
    own_error = package_error = np.nan
    if performance is not None:
        own_error, package_error = (_error(run, performance, region) for run in (own, package))
    return Trial(len(images), sum(result.tracked for result in own), own_error, package_error, difference, ms, package_ms)


def _run(stages: Stages | None, images, actor: Actor, parameters) -> tuple[list, float]:
    tracker = FaceTracker(actor, parameters, stages)
    results, times = [], []
    for image in images:
        start = time.perf_counter()
        results.append(tracker.track(image))
        times.append((time.perf_counter() - start) * 1e3)
    return results, float(np.median(times))  # the first frame may compile kernels


def _error(results: list, performance: BuiltInPerformance, region: np.ndarray) -> float:
    return float(
        np.mean(
            [np.linalg.norm(r.vertices - performance.truth(r.index), axis=1)[region].mean() for r in results if r.tracked]
            or [np.nan]
        )
    )
