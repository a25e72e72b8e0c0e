"""Show for notebook 05 what equation (7) does exactly as printed."""

from __future__ import annotations

import numpy as np

from ..geometry.frame import RgbdFrame
from ..parameters import Parameters
from ..studies.measures import TunedPane
from ..studies.printed_equation import PrintedEquation
from ..studies.session import Session
from ..tracking.types import TrackedFrame


def printed_pane(session: Session) -> TunedPane:
    """Make a pane of v1 deformed by :class:`PrintedEquation` with the panel's w1 and w2; colours are displacements."""
    equation, frontal = PrintedEquation(session.actor, session.camera), session.actor.frontal

    def draw(result: TrackedFrame, frame: RgbdFrame, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
        """The vertices (N, 3) of one frame, mm, and their heat (N,)."""
        heat = np.full(len(frontal), np.nan)
        if not result.tracked:
            return result.v1, heat
        displacement = equation.deform(frame, result, parameters.laplacian.w1, parameters.laplacian.w2)
        vertices = result.v1.copy()
        vertices[frontal] += displacement
        heat[frontal] = np.linalg.norm(displacement, axis=1)
        return vertices, heat

    return TunedPane(draw)
