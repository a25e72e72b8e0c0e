"""A real take as the performer's script: the curves and head rotations of a Live Link Face CSV, sampled in time."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from .. import livelink
from ..errors import FileFormatError, ParameterError

#: A performance is rendered frame by frame; an hour at 30 frames a second is what anybody will wait for.
MAX_SECONDS = 3600.0


@dataclass(frozen=True)
class Take:
    """K rows of a take: ``times`` (K,) s from its start, ``curves`` (K, 52) of ``ARKIT_NAMES``, ``head`` (K, 3) degrees.

    ``head``: turns about the head's y, x and z axis in the order of :class:`~adaptiveface.synthetic.script.HeadMotion`.
    """

    name: str
    times: np.ndarray
    curves: np.ndarray
    head: np.ndarray

    @property
    def turns(self) -> bool:
        """Whether the take turns the head. Some recorders write zeros."""
        return bool(np.ptp(self.head, axis=0).max() > 0.1)

    def frames(self, fps: float) -> int:
        """Return the number of frames of the take at ``fps`` frames per second."""
        return int(np.floor(self.times[-1] * fps)) + 1

    def part(self, start: float, end: float) -> Take:
        """Return the rows between two times, s. The part begins at time 0.

        Raises
        ------
        ParameterError
            There are no rows between these times.
        """
        inside = (self.times >= start) & (self.times <= end)
        if not inside.any():
            raise ParameterError(f"{self.name}: {start:g} to {end:g} s lies outside the take of {self.times[-1]:g} s")
        times = self.times[inside] - self.times[inside][0]
        name = f"{self.name} {start:g}-{end:g} s"
        return replace(self, name=name, times=times, curves=self.curves[inside], head=self.head[inside])

    def activations(self, names: tuple[str, ...], fps: float) -> np.ndarray:
        """Return the (F, E) activations of the units ``names`` at ``fps``, in [0, 1]. Units that no curve drives are zero."""
        columns = {name: number for number, name in enumerate(livelink.ARKIT_NAMES)}
        curves = self._sampled(np.clip(self.curves, 0.0, 1.0), fps)
        nothing = np.zeros(len(curves))
        return np.stack([curves[:, columns[name]] if name in columns else nothing for name in names], axis=1)

    def head_turns(self, fps: float) -> np.ndarray:
        """Return the (F, 3) turns of the head at ``fps``, degrees."""
        return self._sampled(np.unwrap(self.head, axis=0, period=360.0), fps)

    def _sampled(self, values: np.ndarray, fps: float) -> np.ndarray:
        now = np.arange(self.frames(fps)) / fps
        return np.stack([np.interp(now, self.times, column) for column in values.T], axis=1)


def read_take(path: str | os.PathLike) -> Take:
    """Read a Live Link Face CSV.

    Raises
    ------
    FileFormatError
        The file cannot be read. The message names the file and the reason.
    """
    take = livelink.read_take(path)
    steps = np.maximum(np.diff(take.timestamps, prepend=take.timestamps[0]), 1e-4)  # times that repeat still move on
    times = np.cumsum(steps) - steps[0]
    if times[-1] > MAX_SECONDS:
        raise FileFormatError(f"{path}: {times[-1]:.0f} s long, at most {MAX_SECONDS:.0f} s are performed")
    # Live Link Face counts yaw and roll the other way round (livelink.convention).
    return Take(Path(path).stem, times, take.curves, np.degrees(take.head) * [-1.0, 1.0, -1.0])
