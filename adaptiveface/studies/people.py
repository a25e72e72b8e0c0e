"""Figure 10: more people, each beside a tracker that does not adapt, and as another character."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..errors import TrackingError
from ..geometry.mesh import transform_points
from ..parameters import Parameters
from ..report.pictures import face_view
from ..retargeting.arkit import arkit_weights
from ..retargeting.loading import load_character
from ..retargeting.portrait import portrait
from ..synthetic.sensor import SyntheticSensor
from .drawing import BACKDROP, SIZE, Faces, grid
from .performances import NEUTRAL_FRAMES, Take, track

TOP = 3.0
FRAMES, PEOPLE = 40, 4
CHARACTER, YAW = "hag", 14.0
DEFAULTS = {"our defaults": Parameters()}


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers; the people are the performers ``seed`` to ``seed + PEOPLE - 1``."""
    pictures, titles, labels, rows = [], [], [], []
    for person in range(seed, seed + PEOPLE):
        take = Take.of(SyntheticSensor(person, noise, NEUTRAL_FRAMES, frames or FRAMES, 2))
        shown = take.liveliest(1)[0] + take.sensor.frames  # in the repeat
        for _, result, _ in track(take, DEFAULTS):
            if not result.tracked or result.index < NEUTRAL_FRAMES + take.sensor.frames:
                continue
            distances = {stage: take.distance(result, stage) for stage in ("v1", "v4")}
            for stage, values in distances.items():
                median, p95 = np.nanpercentile(values, [50, 95])
                numbers = {"median_mm": float(median), "p95_mm": float(p95)}
                rows.append({"performer": person, "frame": result.index, "stage": stage, **numbers})
            if result.index == shown:
                drawn, words = _row(take, result, distances)
                pictures.append(drawn)
                titles.append(words)
                labels.append(f"performer {person}")
    if not pictures:
        raise TrackingError(f"performers {seed} to {person}: every chosen frame was lost; another seed, or more frames")
    figure = grid(pictures, titles, labels, TOP, "distance to the true surface, mm")
    means = "; ".join(f"{stage} {_mean(rows, stage):.2f}" for stage in ("v1", "v4"))
    caption = (
        f"{len(labels)} performers, {noise} noise, one frame of the second time each. The blendshape fit v1 stands for "
        "trackers that stay within their shapes; the paper compares with Weise et al. 2011, whose system is not available. "
        f"Mean over performers and frames of the 95th percentile of the distance to the true surface, mm: {means}."
    )
    return caption, figure, rows


def _row(take: Take, result, distances: dict[str, np.ndarray]) -> tuple[list[np.ndarray], list[str]]:
    """Pictures and titles of one person: input, truth, both meshes, their errors and the character."""
    faces, frame = Faces(take.actor, TOP), take.sensor.read(result.index)
    view = face_view(frame.camera, result.in_camera(result.v4)[None, take.actor.frontal], SIZE[0], SIZE[1] / SIZE[0])
    truth = take.sensor.ground_truth(result.index)
    true = transform_points(np.linalg.inv(truth.head_pose), truth.vertices)
    character = load_character(CHARACTER)
    curves = arkit_weights([str(name) for name in take.actor.expression_names]).curves(result.coefficients[None])
    driven = portrait(character, character.shape(character.weights(curves)[0]), SIZE[1], yaw=YAW, background=BACKDROP)
    edge = (SIZE[1] - SIZE[0]) // 2
    drawn = [view.crop(frame.colour, frame.depth), faces.plain(true)]
    words = ["colour", "the true face"]
    for stage, name in (("v1", "v1, blendshapes"), ("v4", "v4, output")):
        p95 = np.nanpercentile(distances[stage], 95)
        drawn += [faces.plain(getattr(result, stage)), faces.heat(getattr(result, stage), distances[stage])]
        words += [name, f"its error, p95 {p95:.2f}"]
    return [*drawn, driven[:, edge : edge + SIZE[0]]], [*words, CHARACTER]


def _mean(rows: list[dict], stage: str) -> float:
    return float(np.mean([row["p95_mm"] for row in rows if row["stage"] == stage]))
