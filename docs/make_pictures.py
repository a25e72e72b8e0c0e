"""Make the pictures of the docs from a synthetic performance: ``python docs/make_pictures.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402
import numpy as np  # noqa: E402

from adaptiveface.evaluation.metrics import surface_distance  # noqa: E402
from adaptiveface.geometry.mesh import transform_points  # noqa: E402
from adaptiveface.insides import make_insides  # noqa: E402
from adaptiveface.insides.gaze import GazeEstimator  # noqa: E402
from adaptiveface.landmarks.irises import IrisFinder  # noqa: E402
from adaptiveface.parameters import Parameters  # noqa: E402
from adaptiveface.pipeline import capture_source, one_thread  # noqa: E402
from adaptiveface.report.pictures import (  # noqa: E402
    SKIN,
    Portraits,
    completed,
    depth_picture,
    face_view,
    frontal_triangles,
    heat_overlay,
    on_backdrop,
    shaded_overlay,
)
from adaptiveface.synthetic.sensor import SyntheticSensor  # noqa: E402
from adaptiveface.tracking.tracker import FaceTracker  # noqa: E402

PICTURES = Path(__file__).parent / "pictures"
IMAGES = Path(__file__).parent / "images"
SIZE = (420, 520)  # pixels of a portrait
GREY = (225, 225, 225)
TOP = 2.0  # mm, end of the colour scale


def stages(actor, results, sensor) -> None:
    """One frame, stage by stage: the mesh, and its distance to the true surface."""
    frontal, portraits = actor.frontal & actor.depth_valid, Portraits(actor, SIZE, whole=True)
    repeat = [r for r in results[len(results) // 2 :] if r.tracked]
    best = max(repeat, key=lambda r: r.anchor_distance)
    truth = sensor.ground_truth(best.index).vertices
    figure, axes = plt.subplots(1, 6, figsize=(13, 3.2), layout="constrained")
    frame = sensor.read(best.index)
    u, v, right, bottom = frame.features.bounding_box.astype(int) + [-45, -75, 45, 45]
    axes[0].imshow(frame.colour[max(v, 0) : bottom, max(u, 0) : right])
    axes[0].set_title("colour image")
    straight = transform_points(np.linalg.inv(best.head_pose), truth)
    axes[1].imshow(on_backdrop(portraits.draw(straight), GREY))
    axes[1].set_title("true surface")
    for axis, name, what in zip(
        axes[2:], ("v1", "v2", "v3", "v4"), ("blendshapes", "Laplacian", "adaptive space", "final"), strict=True
    ):
        mesh = getattr(best, name)
        distance = np.full(len(mesh), np.nan)
        distance[frontal] = surface_distance(best.in_camera(mesh), truth, actor.triangles, frontal)
        axis.imshow(on_backdrop(portraits.draw(mesh, distance, (0, TOP)), GREY))
        axis.set_title(f"{name}: {what}\nmedian {np.nanmedian(distance):.2f} mm")
    for axis in axes:
        axis.axis("off")
    scale = plt.cm.ScalarMappable(plt.Normalize(0, TOP), "viridis")
    figure.colorbar(scale, ax=axes, label="distance to the true surface, mm", shrink=0.8)
    figure.savefig(PICTURES / "stages.png", dpi=110)


def correctives(actor, model, count: int = 5) -> None:
    """The neutral face with each corrective shape added, its largest displacement scaled to 5 mm."""
    portraits = Portraits(actor, SIZE, whole=True)
    figure, axes = plt.subplots(1, count + 1, figsize=(12, 3.0), layout="constrained")
    axes[0].imshow(on_backdrop(portraits.draw(actor.neutral), GREY))
    axes[0].set_title("neutral")
    for k, axis in enumerate(axes[1:]):
        shape = np.zeros_like(actor.neutral)
        shape[actor.frontal] = model.correctives[:, k].reshape(-1, 3)
        size = np.linalg.norm(shape, axis=1)
        mesh = actor.neutral + 5.0 / size.max() * shape
        axis.imshow(on_backdrop(portraits.draw(mesh, size / size.max(), (0, 1)), GREY))
        axis.set_title(f"corrective {k + 1}")
    for axis in axes:
        axis.axis("off")
    figure.savefig(PICTURES / "correctives.png", dpi=110)


def learning(results) -> None:
    """Figure 11: distance of the deformed mesh v2 from both spaces, frame by frame, before it is learned from."""
    figure, axis = plt.subplots(figsize=(8, 3), layout="constrained")
    for name, style in (("anchor_distance", "--"), ("adaptive_distance", "-")):
        axis.plot([getattr(r, name) for r in results], style, label=name.replace("_distance", " space"))
    axis.axvline(len(results) / 2, color="0.6", linewidth=1)
    axis.set(xlabel="frame (the same expressions again from the line on)", ylabel="mean distance, mm")
    axis.legend()
    figure.savefig(PICTURES / "learning.png", dpi=110)


def distinct(results, count: int) -> list:
    """``count`` results whose expressions differ most: each next one is farthest from those already taken."""
    meshes = np.array([r.v4 for r in results])
    chosen = [int(np.linalg.norm(meshes - meshes.mean(axis=0), axis=(1, 2)).argmax())]
    while len(chosen) < count:
        nearest = np.min([np.linalg.norm(meshes - meshes[i], axis=(1, 2)) for i in chosen], axis=0)
        chosen.append(int(nearest.argmax()))
    return [results[i] for i in sorted(chosen)]


def performance(actor, results, sensor, count: int = 7, top: float = 3.0) -> None:
    """The README's first picture: frames of the repeat; input, tracked mesh, and how far v4 lies from v1 (0 to 3 mm).

    The mesh has its own eyes, teeth and tongue; it looks where the detector sees the irises.
    """
    looking, eyes, insides = IrisFinder(), GazeEstimator(actor), make_insides(actor.neutral, actor.triangles)
    repeat = [r for r in results[len(results) // 2 :] if r.tracked]
    columns, triangles = [], frontal_triangles(actor)
    for result in distinct(repeat, count):
        frame, mesh = looking.onto(sensor.read(result.index)), result.in_camera(result.v4)
        gaze = np.nan_to_num(eyes.see(result, frame))
        skin = np.tile(np.array(SKIN, float), (len(mesh), 1))
        head, faces, colours = completed(insides, result.v4, triangles, skin, gaze)
        view = face_view(sensor.camera, mesh[None, actor.frontal], 300)
        colour = view.crop(frame.colour, frame.depth)
        added = np.linalg.norm(result.v4 - result.v1, axis=1)
        columns.append(
            [
                colour,
                view.crop(depth_picture(frame.depth), frame.depth),
                shaded_overlay(colour, view, result.in_camera(head), faces, colours),
                heat_overlay(colour, view, mesh, triangles, added, (0, top)),
            ]
        )
    looking.close()
    high = min(len(column[0]) for column in columns)
    rows = [np.hstack([image[:high] for image in row]) for row in zip(*columns, strict=True)]
    wide = rows[0].shape[1]
    figure, axes = plt.subplots(4, 1, figsize=(14, 14 * 4 * high / wide + 0.7), layout="constrained")
    for axis, row, label in zip(axes, rows, ("colour", "depth", "tracked mesh, v4", "v4 - v1"), strict=True):
        axis.imshow(row)
        axis.set(xticks=[], yticks=[], frame_on=False)
        axis.set_ylabel(label, fontsize=14)
    scale = plt.cm.ScalarMappable(plt.Normalize(0, top), "viridis")
    bar = figure.colorbar(scale, ax=axes[-1], location="bottom", aspect=60, fraction=0.05, pad=0.02)
    bar.set_label("added to the blendshape fit by deformation and correctives, mm", fontsize=14)
    figure.savefig(IMAGES / "performance.jpg", dpi=105, pil_kwargs={"quality": 85, "optimize": True})


def tracked(sensor: SyntheticSensor):
    """The captured actor, the results of the two performances, and the model that was learned."""
    actor = capture_source(sensor, neutral_frames=sensor.neutral_frames)
    tracker = FaceTracker(actor, Parameters())
    with one_thread():
        results = [tracker.track(sensor.read(index)) for index in range(len(sensor))]
    return actor, results[sensor.neutral_frames :], tracker.model


def main() -> None:
    """Capture, track and draw: performer 7 for the README's picture, performer 3 for the others."""
    PICTURES.mkdir(exist_ok=True)
    IMAGES.mkdir(exist_ok=True)
    sensor = SyntheticSensor(7, frames=240)
    performance(*tracked(sensor)[:2], sensor)
    sensor = SyntheticSensor(3, frames=90)
    actor, results, model = tracked(sensor)
    stages(actor, results, sensor)
    correctives(actor, model)
    learning(results)


if __name__ == "__main__":
    main()
