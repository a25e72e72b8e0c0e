"""Figure 7: what the adaptive space cannot express of the same expression, while the correctives are learned."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from .drawing import Faces, grid
from .performances import PARAMETER_SETS, Take, track

TOP = 1.0
FRAMES, TIMES, EXPRESSIONS = 110, 3, 2


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers."""
    take = Take.performed(seed, noise, frames or FRAMES, TIMES)
    sensor, frontal, faces = take.sensor, take.actor.frontal, Faces(take.actor, TOP)
    shown, rows = take.liveliest(EXPRESSIONS, apart=sensor.frames // 4), []
    found: dict[tuple[str, int], tuple[np.ndarray, np.ndarray, int]] = {}
    for name, result, model in track(take):
        if not result.tracked:
            continue
        rest = np.linalg.norm(result.v2 - result.v3, axis=1)
        output = np.linalg.norm(result.v4 - result.v3, axis=1)
        rows.append(
            {
                **{"parameters": name, "frame": result.index, "updates": model.updates},
                **{"correctives": model.correctives.shape[1], "v2_from_v3_mm": float(rest[frontal].mean())},
                "v4_from_v3_mm": float(output[frontal].mean()),
            }
        )
        if (result.index - shown[0]) % sensor.frames == 0 or (result.index - shown[-1]) % sensor.frames == 0:
            found[name, result.index] = result.v3, np.where(frontal, rest, np.nan), model.updates
    times = ("first time", "second time", "third time")
    pictures: list[list[np.ndarray | None]] = []
    titles: list[list[str]] = []
    for name in PARAMETER_SETS:
        pictures.append([])
        titles.append([])
        for number, first in enumerate(shown, start=1):
            for time in range(TIMES):
                picture, words = None, "lost"
                if (name, first + time * sensor.frames) in found:
                    mesh, rest, updates = found[name, first + time * sensor.frames]
                    picture, words = faces.heat(mesh, rest), f"{updates} updates, {np.nanmean(rest):.2f} mm"
                pictures[-1].append(picture)
                titles[-1].append(f"expression {number},\n{times[time]}:\n{words}")
    figure = grid(pictures, titles, list(PARAMETER_SETS), TOP, "distance of v2 from the adaptive space, mm")
    caption = (
        f"{sensor.name}, {TIMES} times the same {sensor.frames} frames. Colour: what the adaptive space cannot express of v2, "
        "before the frame is learned from. The paper colours the distance of the output v4, which here is the 2D features' "
        "part alone (it is in the table). paper() waits for a buffer of 200 samples; the defaults learn from the first sample."
    )
    return caption, figure, rows
