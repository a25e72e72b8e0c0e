"""Define every parameter of the method once, with its default, unit, range and source in the paper.

A field makes the default, the command line's ``--set stage.name=value``, the slider of the notebooks and the table in the
docs. ``Parameters()`` holds our defaults, ``Parameters.paper()`` the nearest working reading of the paper: its values, and
its formulas wherever they work. The paper notes in the docs list what is left, with what it costs.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

from .neutral import FitParameters, FusionParameters, ShrinkWrapParameters
from .stages import StageSet, stage_class
from .tracking import (
    AdaptivePcaParameters,
    BlendshapeParameters,
    DepthParameters,
    KalmanParameters,
    LaplacianParameters,
    PersonalBlendshapesParameters,
    RefinementParameters,
    RigidParameters,
    SkinParameters,
)

__all__ = [
    "AdaptivePcaParameters",
    "BlendshapeParameters",
    "DepthParameters",
    "FitParameters",
    "FusionParameters",
    "KalmanParameters",
    "LaplacianParameters",
    "Parameters",
    "PersonalBlendshapesParameters",
    "RefinementParameters",
    "RigidParameters",
    "ShrinkWrapParameters",
    "SkinParameters",
    "describe",
]


@dataclass(frozen=True)
class Parameters(StageSet):
    """All stages; frozen, so that a run can be named by its parameters."""

    fusion: FusionParameters = field(default_factory=FusionParameters)
    fit: FitParameters = field(default_factory=FitParameters)
    shrink_wrap: ShrinkWrapParameters = field(default_factory=ShrinkWrapParameters)
    depth: DepthParameters = field(default_factory=DepthParameters)
    rigid: RigidParameters = field(default_factory=RigidParameters)
    refinement: RefinementParameters = field(default_factory=RefinementParameters)
    blendshapes: BlendshapeParameters = field(default_factory=BlendshapeParameters)
    kalman: KalmanParameters = field(default_factory=KalmanParameters)
    laplacian: LaplacianParameters = field(default_factory=LaplacianParameters)
    skin: SkinParameters = field(default_factory=SkinParameters)
    adaptive_pca: AdaptivePcaParameters = field(default_factory=AdaptivePcaParameters)
    personal_blendshapes: PersonalBlendshapesParameters = field(default_factory=PersonalBlendshapesParameters)


for _field in fields(Parameters):
    stage_class(_field).stage = _field.name


def describe() -> list[dict[str, Any]]:
    """One row per parameter for tables and sliders: stage, name, default and the field's documentation."""
    return Parameters.rows()
