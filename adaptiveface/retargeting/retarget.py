"""Turn a tracked result into curves that drive any character (paper, section 6 and figure 8)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ParameterError
from ..livelink.convention import eye_angles, eyes_of_gaze, with_look
from ..model.actor import Actor
from ..renamed import renamed
from ..result import Result
from ..result.access import time_table
from ..runtime.timing import frame_rate, increasing
from ..tracking.resolve import SparseResolve
from . import COEFFICIENTS
from .arkit import ARKIT_NAMES, ArkitWeights, arkit_weights
from .arkit_resolve import ArkitResolve, unit_names
from .character import Character
from .resolve import blendshape_parameters
from .smoothing import Smoothing

if TYPE_CHECKING:
    from pandas import DataFrame


@renamed
@dataclass(frozen=True)
class Performance:
    """What a character needs to perform F frames.

    Attributes
    ----------
    curves : (F, 52)
        ARKit curves, columns as ``ARKIT_NAMES``, from 0 to 1. Those of a phone's take may exceed 1 slightly.
    timestamps : (F,)
        Seconds.
    head_pose : (F, 4, 4)
        Head frame to camera frame, mm.
    unknown : tuple of str
        Expressions of the result without an ARKit counterpart, which therefore do not show.
    eyes : (F, 6) or None
        Measured yaw, pitch and roll of the left eye, then of the right eye, radians (:mod:`adaptiveface.livelink.convention`).
        With None, the eyes follow the curves.
    start : float
        Time of day of the first frame, s.
    """

    curves: np.ndarray
    timestamps: np.ndarray
    head_pose: np.ndarray
    unknown: tuple[str, ...] = ()
    eyes: np.ndarray | None = None
    start: float = 0.0

    def __len__(self) -> int:
        return len(self.curves)

    @property
    def fps(self) -> float:
        """Frames per second of the recording, rounded to a standard rate that is close."""
        return frame_rate(self.timestamps)

    @property
    def eye_angles(self) -> np.ndarray:
        """(F, 6) angles of the eyes, radians: the measured ones or, without a measurement, those of the curves."""
        return eye_angles(self.curves) if self.eyes is None else self.eyes

    def table(self) -> DataFrame:
        """The ARKit curves as a ``DataFrame`` with a row per frame, indexed by time (needs the extra ``pandas``)."""
        return time_table(self.curves, self.timestamps, ARKIT_NAMES)

    def smoothed(self, smoothing: Smoothing | None) -> Performance:
        """The performance with filtered curves and eyes; without a filter, the performance itself."""
        if smoothing is None:
            return self
        eyes = None if self.eyes is None else smoothing.apply(self.eyes, self.timestamps)
        return replace(self, curves=np.clip(smoothing.apply(self.curves, self.timestamps), 0, 1), eyes=eyes)


def driving_coefficients(result: Result, coefficients: str = "resolved", actor: Actor | None = None) -> np.ndarray:
    """(F, A) coefficients that drive the target.

    "resolved" coefficients are solved from the final mesh v4 (section 6): with the actor's rig by :class:`SparseResolve` and
    the run's own parameters; without it, they are those that the tracker stored in the result. "initial" coefficients are
    those of the first fit (section 4.2), with which figure 8 of the paper compares.
    """
    if coefficients not in COEFFICIENTS:
        raise ParameterError(f"coefficients = {coefficients!r}: one of {', '.join(COEFFICIENTS)} is expected")
    if coefficients == "initial":
        return result.coefficients_initial.astype(float)
    if actor is None:
        return result.coefficients.astype(float)
    resolve = SparseResolve.of(result.rig(actor), result.expression_names, blendshape_parameters(result))
    out = np.empty((len(result), len(result.expression_names)))
    for part, meshes in result.head_blocks():
        out[part] = [resolve(v4, x) for v4, x in zip(meshes, result.coefficients[part], strict=True)]
    return out


def retarget(
    result: Result, coefficients: str = "resolved", smoothing: Smoothing | None = None, actor: Actor | None = None
) -> Performance:
    """The performance of a tracked result.

    ``coefficients`` are those of :func:`driving_coefficients`, or "arkit": ARKit's shapes with their left and right halves,
    solved from v4 by :class:`ArkitResolve`, which needs the actor. Raises :class:`ParameterError`.
    """
    if coefficients == "arkit":
        return _with_gaze(_arkit_performance(result, actor), result).smoothed(smoothing)
    values = driving_coefficients(result, coefficients, actor)
    table = arkit_weights(result.expression_names)
    performance = Performance(
        table.curves(values), increasing(result.timestamps), result.head_pose.astype(float), table.unknown
    )
    return _with_gaze(performance, result).smoothed(smoothing)


def _with_gaze(performance: Performance, result: Result) -> Performance:
    """The performance with the gaze that was measured by the irises. It is unchanged if no iris was seen."""
    if result.gaze is None:
        return performance
    eyes = eyes_of_gaze(result.gaze)
    return replace(performance, curves=with_look(performance.curves, eyes), eyes=eyes)


def _arkit_performance(result: Result, actor: Actor | None) -> Performance:
    if actor is None:
        raise ParameterError("coefficients arkit: needs the actor's rig (--actor actor.npz)")
    resolve = ArkitResolve(actor, blendshape_parameters(result))
    curves, before = np.empty((len(result), len(ARKIT_NAMES))), None
    for part, meshes in result.head_blocks():
        for frame, v4 in zip(range(part.start, part.stop), meshes, strict=True):
            curves[frame] = before = resolve(v4, before)
    return Performance(curves, increasing(result.timestamps), result.head_pose.astype(float))


def driving_names(result: Result, coefficients: str) -> tuple[str, ...]:
    """Names of the expressions that drive the target: those of the result or, for "arkit", ARKit's shapes."""
    return unit_names() if coefficients == "arkit" else tuple(result.expression_names)


def coverage(table: ArkitWeights, character: Character) -> list[str]:
    """Lines that say what will not show: unknown expressions, and ARKit shapes that the character lacks."""
    driven = [ARKIT_NAMES[i] for i in np.flatnonzero(np.abs(table.matrix).max(axis=0) > 0)]
    lines = [f"no ARKit counterpart: {', '.join(table.unknown)}"] if table.unknown else []
    missing = [name for name in driven if name in character.missing]
    if missing:
        lines.append(f"{character.name} lacks: {', '.join(missing)}")
    return lines + undriven(character) + list(character.notes)


def undriven(character: Character) -> list[str]:
    """A line that names the first dozen of the shapes that nothing drives."""
    names = [name for name in character.unknown if name not in character.parts]
    more = f" and {len(names) - 12} more" if len(names) > 12 else ""
    return [f"{character.name} has shapes that nothing drives: {', '.join(names[:12])}{more}"] if names else []
