"""Compare for notebook 05: equation (7) exactly as printed, other Laplacians, holes in the depth map."""

from __future__ import annotations

import dataclasses
import functools

import cv2
import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_IDS, RgbdFrame
from ..geometry.mesh import adjacency, cotangent_laplacian
from ..model.actor import Actor
from ..parameters import Parameters
from ..tracking.laplacian import LaplacianDeformation
from ..tracking.stages import Stages
from ..tracking.tracker import FaceTracker
from ..tracking.types import TrackedFrame
from .measures import Measures
from .session import Session

LAPLACIANS = ("cotangent", "cotangent, non-negative", "uniform")


class PrintedEquation:
    """Equation (7) solved literally: dv = (K^T K)^-1 K^T G^-1 a with K = [Q; I; L], G = diag(H, w1 I, w2 I).

    (For a tall K of full column rank this equals the pseudo-inverse that the paper prints.) Row by row G^-1 a is
    H_j^-1 d_j, w1 (p_i - v_i) / w1 and w2 0 / w2: the weights cancel, whatever their values. Camera frame, with pixels
    measured from the principal point, so that P = diag(f, f, 1).
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
        # P is diagonal, so the three coordinates have their own matrices: focal length for x and y, 1 for z.
        self._factors = [splu((smooth + s**2 * self._select.T @ self._select).tocsc()) for s in (camera.fx, camera.fy, 1.0)]

    def deform(self, frame: RgbdFrame, result: TrackedFrame, w1: float, w2: float) -> np.ndarray:
        """Displacement (n, 3) of the frontal vertices of v1 in the head frame, mm."""
        vertices = result.in_camera(result.v1[self._frontal])
        to_depth = self._depth_points(frame, vertices) - vertices
        points = (w1 * to_depth) / w1  # G^-1 a: the second block
        smooth = (w2 * 0.0) / w2  # G^-1 a: the third block
        right = points + smooth + self._feature_rows(frame, vertices, to_depth)
        solved = np.column_stack([factor.solve(right[:, k]) for k, factor in enumerate(self._factors)])
        return solved @ result.head_pose[:3, :3]

    def _depth_points(self, frame: RgbdFrame, vertices: np.ndarray, reach: float = 15.0) -> np.ndarray:
        """p_i of eq. (3): the depth measured on the vertex's viewing ray; the vertex itself where there is none."""
        pixels = np.round(self.camera.project(vertices)).astype(int)
        pixels = np.clip(pixels, 0, [self.camera.width - 1, self.camera.height - 1])
        measured = frame.depth[pixels[:, 1], pixels[:, 0]]
        use = (np.abs(measured - vertices[:, 2]) < reach) & self.actor.depth_valid[self._frontal]
        return np.where(use[:, None], vertices * (measured / vertices[:, 2])[:, None], vertices)

    def _feature_rows(self, frame: RgbdFrame, vertices: np.ndarray, to_depth: np.ndarray) -> np.ndarray:
        """K^T G^-1 a of the first block, (n, 3); with d = (0, 0, dz), H_j^-1 d_j = ((u - v) dz, dz)."""
        at = self._select @ vertices
        along = (self._select @ to_depth)[:, 2]
        seen = np.zeros((len(self._features), 2)) if frame.features is None else frame.features.pixels[self._features]
        valid = np.zeros(len(self._features), bool) if frame.features is None else frame.features.valid[self._features]
        offset = np.where(valid[:, None], seen - self.camera.project(at), 0.0)
        target = np.column_stack([offset * along[:, None], along])
        scale = np.array([self.camera.fx, self.camera.fy, 1.0])
        return self._select.T @ (np.where(valid[:, None], target, 0.0) * scale)


