"""Name the callables that make a tracker's stages, so that any stage can be replaced."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..model.actor import Actor
from ..model.skin import Skin
from ..parameters import (
    AdaptivePcaParameters,
    BlendshapeParameters,
    KalmanParameters,
    PersonalBlendshapesParameters,
    RefinementParameters,
    RigidParameters,
    SkinParameters,
)
from .adaptive_pca import AdaptiveModel
from .dense_skin import DenseSkin
from .expression import BlendshapeFit
from .feature_refinement import FeatureRefinement
from .kalman import CoefficientFilter
from .laplacian import LaplacianDeformation
from .personal_blendshapes import PersonalBlendshapes
from .region import FrontalRegion
from .rigid import RigidTracker


@dataclass(frozen=True)
class Stages:
    """The callables that make each stage from the actor and from the stage's own parameters.

    A tracker makes its stages when it is created, and makes a stage again when that stage's parameters change::

        FaceTracker(actor, parameters, Stages(rigid=MyRigidTracker))

    Attributes
    ----------
    rigid : (vertex weights (n,), parameters) -> RigidTracker
        Section 4.1.
    blendshapes : (actor, parameters) -> BlendshapeFit
        Section 4.2, and the re-solve of section 6.
    kalman : (parameters) -> CoefficientFilter
        Section 4.2, last paragraph.
    deformation, final_deformation : (actor, w1, w2) -> LaplacianDeformation
        Sections 4.3 and 4.4. Other weights reach an existing stage through its ``reweighted``.
    adaptive_pca : (actor, blendshapes (A, N, 3), parameters) -> AdaptiveModel
        Sections 4.3 and 5.
    personal_blendshapes : (expressions (A, n, 3) over the frontal region, parameters, their names) -> PersonalBlendshapes
        Not in the paper; made only if they are on.
    refinement : (actor, parameters) -> FeatureRefinement
        Not in the paper; made only for an actor whose appearance is known.
    skin : (skin, frontal region, deformation, parameters) -> DenseSkin
        Not in the paper; made only for an actor whose skin is known.
    """

    rigid: Callable[[np.ndarray, RigidParameters], RigidTracker] = RigidTracker
    blendshapes: Callable[[Actor, BlendshapeParameters], BlendshapeFit] = BlendshapeFit
    kalman: Callable[[KalmanParameters], CoefficientFilter] = CoefficientFilter
    deformation: Callable[[Actor, float, float], LaplacianDeformation] = LaplacianDeformation.of
    final_deformation: Callable[[Actor, float, float], LaplacianDeformation] = LaplacianDeformation.of
    adaptive_pca: Callable[[Actor, np.ndarray, AdaptivePcaParameters], AdaptiveModel] = AdaptiveModel
    personal_blendshapes: Callable[[np.ndarray, PersonalBlendshapesParameters, Sequence[str]], PersonalBlendshapes] = (
        PersonalBlendshapes
    )
    refinement: Callable[[Actor, RefinementParameters], FeatureRefinement] = FeatureRefinement
    skin: Callable[[Skin, FrontalRegion, LaplacianDeformation, SkinParameters], DenseSkin] = DenseSkin
