"""Solve equation (7) exactly as printed, to show that its weights cancel."""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..geometry.camera import Camera
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import cotangent_laplacian
from ..model.actor import Actor
from ..tracking.types import TrackedFrame


class PrintedEquation:
    """Solves equation (7) literally: dv = (K^T K)^-1 K^T G^-1 a with K = [Q; I; L], G = diag(H, w1 I, w2 I).

    For a tall K of full column rank, this equals the pseudo-inverse that the paper prints. The rows of G^-1 a are H_j^-1 d_j,
    w1 (p_i - v_i) / w1 and w2 0 / w2, so that the weights cancel for any values. Everything is in the camera frame, with
    pixels measured from the principal point, so that P = diag(f, f, 1).

    Parameters
    ----------
    actor : Actor
        The performer's rig.
    camera : Camera
        Of the frames.
    """

    def __init__(self, actor: Actor, camera: Camera) -> None:
        self.actor, self.camera = actor, camera
        self._frontal = np.flatnonzero(actor.frontal)
        n = len(self._frontal)
        laplacian = cotangent_laplacian(actor.neutral, actor.triangles)[:, self._frontal]
        local = np.full(len(actor.neutral), -1)
        local[self._frontal] = np.arange(n)
        self._features = np.flatnonzero(local[actor.feature_vertices] >= 0)
        columns = local[actor.feature_vertices[self._features]]
        rows = np.arange(len(columns))
        self._select = sp.csr_matrix((np.ones(len(columns)), (rows, columns)), (len(columns), n))
        smooth = laplacian.T @ laplacian + sp.identity(n)
        # P is diagonal, so each coordinate has its own matrix, with the focal length for x and y, and 1 for z.
        self._factors = [splu((smooth + s**2 * self._select.T @ self._select).tocsc()) for s in (camera.fx, camera.fy, 1.0)]

    def deform(self, frame: RgbdFrame, result: TrackedFrame, w1: float, w2: float) -> np.ndarray:
        """Deform v1 of one frame.

        Parameters
        ----------
        frame : RgbdFrame
            With depth and features.
        result : TrackedFrame
            Of that frame.
        w1, w2 : float
            The weights, which cancel.

        Returns
        -------
        (n, 3)
            Displacements of the frontal vertices in the head frame, mm.
        """
        vertices = result.in_camera(result.v1[self._frontal])
        to_depth = self._depth_points(frame, vertices) - vertices
        points = (w1 * to_depth) / w1  # G^-1 a: the second block
        smooth = (w2 * 0.0) / w2  # G^-1 a: the third block
        right = points + smooth + self._feature_rows(frame, vertices, to_depth)
        solved = np.column_stack([factor.solve(right[:, k]) for k, factor in enumerate(self._factors)])
        return solved @ result.head_pose[:3, :3]

    def _depth_points(self, frame: RgbdFrame, vertices: np.ndarray, reach: float = 15.0) -> np.ndarray:
        """p_i of equation (3): the measured point on each vertex's viewing ray, or the vertex itself if there is none."""
        pixels = np.round(self.camera.project(vertices)).astype(int)
        pixels = np.clip(pixels, 0, [self.camera.width - 1, self.camera.height - 1])
        measured = frame.depth[pixels[:, 1], pixels[:, 0]]
        use = (np.abs(measured - vertices[:, 2]) < reach) & self.actor.depth_valid[self._frontal]
        return np.where(use[:, None], vertices * (measured / vertices[:, 2])[:, None], vertices)

    def _feature_rows(self, frame: RgbdFrame, vertices: np.ndarray, to_depth: np.ndarray) -> np.ndarray:
        """K^T G^-1 a of the first block, (n, 3). With d = (0, 0, dz), H_j^-1 d_j is ((u - v) dz, dz)."""
        at = self._select @ vertices
        along = (self._select @ to_depth)[:, 2]
        seen = np.zeros((len(self._features), 2)) if frame.features is None else frame.features.pixels[self._features]
        valid = np.zeros(len(self._features), bool) if frame.features is None else frame.features.valid[self._features]
        offset = np.where(valid[:, None], seen - self.camera.project(at), 0.0)
        target = np.column_stack([offset * along[:, None], along])
        scale = np.array([self.camera.fx, self.camera.fy, 1.0])
        return self._select.T @ (np.where(valid[:, None], target, 0.0) * scale)
