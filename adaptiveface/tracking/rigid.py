"""Track rigid motion (section 4.1) by fast projective point-to-plane ICP (Rusinkiewicz & Levoy 2001).

The paper's ICP "finishes when the average distance of unpruned correspondences to the depth map is below 3 mm". The test must
follow each step (``rigid.stop`` = "distance"). If it came first, a face that moves by less than 3 mm between two frames would
never be followed. Even so, ICP mostly ends after one step. Our own rule ("motion") waits until the steps are small.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ..geometry.mesh import transform_points
from ..parameters import RigidParameters
from ..registration.association import Correspondences, find_correspondences
from ..registration.icp import Iterate, icp, last
from ..registration.step import apply_rigid_update, motion_of, point_to_plane_step
from ..registration.surface import DepthSurface

#: (points (n, 3), correspondences, centre (3,), vertex weights (n,)) -> the pose update (6,).
StepSolver = Callable[[np.ndarray, Correspondences, np.ndarray, np.ndarray], np.ndarray]


@dataclass(frozen=True)
class RigidFit:
    """The result of rigid ICP.

    Attributes
    ----------
    pose : (4, 4)
        Head frame to camera frame, mm.
    residual : float
        Mean distance of the matches at that pose, mm.
    """

    pose: np.ndarray
    residual: float


class RigidTracker:
    """Aligns a head-frame shape to the depth map by a few ICP steps, until they no longer move it (section 4.1).

    Parameters
    ----------
    vertex_weights : (n,)
        Weight of each vertex. Vertices that move least in expressions should count most.
    parameters : RigidParameters
        Limits, weights and the stop rule.
    solve : callable
        Computes one step, as :func:`.point_to_plane_step` does.
    """

    def __init__(
        self, vertex_weights: np.ndarray, parameters: RigidParameters, solve: StepSolver = point_to_plane_step
    ) -> None:
        self.vertex_weights, self.parameters, self._solve = vertex_weights, parameters, solve

    def align(self, surface: DepthSurface, shape: np.ndarray, normals: np.ndarray, pose: np.ndarray) -> RigidFit:
        """Refine a pose.

        Parameters
        ----------
        surface : DepthSurface
            The depth map around the face.
        shape, normals : (n, 3)
            Points, mm, and their unit normals, head frame.
        pose : (4, 4)
            The start, head frame to camera frame, mm.

        Returns
        -------
        RigidFit
            The pose at which ICP stops.
        """
        p, middle = self.parameters, shape.mean(axis=0)

        def associate(pose: np.ndarray) -> Correspondences:
            matches = find_correspondences(surface, shape, normals, p.max_correspondence_distance, pose)
            return matches if p.weights == "cosine" else matches.equally_weighted()

        def step(pose: np.ndarray, matches: Correspondences) -> tuple[np.ndarray, float]:
            centre = transform_points(pose, middle)
            robust = self.vertex_weights / (1.0 + (matches.distances / p.outlier_distance) ** 2)
            update = self._solve(matches.points, matches, centre, robust)
            return apply_rigid_update(pose, update, centre), motion_of(update)

        printed = p.stop == "distance"
        converged = 0.0 if printed else p.min_step
        iterates = icp(pose, associate, step, lambda matches: matches.count, p.min_matches, p.iterations, converged)
        found = last(until_near(iterates, p.max_residual) if printed else iterates)
        residual = float("inf") if found.starved else found.matches.mean_distance
        return RigidFit(found.pose, residual)


def until_near(iterates: Iterator[Iterate[Correspondences]], distance: float) -> Iterator[Iterate[Correspondences]]:
    """Yield the start, and the steps up to the first one after which the mean distance is below ``distance``, mm."""
    for number, iterate in enumerate(iterates):
        yield iterate
        if number and iterate.matches.mean_distance < distance:
            return
