"""Parameters of section 3: fusion of the depth frames, identity fit, shrink-wrap."""

from __future__ import annotations

from dataclasses import dataclass

from ..renamed import renamed
from .stages import Stage, parameter


@renamed
@dataclass(frozen=True)
class FusionParameters(Stage):
    """Section 3: registration of the neutral depth frames and their volumetric integration."""

    voxel: float = parameter(2.0, "grid spacing of the volume", unit="mm", section="3", low=0.5, high=10)
    truncation: float = parameter(
        5.0, "signed distances saturate at this many voxels", unit="voxels", section="3", low=2, high=20
    )
    margin: float = parameter(
        35.0, "the volume reaches this far around the model's frontal region", unit="mm", section="3", low=5, high=200
    )
    passes: int = parameter(
        2,
        "passes over the frames: the first grows the model, later ones align to all of it",
        section="3",
        low=1,
        high=10,
    )
    iterations: int = parameter(20, "most ICP steps for one frame", section="3", low=1, high=100)
    icp_points: int = parameter(6000, "model points used by ICP", section="3", low=500, high=100000)
    max_correspondence_distance: float = parameter(
        25.0, "correspondences farther away are dropped", unit="mm", section="3", low=1, high=200
    )
    max_normal_angle: float = parameter(
        40.0, "largest angle between the normals of a correspondence", unit="degrees", section="3", low=5, high=90
    )
    min_cosine: float = parameter(
        0.25, "depth seen at a smaller cosine of the viewing angle is not used", section="3", low=0, high=0.9
    )
    max_residual: float = parameter(
        3.0, "a frame whose median residual is larger is left out", unit="mm", section="3", low=0.1, high=20
    )
    min_overlap: float = parameter(
        0.3, "a frame that meets a smaller share of the visible model is left out", section="3", low=0, high=1
    )
    min_views: float = parameter(2.0, "scan points need this much accumulated view weight", section="3", low=0, high=100)


@renamed
@dataclass(frozen=True)
class FitParameters(Stage):
    """Section 3: rigid pose and identity coefficients on the merged scan."""

    modes: int = parameter(50, "identity modes used, at most those of the model", section="3", low=0, high=500)
    iterations: int = parameter(25, "rounds of correspondence search and solve", section="3", low=1, high=200)
    scan_sigma: float = parameter(
        1.0,
        "expected point-to-plane distance of the model to the scan",
        unit="mm",
        section="3",
        low=0.05,
        high=20,
        log=True,
    )
    samples: float = parameter(
        500.0,
        "independent observations in the scan: its points are correlated",
        section="3",
        low=10,
        high=100000,
        log=True,
    )
    feature_sigma: float = parameter(
        1.0,
        "expected distance of a model feature from its viewing ray",
        unit="mm",
        section="3",
        low=0.1,
        high=50,
        log=True,
    )
    detail: float = parameter(
        0.85,
        "size of the smooth detail that no identity mode holds, as a share of what the modes leave to the scan; 0: modes alone",
        section="3",
        low=0,
        high=10,
        paper=0.0,
    )
    hair: float = parameter(
        4.0,
        "what stands out farther from the fitted head, and reaches into the face from outside, is hair; 0 keeps it",
        unit="mm",
        low=0,
        high=100,
        paper=0.0,
    )
    contour: bool = parameter(
        True,
        "the detector's landmarks on chin, jaw and cheeks count where the head is far from them",
        section="3",
        paper=False,
    )
    expression: bool = parameter(
        True,
        "a smile or another expression that the detector sees in the neutral frames is taken off",
        section="3",
        paper=False,
    )
    max_correspondence_distance: float = parameter(
        20.0, "correspondences farther away are dropped at the start", unit="mm", section="3", low=1, high=200
    )
    max_normal_angle: float = parameter(
        45.0, "largest angle between the normals of a correspondence", unit="degrees", section="3", low=5, high=90
    )


@renamed
@dataclass(frozen=True)
class ShrinkWrapParameters(Stage):
    """Section 3: non-rigid ICP for what the identity modes cannot hold (Li et al. 2009)."""

    node_spacing: float = parameter(
        16.0, "distance between the nodes of the deformation graph", unit="mm", section="3", low=3, high=60
    )
    iterations: int = parameter(8, "rounds of correspondence search and graph solve", section="3", low=0, high=200)
    rigidity_start: float = parameter(
        100.0, "weight of the rigidity of the nodes at first", section="3", low=0, high=1e6, log=True
    )
    rigidity_end: float = parameter(0.3, "weight of the rigidity of the nodes at last", section="3", low=0, high=1e6, log=True)
    smoothness: float = parameter(
        0.1,
        "smoothness of neighbouring nodes, as a share of the rigidity weight",
        section="3",
        low=0,
        high=100,
        log=True,
    )
    feature_weight: float = parameter(
        2.0, "weight of a 2D feature against one scan correspondence", section="3", low=0, high=1000, log=True
    )
    contour: bool = parameter(
        True,
        "the detector's landmarks on chin, jaw and cheeks count where the head is far from them",
        section="3",
        paper=False,
    )
    feature_shift: float = parameter(
        4.0,
        "a feature may move this far on the surface to where the person's neutral shows it",
        unit="mm",
        section="3",
        low=0,
        high=20,
    )
    contact_weight: float = parameter(
        4.0, "lips that touch in the model stay together: weight of a pair", section="3", low=0, high=1000, log=True
    )
    detail_iterations: int = parameter(3, "rounds of the fine per-vertex step", section="3", low=0, high=50)
    detail_smoothness: float = parameter(1.0, "smoothness of the fine step", section="3", low=1e-4, high=1e4, log=True)
    noise: float = parameter(
        0.07,
        "a scan with more noise than this is smoothed more, by its square; 0 smooths all alike",
        unit="mm",
        low=0,
        high=10,
        paper=0.0,
    )
    max_correspondence_distance: float = parameter(
        8.0, "correspondences farther away are dropped", unit="mm", section="3", low=0.5, high=100
    )
    max_normal_angle: float = parameter(
        40.0, "largest angle between the normals of a correspondence", unit="degrees", section="3", low=5, high=90
    )
