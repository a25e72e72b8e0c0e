"""Figure 8: the tracked face's coefficients drive other faces."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..evaluation.coefficients import known_performance
from ..geometry.mesh import transform_points
from ..retargeting import BUILT_IN
from ..retargeting.arkit import arkit_weights
from ..retargeting.loading import load_character
from ..retargeting.portrait import portrait
from ..synthetic.sensor import SyntheticSensor
from .drawing import BACKDROP, Faces, grid
from .performances import NEUTRAL_FRAMES, PARAMETER_SETS, Take, track

FRAMES, EXPRESSIONS, SIZE = 60, 3, 230
_YAW = 14.0


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers."""
    sensor = SyntheticSensor(seed, noise, NEUTRAL_FRAMES, frames or FRAMES, 1, colour=False)
    take = Take.of(sensor)
    known, truth = known_performance(sensor, sensor.frames, NEUTRAL_FRAMES)
    take = Take(known, take.actor)
    names = [str(name) for name in take.actor.expression_names]
    order = [known.performer.model.generic_names.index(name) for name in names]
    shown, rows, found = take.liveliest(EXPRESSIONS, apart=sensor.frames // 5), [], {}
    for name, result, _ in track(take):
        if result.tracked and result.index >= NEUTRAL_FRAMES:
            count = len(result.coefficients)
            true = truth[result.index - NEUTRAL_FRAMES, order][:count]
            values = zip(names, true, result.coefficients_initial, result.coefficients, strict=False)
            rows += [
                {"parameters": name, "frame": result.index, "expression": n, "true": t, "initial": i, "re-solved": r}
                for n, t, i, r in values
            ]
            if result.index in shown:
                found[name, result.index] = result
    faces, table, characters = Faces(take.actor, 1.0, (SIZE, SIZE)), arkit_weights(names), [load_character(n) for n in BUILT_IN]
    pictures: list[list[np.ndarray | None]] = []
    titles: list[list[str]] = []
    for index in shown:
        face = known.ground_truth(index)
        pictures.append([faces.plain(transform_points(np.linalg.inv(face.head_pose), face.vertices))])
        titles.append(["the true face"])
        for name in PARAMETER_SETS:
            kept = found.get((name, index))
            coefficients = np.zeros(len(names))
            if kept is not None:
                coefficients[: len(kept.coefficients)] = kept.coefficients
            pictures[-1].append(None if kept is None else faces.plain(kept.v4))
            titles[-1].append(f"{name}: v4")
            for character in characters:
                shape = character.shape(character.weights(table.curves(coefficients[None]))[0])
                pictures[-1].append(portrait(character, shape, SIZE, yaw=_YAW, background=BACKDROP))
                titles[-1].append(character.name)
    figure = grid(pictures, titles, [f"frame {index}" for index in shown])
    errors = "; ".join(f"{name} {_rms(rows, name, 'initial')} and {_rms(rows, name, 're-solved')}" for name in PARAMETER_SETS)
    caption = (
        f"{known.name}, who performs known coefficients. The re-solved coefficients (section 6) drive three characters. Root "
        f"mean square error of the initial and of the re-solved coefficients: {errors}."
    )
    return caption, figure, rows


def _rms(rows: list[dict], name: str, kind: str) -> str:
    errors = [row[kind] - row["true"] for row in rows if row["parameters"] == name]
    return f"{np.sqrt(np.mean(np.square(errors))):.3f}"
