"""Parameters of sections 4 and 5: depth map, rigid ICP, features, blendshapes, filter, deformation, correctives."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import ParameterError
from ..renamed import renamed
from .stages import Stage, parameter


@renamed
@dataclass(frozen=True)
class DepthParameters(Stage):
    """Section 4.1: crop and noise reduction of the depth map."""

    crop: int = parameter(
        0,
        "side of a fixed face window; 0 takes the box around the last frame's model",
        unit="px",
        section="4.1",
        low=0,
        high=4000,
        paper=200,
    )
    margin: float = parameter(15.0, "border added around the model's box", unit="mm", section="4.1", low=0, high=300)
    smoothing: float = parameter(0.6, "Gaussian that reduces the depth noise", unit="px", low=0.3, high=10)
    normal_smoothing: float = parameter(
        1.4, "Gaussian under the depth gradient, from which the normals follow", unit="px", low=0.3, high=20
    )
    edge: float = parameter(20.0, "depth step between neighbouring pixels that counts as an edge", unit="mm", low=1, high=200)
    min_cosine: float = parameter(0.12, "a surface seen at a smaller cosine of the viewing angle is not used", low=0, high=0.9)


@renamed
@dataclass(frozen=True)
class RigidParameters(Stage):
    """Section 4.1: rigid ICP, loss and recovery."""

    max_correspondence_distance: float = parameter(
        25.0, "correspondences farther away are dropped", unit="mm", section="4.1", low=1, high=200
    )
    outlier_distance: float = parameter(
        5.0, "distance at which a correspondence counts half", unit="mm", low=0.1, high=1e6, log=True, paper=1e6
    )
    max_residual: float = parameter(
        3.0,
        "mean residual above which the track counts as lost (the paper's stop rule)",
        unit="mm",
        section="4.1",
        low=0.1,
        high=50,
    )
    iterations: int = parameter(
        8, "most ICP steps; the paper's 3 mm stop rule would end after one", section="4.1", low=1, high=50
    )
    min_step: float = parameter(
        0.2, "ICP ends when a step moves the face less than this", unit="mm", section="4.1", low=0, high=10, log=True
    )
    min_matches: int = parameter(150, "fewer correspondences than this and the track is lost", low=6, high=100000)
    stop: str = parameter(
        "motion",
        "ICP ends when a step moves the face little, or, as printed, once the mean distance is below ``max_residual``",
        section="4.1",
        choices=("motion", "distance"),
        paper="distance",
    )
    weights: str = parameter(
        "cosine",
        "correspondences count by the cosine of the viewing angle, or all alike",
        section="4.1",
        choices=("cosine", "equal"),
        paper="equal",
    )
    shape: str = parameter(
        "blendshapes",
        "what is aligned: the last frame's v1, or its output v4 as printed, which drifts",
        section="4.1",
        choices=("blendshapes", "output"),
    )
    half_weight_motion: float = parameter(
        4.0, "a vertex that expressions move by this much counts half", unit="mm", low=0.1, high=1e6, log=True, paper=1e6
    )
    max_reprojection_error: float = parameter(
        6.0,
        "median reprojection error of the 2D features that asks for re-alignment",
        unit="px",
        section="4.1",
        low=1,
        high=100,
    )


@renamed
@dataclass(frozen=True)
class BlendshapeParameters(Stage):
    """Section 4.2: bounded fit of the initial blendshapes, equations (1) and (2)."""

    A: int = parameter(23, "number of expressions used, in the order of the actor's list", section="4.2", low=1, high=512)
    w: float = parameter(5e-5, "weight of the 2D features", unit="1/px^2", section="4.2", low=1e-7, high=1e-1, log=True)
    iterations: int = parameter(3, "most rounds of correspondence search and solve", section="4.2", low=1, high=20)
    min_step: float = parameter(
        0.2, "the rounds end when one moves the face less than this", unit="mm", low=0, high=10, log=True, paper=0.0
    )
    lower: float = parameter(0.0, "lower bound of a coefficient", section="4.2", low=-1, high=0)
    upper: float = parameter(1.0, "upper bound of a coefficient", section="4.2", low=0.1, high=3)
    max_correspondence_distance: float = parameter(
        15.0, "correspondences farther away are dropped", unit="mm", low=1, high=200, paper=25.0
    )
    outlier_distance: float = parameter(
        5.0, "distance at which a correspondence counts half", unit="mm", low=0.1, high=1e6, log=True, paper=1e6
    )
    weights: str = parameter(
        "cosine",
        "correspondences count by the cosine of the viewing angle, or all alike as in equation (1)",
        section="4.2",
        choices=("cosine", "equal"),
        paper="equal",
    )
    ridge: float = parameter(10.0, "penalty on the squared coefficients", unit="mm^2", low=0, high=1e5, log=True, paper=0.0)
    expression_prior: float = parameter(
        400.0,
        "penalty, in the re-solve, on combinations of expressions that real faces do not make, times the misfit's variance",
        section="6",
        low=0,
        high=1e5,
        log=True,
        paper=0.0,
    )
    temporal: float = parameter(
        30.0, "penalty on their squared change from frame to frame", unit="mm^2", low=0, high=1e5, log=True, paper=0.0
    )
    profile_stiffness: float = parameter(
        100.0,
        "how many times stiffer than from the front the coefficients are held in a profile view",
        low=1,
        high=1e4,
        log=True,
        paper=1.0,
    )
    vertex_stride: int = parameter(
        4, "the rigid and the blendshape fit take every so many vertices", section="4.2", low=1, high=20, paper=1
    )
    sparsity: float = parameter(
        2.5,
        "what an expression must explain of v4, summed over the face, to take part in the re-solve",
        unit="mm",
        section="6",
        low=0,
        high=1e3,
        log=True,
        paper=0.0,
    )
    joint_pose: bool = parameter(True, "solve the rigid pose together with the coefficients", paper=False)


@dataclass(frozen=True)
class KalmanParameters(Stage):
    """Section 4.2, last paragraph: Kalman filter on the coefficients (Welch & Bishop 1995)."""

    process_noise: float = parameter(0.05, "process noise", section="4.2", low=1e-6, high=10, log=True)
    measurement_noise: float = parameter(0.02, "measurement noise", section="4.2", low=1e-6, high=10, log=True)
    model: str = parameter(
        "variance",
        "how the two noises are read; see tracking/kalman.py",
        section="4.2",
        choices=("variance", "acceleration", "off"),
    )


@renamed
@dataclass(frozen=True)
class LaplacianParameters(Stage):
    """Sections 4.3 and 4.4: fast Laplacian deformation, equations (3) to (7).

    ``depth_term``, ``feature_rows`` and ``weights`` hold what is printed beside what works; tracking/printed.py has the
    formulas. ``feature_weight`` and ``final_feature_weight`` belong to the ``soft`` rows; the other rows carry the weights
    of the print.
    """

    w1: float = parameter(0.1, "weight of the depth constraints", unit="1/mm^2", section="4.3", low=1e-6, high=1e3, log=True)
    w2: float = parameter(
        1.5,
        "weight of the Laplacian smoothing",
        unit="1/mm^2",
        section="4.3",
        low=1e-4,
        high=1e6,
        log=True,
        paper=100.0,
    )
    feature_weight: float = parameter(
        0.09,
        "weight of a 2D feature; the paper's rows amount to f^2, a hard constraint",
        unit="1/mm^2",
        section="4.3",
        low=0,
        high=1e6,
        log=True,
        paper=2.8e5,
    )
    depth_term: str = parameter(
        "point-to-plane",
        "depth pulls along the normal, or to the depth point itself: equation (3), solved directly",
        section="4.3",
        choices=("point-to-plane", "point-to-point"),
        paper="point-to-point",
    )
    feature_rows: str = parameter(
        "soft",
        "finite weights; or hard rows: equation (4) corrected, or as printed, where features move no vertex sideways",
        section="4.3",
        choices=("soft", "consistent", "printed"),
        paper="consistent",
    )
    weights: str = parameter(
        "energy",
        "how w1 and w2 of equation (7) enter: on energies, on rows (squared), or not at all, as its pseudo-inverse has it",
        section="4.3",
        choices=("energy", "rows", "pseudo-inverse"),
    )
    cg_iterations: int = parameter(
        1, "preconditioned conjugate-gradient steps of the depth deformation, point to plane", low=1, high=50
    )
    max_correspondence_distance: float = parameter(
        10.0, "correspondences farther away are dropped", unit="mm", low=1, high=200, paper=25.0
    )
    final_w2: float = parameter(
        5.0,
        "smoothing of the final deformation, which sees the 2D features only",
        unit="1/mm^2",
        section="4.4",
        low=1e-4,
        high=1e6,
        log=True,
        paper=100.0,
    )
    final_feature_weight: float = parameter(
        0.02, "weight of a 2D feature there", unit="1/mm^2", section="4.4", low=0, high=1e6, log=True, paper=2.8e5
    )

    @property
    def energies(self) -> tuple[float, float]:
        """The weights of the two quadratic energies of the depth deformation, by ``weights``."""
        return self._energy(self.w1), self._energy(self.w2)

    @property
    def final_energies(self) -> tuple[float, float]:
        """The same for the final deformation, which has no depth term."""
        return 0.0, self._energy(self.final_w2)

    def _energy(self, weight: float) -> float:
        return {"energy": weight, "rows": weight**2, "pseudo-inverse": 1.0}[self.weights]


@dataclass(frozen=True)
class AdaptivePcaParameters(Stage):
    """Section 5: anchors, correctives, incremental EM-PCA."""

    K: int = parameter(12, "number of corrective shapes", section="5", low=0, high=100, paper=7)
    S: int = parameter(200, "samples kept in the buffer", section="5", low=2, high=2000)
    buffer: str = parameter(
        "distinct",
        "which samples a full buffer keeps: the newest, or those that differ most from each other",
        section="5",
        choices=("newest", "distinct"),
        paper="newest",
    )
    valid_min: float = parameter(
        1.0,
        "samples with a smaller squared norm lie in the anchor space",
        unit="cm^2 per 3480 vertices",
        section="5",
        low=0,
        high=1e4,
        log=True,
    )
    valid_max: float = parameter(
        100.0,
        "samples with a larger squared norm are outliers",
        unit="cm^2 per 3480 vertices",
        section="5",
        low=0,
        high=1e6,
        log=True,
    )
    em_steps: int = parameter(2, "EM iterations for every sample", section="5", low=1, high=50)
    startup: str = parameter(
        "growing",
        "when learning starts: with the first sample, or once the buffer is full",
        section="5",
        choices=("growing", "full-buffer"),
        paper="full-buffer",
    )
    learn: bool = parameter(True, "learn at all: correctives, and personal blendshapes", section="5")
    min_coverage: float = parameter(
        0.5, "share of the frontal vertices that must have depth for a frame to be learned", low=0, high=1, paper=0.0
    )
    max_occluded: float = parameter(
        0.05,
        "share of the frontal vertices that something in front may hide in a frame to be learned",
        low=0,
        high=1,
        paper=1.0,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.valid_min > self.valid_max:
            raise ParameterError(
                f"adaptive_pca.valid_min = {self.valid_min:g} is above adaptive_pca.valid_max = {self.valid_max:g}: "
                "no sample could be learned; lower the first or raise the second"
            )


@renamed
@dataclass(frozen=True)
class RefinementParameters(Stage):
    """Detected 2D features, refined by how the neutral looks around them; not in the paper."""

    on: bool = parameter(True, "refine detected features where the neutral scan had colour", paper=False)
    radius: float = parameter(6.0, "skin around a feature that is compared", unit="mm", low=2, high=15)
    spacing: float = parameter(3.0, "distance between the samples of that skin", unit="mm", low=0.5, high=5)
    deviation: float = parameter(0.9, "standard deviation of the detector's error", unit="mm", low=0.1, high=10, log=True)
    correlation_length: float = parameter(15.0, "distance over which the detector errs alike", unit="mm", low=1, high=100)
    noise: float = parameter(4.0, "a patch fits no better than this", unit="%", low=0.5, high=50, log=True)
    rounds: int = parameter(3, "Gauss-Newton rounds at each blur", low=1, high=20)
    detect_every: int = parameter(
        1,
        "the detector looks at every so many frames while tracking is certain (2 in live tracking); "
        "between, features are predicted",
        low=1,
        high=30,
        live=2,
    )


@renamed
@dataclass(frozen=True)
class SkinParameters(Stage):
    """The whole face's colours in the Laplacian step, so that v2 follows motion within the surface; not in the paper."""

    on: bool = parameter(True, "follow the skin by the neutral's colours, where the scan had colour", paper=False)
    spacing: float = parameter(
        1.5, "distance between the samples from which the most telling are kept", unit="mm", low=0.5, high=10
    )
    samples: int = parameter(3000, "samples that are followed, the most telling first", low=10, high=8000)
    weight: float = parameter(0.4, "weight of the samples against depth, features and smoothing", low=0, high=1e3, log=True)
    noise: float = parameter(4.0, "a sample fits no better than this", unit="%", low=0.5, high=50, log=True)
    gauss_newton_steps: int = parameter(
        2, "how often a frame's colours are compared, each from the last result", low=1, high=10
    )
    cg_iterations: int = parameter(
        1, "preconditioned conjugate-gradient iterations of the depth deformation after the last of these", low=0, high=50
    )


@renamed
@dataclass(frozen=True)
class PersonalBlendshapesParameters(Stage):
    """The expressions' meshes, improved while tracking (Bouaziz et al. 2013); not in the paper."""

    on: bool = parameter(True, "improve the expressions' meshes from the tracked frames", paper=False)
    prior_deviation: float = parameter(
        0.3, "prior deviation of an expression's motion from the transferred one, as a share of it", low=0.01, high=2, log=True
    )
    noise: float = parameter(
        2.0,
        "deviation of a frame from its expressions, as if frames erred on their own",
        unit="mm",
        low=0.1,
        high=100,
        log=True,
    )
    memory: int = parameter(3000, "frames with expression after which a frame counts a third", low=10, high=1000000, log=True)
    interval: int = parameter(10, "learned frames between two updates of the meshes", low=1, high=10000, log=True)
