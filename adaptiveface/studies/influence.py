"""Figure 5: the full pipeline beside the pipeline with single steps left out."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..evaluation.ablation import VARIANTS, run_ablations
from ..evaluation.truth import FIRST, REPEAT
from ..geometry.mesh import transform_points
from .drawing import Faces, grid
from .performances import PARAMETER_SETS, Take

TOP = 3.0
FRAMES = 60
#: The steps that the paper's figure leaves out.
SHOWN = VARIANTS[:-1]
_SHORT = {"without the adaptive space and the final deformation": "v2: without the adaptive\nspace and what follows"}


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers."""
    take = Take.performed(seed, noise, frames or FRAMES, 2)
    sensor, faces = take.sensor, Faces(take.actor, TOP)
    shown = take.liveliest(1)[0] + sensor.frames  # in the repeat
    truth = sensor.ground_truth(shown)
    pictures, titles, rows = [], [], []
    for name, parameters in PARAMETER_SETS.items():
        meshes: dict[str, tuple[np.ndarray, np.ndarray]] = {}

        def keep(variant, result, meshes=meshes):
            """Keep the mesh of the shown frame and its distance from the true surface."""
            if result.index == shown:
                meshes[variant.name] = getattr(result, variant.stage), take.distance(result, variant.stage)

        found = run_ablations(sensor, sensor, take.actor, parameters, SHOWN, stride=3, on_result=keep)
        pictures.append([faces.plain(transform_points(np.linalg.inv(truth.head_pose), truth.vertices))])
        titles.append([f"frame {shown}:\nthe true face"])
        for variant in SHOWN:
            evaluation, (mesh, distance) = found[variant.name], meshes[variant.name]
            pictures[-1].append(faces.heat(mesh, distance))
            p95 = evaluation.surface_percentiles(variant.stage, REPEAT)[1]
            words = _SHORT.get(variant.name, variant.name.replace(" the ", "\nthe ", 1))
            titles[-1].append(f"{words}\nhere {np.nanmedian(distance):.2f}, p95 {p95:.2f}")
            for performance, label in ((FIRST, "first"), (REPEAT, "repeat")):
                figures = evaluation.summary(variant.stage, performance)
                rows.append({"parameters": name, "variant": variant.name, "performance": label, **figures})
    figure = grid(pictures, titles, list(PARAMETER_SETS), TOP, "distance to the true surface, mm")
    caption = (
        f"{sensor.name}. Colour: distance of the result to the true surface in one frame; "
        "the numbers are its median in that frame and the "
        "95th percentile over the repeat of the performance, mm. The paper shows shaded meshes of a person; here the truth is "
        "known."
    )
    return caption, figure, rows
