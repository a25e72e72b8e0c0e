"""Make the pictures of the docs from a synthetic performance: ``python docs/make_pictures.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

from adaptiveface.camera import Camera  # noqa: E402
from adaptiveface.evaluation.metrics import surface_distance  # noqa: E402
from adaptiveface.mesh import transform_points  # noqa: E402
from adaptiveface.parameters import Parameters  # noqa: E402
from adaptiveface.pipeline import capture_from, one_blas_thread  # noqa: E402
from adaptiveface.rendering import picture  # noqa: E402
from adaptiveface.synthetic.sensor import SyntheticSensor  # noqa: E402
from adaptiveface.tracking.tracker import FaceTracker  # noqa: E402

PICTURES = Path(__file__).parent / "pictures"
CAMERA = Camera(420, 520, 1100.0, 1100.0, 209.5, 270.0)
GREY = (225, 225, 225)
TOP = 2.0  # mm, end of the colour scale


def head_on(vertices: np.ndarray) -> np.ndarray:
    """Head-frame vertices before the camera of the pictures."""
    return vertices * [1.0, -1.0, -1.0] + [0.0, -15.0, 560.0]


def stages(actor, results, sensor) -> None:
    """One frame, stage by stage: the mesh, and its distance to the true surface."""
    frontal = actor.frontal & actor.depth_valid
    repeat = [r for r in results[len(results) // 2 :] if r.tracked]
    best = max(repeat, key=lambda r: r.anchor_distance)
    truth = sensor.ground_truth(best.index).vertices
    figure, axes = plt.subplots(1, 6, figsize=(13, 3.2), layout="constrained")
    frame = sensor.read(best.index)
    u, v, right, bottom = frame.features.bounding_box.astype(int) + [-45, -75, 45, 45]
    axes[0].imshow(frame.colour[max(v, 0) : bottom, max(u, 0) : right])
    axes[0].set_title("colour image")
    straight = transform_points(np.linalg.inv(best.rigid), truth)
    axes[1].imshow(picture(CAMERA, head_on(straight), actor.triangles, background=GREY))
    axes[1].set_title("true surface")
    for axis, name, what in zip(axes[2:], ("v1", "v2", "v3", "v4"),
                                ("blendshapes", "Laplacian", "adaptive space", "final"), strict=True):  # fmt: skip
        mesh = getattr(best, name)
        distance = np.full(len(mesh), np.nan)
        distance[frontal] = surface_distance(best.in_camera(mesh), truth, actor.triangles, frontal)
        axis.imshow(picture(CAMERA, head_on(mesh), actor.triangles, distance, limits=(0, TOP), background=GREY))
        axis.set_title(f"{name}: {what}\nmedian {np.nanmedian(distance):.2f} mm")
    for axis in axes:
        axis.axis("off")
    scale = plt.cm.ScalarMappable(plt.Normalize(0, TOP), "viridis")
    figure.colorbar(scale, ax=axes, label="distance to the true surface, mm", shrink=0.8)
    figure.savefig(PICTURES / "stages.png", dpi=110)


def correctives(actor, model, count: int = 5) -> None:
    """The neutral face with each corrective shape added, its largest displacement scaled to 8 mm."""
    figure, axes = plt.subplots(1, count + 1, figsize=(12, 3.0), layout="constrained")
    axes[0].imshow(picture(CAMERA, head_on(actor.neutral), actor.triangles, background=GREY))
    axes[0].set_title("neutral")
    for k, axis in enumerate(axes[1:]):
        shape = np.zeros_like(actor.neutral)
        shape[actor.frontal] = model.correctives[:, k].reshape(-1, 3)
        size = np.linalg.norm(shape, axis=1)
        mesh = actor.neutral + 8.0 / size.max() * shape
        axis.imshow(picture(CAMERA, head_on(mesh), actor.triangles, size / size.max(), limits=(0, 1), background=GREY))
        axis.set_title(f"corrective {k + 1}")
    for axis in axes:
        axis.axis("off")
    figure.savefig(PICTURES / "correctives.png", dpi=110)


def learning(results) -> None:
    """Figure 11: distance of the final mesh from both spaces, frame by frame."""
    figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
    for name, style in (("anchor_distance", "--"), ("adaptive_distance", "-")):
        axis.plot([getattr(r, name) for r in results], style, label=name.replace("_distance", " space"))
    axis.axvline(len(results) / 2, color="0.6", linewidth=1)
    axis.set(xlabel="frame (the same expressions again from the line on)", ylabel="mean distance, mm")
    axis.legend()
    figure.savefig(PICTURES / "learning.png", dpi=110)


def main() -> None:
    """Capture, track and draw performer 3."""
    PICTURES.mkdir(exist_ok=True)
    sensor = SyntheticSensor(3, frames=90)
    actor = capture_from(sensor, neutral_frames=sensor.neutral_frames)
    tracker = FaceTracker(actor, Parameters())
    with one_blas_thread():
        results = [tracker.track(sensor.read(index)) for index in range(len(sensor))]
    performance = results[sensor.neutral_frames :]
    stages(actor, performance, sensor)
    correctives(actor, tracker.model)
    learning(performance)


if __name__ == "__main__":
    main()
