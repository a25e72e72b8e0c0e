"""Measure the contribution of each stage, with stages left out on the same frames (the paper's figure 5)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from ..geometry.frame import RgbdFrame
from ..model.actor import Actor
from ..parameters import Parameters
from ..tracking.expression import BlendshapeFit
from ..tracking.stages import Stages
from ..tracking.tracker import FaceTracker
from ..tracking.types import TrackedFrame
from .run import ErrorCollector, Evaluation
from .truth import REPEAT, AnyTruth, GroundTruth


@dataclass(frozen=True)
class Variant:
    """A pipeline without one of its parts.

    Attributes
    ----------
    name : str
        What is left out.
    stage : str
        The mesh that is its output, "v1" to "v4".
    changes : dict
        Changed parameters by name.
    fit : bool
        Whether blendshapes are fitted. If not, the coefficients stay zero.
    """

    name: str
    stage: str = "v4"
    changes: dict = field(default_factory=dict)
    fit: bool = True


#: Figure 5 leaves out single steps, and the last two variants are our own. Variants that differ only in ``stage`` share one
#: tracker. A term is left out by the smallest weight that its parameter allows.
VARIANTS = (
    Variant("full pipeline"),
    Variant("blendshapes only", "v1"),
    Variant("without the adaptive space and the final deformation", "v2"),
    Variant("without the final deformation", "v3"),
    Variant("without the blendshape fit", fit=False),
    Variant("without the Laplacian smoothing", changes={"laplacian.w2": 1e-4, "laplacian.final_w2": 1e-4}),
    Variant(
        "without 2D features",
        changes={
            "blendshapes.w": 1e-7,
            "laplacian.feature_rows": "soft",
            "laplacian.feature_weight": 0.0,
            "laplacian.final_feature_weight": 0.0,
        },
    ),
    Variant("learning off", changes={"adaptive_pca.learn": False}),
)


def run_ablations(
    frames: Iterable[RgbdFrame],
    truth: AnyTruth,
    actor: Actor,
    parameters: Parameters | None = None,
    variants: Iterable[Variant] = VARIANTS,
    stride: int = 1,
    first: int = 0,
    on_result: Callable[[Variant, TrackedFrame], None] | None = None,
) -> dict[str, Evaluation]:
    """Track the same frames with every variant, and score its stage. The frames are read once.

    Parameters
    ----------
    frames : iterable of RgbdFrame
        The frames with their features.
    truth : GroundTruth
        The truth, or any other argument of :meth:`GroundTruth.of`.
    actor : Actor
        The rig.
    parameters : Parameters, optional
        The parameters of the full pipeline.
    variants : iterable of Variant
        The variants.
    stride, first : int
        Every ``stride``-th frame from number ``first`` on is scored.
    on_result : callable, optional
        A function that is called with every variant and its result of every frame.

    Returns
    -------
    dict
        An :class:`Evaluation` by the name of the variant.
    """
    parameters, truth, variants = parameters or Parameters(), GroundTruth.of(truth), tuple(variants)
    collectors = {variant.name: ErrorCollector(truth, actor, (variant.stage,)) for variant in variants}
    runs: dict[tuple, tuple[FaceTracker, list[Variant]]] = {}
    for variant in variants:
        key = (tuple(variant.changes.items()), variant.fit)
        if key not in runs:
            runs[key] = (_tracker(actor, parameters, variant), [])
        runs[key][1].append(variant)
    for frame in frames:
        for tracker, sharing in runs.values():
            tracked = tracker.track(frame)
            for variant in sharing:
                if (frame.index >= first and frame.index % stride == 0) or not tracked.tracked:
                    collectors[variant.name].add(tracked)
                if on_result is not None:
                    on_result(variant, tracked)
    return {name: collector.finish() for name, collector in collectors.items()}


def ablation_table(evaluations: dict[str, Evaluation], performance: int | None = REPEAT) -> str:
    """Write one line per variant: surface error, active share and the parts of the motion error, mm."""
    lines = [f"{'':<54}median  p95    active  normal  tangential  lost"]
    for name, evaluation in evaluations.items():
        row = evaluation.summary(evaluation.stages[0], performance)
        lines.append(
            f"{name:<54}{row['surface_median']:<8.3f}{row['surface_p95']:<7.3f}{row['active_share']:<8.3f}"
            f"{row['normal']:<8.3f}{row['tangential']:<12.3f}{sum(evaluation.lost.values())}"
        )
    return "\n".join(lines)


def _tracker(actor: Actor, parameters: Parameters, variant: Variant) -> FaceTracker:
    stages = Stages() if variant.fit else Stages(blendshapes=RestingFit)
    return FaceTracker(actor, parameters.replace(**variant.changes), stages)


class RestingFit(BlendshapeFit):
    """A fit that leaves the pose as it is, and the face in its neutral."""

    def fit(self, surface, features, camera, pose, *_, **__) -> tuple[np.ndarray, np.ndarray]:
        """Return ``pose`` (4, 4), and coefficients (A,) of zero."""
        return pose, np.zeros(len(self.basis))