def printed_pane(session: Session):
    """A pane: v1 deformed by :class:`PrintedEquation` with the panel's w1, w2; colour: the displacement's length."""
    equation, frontal = PrintedEquation(session.actor, session.camera), session.actor.frontal

    def pane(result: TrackedFrame, frame: RgbdFrame, parameters: Parameters):
        """Vertices and heat of one frame."""
        heat = np.full(len(frontal), np.nan)
        if not result.tracked:
            return result.v1, heat
        displacement = equation.deform(frame, result, parameters.laplacian.w1, parameters.laplacian.w2)
        vertices = result.v1.copy()
        vertices[frontal] += displacement
        heat[frontal] = np.linalg.norm(displacement, axis=1)
        return vertices, heat

    pane.needs_parameters = True
    return pane


def uniform_laplacian(vertices: np.ndarray, triangles: np.ndarray) -> sp.csr_matrix:
    """(N, N) graph Laplacian, every edge counts 1: it knows the connections of the mesh but not its shape."""
    neighbours = adjacency(triangles, len(vertices)).astype(float)
    return (sp.diags(np.asarray(neighbours.sum(axis=1)).ravel()) - neighbours).tocsr()


def tracker_with_laplacian(name: str):
    """``make_tracker`` for a :class:`~.replay.Replay` or :class:`~.stage_explorer.StageExplorer`: one of ``LAPLACIANS``."""
    operators = dict(
        zip(
            LAPLACIANS,
            (cotangent_laplacian, lambda v, t: cotangent_laplacian(v, t, True), uniform_laplacian),
            strict=True,
        )
    )

    stages = Stages(deformation=functools.partial(LaplacianDeformation.of, laplacian=operators[name]))

    def make(actor: Actor, parameters: Parameters) -> FaceTracker:
        """A tracker whose deformation to depth smooths by the chosen operator."""
        return FaceTracker(actor, parameters, stages)

    return make


def with_hole(session: Session, radius: float = 25.0, feature: int = 54) -> Session:
    """The same performance with a disc of the depth map missing, as a hand or a reflection would leave it.

    radius: mm, at the distance of the face; feature: iBUG number of the disc's centre (54: the subject's left mouth
    corner). The 2D features under the disc stay: colour cameras see where depth cameras are blind. In the colour image,
    which the tracker does not read, the disc is darkened to show where it is.
    """
    which = int(np.flatnonzero(FEATURE_IDS == feature)[0])
    return dataclasses.replace(session, frames=[_pierced(frame, which, radius) for frame in session.frames])


def _pierced(frame: RgbdFrame, which: int, radius: float) -> RgbdFrame:
    if frame.features is None or not frame.features.valid[which]:
        return frame
    measured = frame.depth[frame.depth > 0]
    pixels = radius * frame.camera.fx / float(np.percentile(measured, 10))
    centre = tuple(int(round(c)) for c in frame.features.pixels[which])
    disc = cv2.circle(np.zeros(frame.depth.shape, np.uint8), centre, int(round(pixels)), 1, -1) > 0
    colour = frame.colour
    if colour is not None and colour.shape[:2] == disc.shape:
        colour = np.where(disc[..., None], colour // 2, colour)
    return dataclasses.replace(frame, depth=np.where(disc, np.float32(0), frame.depth), colour=colour)


def error_in_hole(session: Session, pierced: Session, measures: Measures, run, stage: str = "v2") -> float:
    """Mean error, mm, of a run's ``stage`` where ``session`` has depth and ``pierced`` has none; NaN where nowhere.

    ``run``: tracked results of every frame, of either session.
    """
    errors = []
    for result, full, hole in zip(run, session.frames, pierced.frames, strict=True):
        if result is None or not result.tracked:
            continue
        height, width = full.depth.shape
        pixels = np.round(full.camera.project(result.in_camera(getattr(result, stage)))).astype(int)
        column, row = np.clip(pixels, 0, [width - 1, height - 1]).T
        inside = (full.depth[row, column] > 0) & (hole.depth[row, column] == 0)
        errors.append(measures.error(result, full, stage)[inside])
    errors = np.concatenate(errors) if errors else np.zeros(0)
    return float(np.nanmean(errors)) if np.isfinite(errors).any() else float("nan")
