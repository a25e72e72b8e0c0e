"""Smoothing of coefficient curves: the one-euro filter, and what it costs (jitter on a still face, lag on a step)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import ParameterError


@dataclass(frozen=True)
class OneEuro:
    """One-euro filter (Casiez, Roussel & Vogel 2012): a low-pass filter whose cut-off follows the speed of the signal.

    cutoff Hz: at rest, lower is smoother; beta (per unit and second): how fast the cut-off rises with speed, higher
    lags less; speed_cutoff Hz: low-pass on the speed. Values lie in [0, 1], so beta is of order 1.
    """

    cutoff: float = 2.0
    beta: float = 3.0
    speed_cutoff: float = 1.0

    def __post_init__(self) -> None:
        for name in ("cutoff", "speed_cutoff"):
            if not 1e-6 < getattr(self, name) < 1e6:
                raise ParameterError(f"{name} = {getattr(self, name)}: a frequency in Hz is expected")
        if not 0 <= self.beta < 1e6:
            raise ParameterError(f"beta = {self.beta}: a number from 0 on is expected")

    def apply(self, values: np.ndarray, timestamps: np.ndarray) -> np.ndarray:
        """(F, ...) filtered values at times (F,) s; every channel on its own."""
        values = np.asarray(values, float)
        out, state = np.empty_like(values), None
        for frame, value in enumerate(values):
            dt = 1 / 30 if frame == 0 else float(timestamps[frame] - timestamps[frame - 1])
            out[frame], state = self.step(value, dt, state)
        return out

    def step(self, value: np.ndarray, dt: float, state: tuple[np.ndarray, np.ndarray] | None):
        """One sample of a stream: (filtered value, new state); ``state`` None at the start, ``dt`` s."""
        if state is None:
            return value, (value, np.zeros_like(value))
        before, speed = state
        dt = max(dt, 1e-4)
        speed = speed + _share(self.speed_cutoff, dt) * ((value - before) / dt - speed)
        out = before + _share(self.cutoff + self.beta * np.abs(speed), dt) * (value - before)
        return out, (out, speed)


def _share(cutoff, dt: float):
    """Exponential smoothing factor of a first-order low-pass with ``cutoff`` Hz."""
    return 1.0 / (1.0 + 1.0 / (2 * np.pi * cutoff * dt))


def jitter(values: np.ndarray) -> float:
    """Root mean square over channels of the standard deviation of a still face's coefficients (F, A)."""
    return float(np.sqrt(np.var(values, axis=0).mean()))


def step_lag(smooth, height: float = 0.8, fps: float = 30.0) -> float:
    """Milliseconds by which ``smooth(values (F, 1), timestamps (F,))`` passes half of a step later than the step."""
    count = 4 * int(fps)
    times = np.arange(count) / fps
    values = np.where(np.arange(count) < count // 2, 0.0, height)[:, None]
    out = smooth(values, times)[:, 0]
    after = int(np.argmax(out >= height / 2))
    fraction = (height / 2 - out[after - 1]) / (out[after] - out[after - 1]) if after else 0.0
    return float((after - 1 + fraction - (count // 2 - 1 + 0.5)) / fps * 1e3)
