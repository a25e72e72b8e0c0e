"""The parameters that a saved result was tracked with, for re-solving its coefficients as the tracker did (section 6)."""

from __future__ import annotations

from ..parameters import BlendshapeParameters, Parameters
from ..result import Result


def blendshape_parameters(result: Result) -> BlendshapeParameters:
    """The parameters of the blendshape fit with which a result was tracked. Raises :class:`ParameterError`."""
    stages = Parameters.stored(result.parameters)
    return Parameters().replace(**{f"blendshapes.{name}": v for name, v in stages.get("blendshapes", {}).items()}).blendshapes
