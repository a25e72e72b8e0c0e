"""Deform with other Laplacians, and over holes in the depth map (section 4.3)."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable

import cv2
import numpy as np
import scipy.sparse as sp

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


def uniform_laplacian(vertices: np.ndarray, triangles: np.ndarray) -> sp.csr_matrix:
    """The graph Laplacian (N, N), in which every edge counts 1. It knows the mesh's connections, but not its shape."""
    neighbours = adjacency(triangles, len(vertices)).astype(float)
    return (sp.diags(np.asarray(neighbours.sum(axis=1)).ravel()) - neighbours).tocsr()


def tracker_with_laplacian(name: str) -> Callable[[Actor, Parameters], FaceTracker]:
    """Return a function that makes trackers whose deformation to depth smooths by one of ``LAPLACIANS``."""
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
    """Remove a disc from every depth map of a performance, as a hand or a reflection would.

    The 2D features under the disc stay, because colour cameras see where depth cameras are blind. In the colour image,
    which the tracker does not read, the disc is darkened to show where it is.

    Parameters
    ----------
    session : Session
        The performance.
    radius : float
        Of the disc at the distance of the face, mm.
    feature : int
        iBUG number of the disc's centre; 54 is the subject's left mouth corner.

    Returns
    -------
    Session
        The same performance with the disc missing.
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


def error_in_hole(
    session: Session, pierced: Session, measures: Measures, run: Iterable[TrackedFrame | None], stage: str = "v2"
) -> float:
    """Measure a run where ``session`` has depth and ``pierced`` has none.

    Parameters
    ----------
    session, pierced : Session
        The whole performance, and the same one with holes (:func:`with_hole`).
    measures : Measures
        Of ``session``.
    run : iterable of TrackedFrame or None
        The result of every frame, of either session.
    stage : str
        Whose mesh is measured, "v1" to "v4".

    Returns
    -------
    float
        Mean error inside the holes, mm; NaN if no vertex lies inside one.
    """
    inside_holes = []
    for result, full, hole in zip(run, session.frames, pierced.frames, strict=True):
        if result is None or not result.tracked:
            continue
        height, width = full.depth.shape
        pixels = np.round(full.camera.project(result.in_camera(getattr(result, stage)))).astype(int)
        column, row = np.clip(pixels, 0, [width - 1, height - 1]).T
        inside = (full.depth[row, column] > 0) & (hole.depth[row, column] == 0)
        inside_holes.append(measures.error(result, full, stage)[inside])
    errors = np.concatenate([np.zeros(0), *inside_holes])
    return float(np.nanmean(errors)) if np.isfinite(errors).any() else float("nan")
