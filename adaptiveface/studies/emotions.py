"""Figure 9: six emotions, tracked with the adaptive model and without any.

The paper compares with Weise et al. 2011. Their system personalises its blendshapes from at least seven example scans, and
guides the coefficients with a prior learned from recorded animation. Neither the examples nor the prior are available. The
closest substitute here is the blendshape fit alone (v1). It uses generic expressions transferred to the actor, depth, 2D
features and bounds, with a ridge and a penalty on changes in time instead of the learned prior. Like their system, it cannot
leave the span of the blendshapes. It lacks their rig from examples, which would improve it, and their prior.
"""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..evaluation.run import ErrorCollector
from ..evaluation.truth import REPEAT, GroundTruth
from ..geometry.mesh import transform_points
from .drawing import Faces, grid
from .performances import EMOTIONS, emotional, track

TOP = 3.0
FRAMES = 36
STAND_IN = "blendshapes alone (stand-in)"
#: Row of the figure -> the parameter set and the stage that it shows.
METHODS = {
    STAND_IN: ("our defaults", "v1"),
    "paper()": ("paper()", "v4"),
    "our defaults": ("our defaults", "v4"),
}


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers."""
    take, held = emotional(seed, noise, frames or FRAMES)
    truth = GroundTruth.of(take.sensor)
    collectors = {
        (method, emotion): ErrorCollector(truth, take.actor, (stage,))
        for method, (_, stage) in METHODS.items()
        for emotion in EMOTIONS
    }
    shown = {emotion: span[len(span) // 2] for emotion, span in held.items()}
    at = {index: emotion for emotion, span in held.items() for index in span}
    found = {}
    for name, result, _ in track(take):
        emotion = at.get(result.index)
        if emotion is None:
            continue
        for method, (owner, stage) in METHODS.items():
            if owner == name:
                collectors[method, emotion].add(result)
                if result.index == shown[emotion] and result.tracked:
                    found[method, emotion] = getattr(result, stage), take.distance(result, stage)
    faces = Faces(take.actor, TOP)
    true = [take.sensor.ground_truth(index) for index in shown.values()]
    pictures = [[faces.plain(transform_points(np.linalg.inv(t.head_pose), t.vertices)) for t in true]]
    titles, rows = [list(EMOTIONS)], []
    for method, (_, stage) in METHODS.items():
        pictures.append([])
        titles.append([])
        for emotion in EMOTIONS:
            figures = collectors[method, emotion].finish().summary(stage, REPEAT)
            rows.append({"method": method, "emotion": emotion, **figures})
            mesh, distance = found.get((method, emotion), (take.actor.neutral, np.full(len(take.actor.neutral), np.nan)))
            pictures[-1].append(faces.heat(mesh, distance))
            titles[-1].append(f"p95 {figures['surface_p95']:.2f} mm\nactive {figures['active_share']:.2f}")
    figure = grid(
        pictures,
        titles,
        ["true face", STAND_IN.replace(" (", "\n("), *list(METHODS)[1:]],
        TOP,
        "distance to the true surface, mm",
    )
    caption = (
        f"{take.sensor.name}. The second row is not an implementation of Weise et al. 2011. It is a substitute that also "
        "stays in the span of its blendshapes: the fit alone, with generic expressions and a penalty on change. It has neither "
        "their rig from example scans nor their learned prior. All emotions are performed twice, and the second time is shown. "
        "Above each face: 95th percentile of the distance to the true surface while the emotion is held, and the error of the "
        "motion as a share of the motion."
    )
    return caption, figure, rows
