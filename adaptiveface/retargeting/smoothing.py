"""Smooth coefficient curves with a one-euro filter or the Kalman model, and measure what that costs.

The cost: jitter on a still face (what smoothing is for) against lag on a step (what it takes).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..errors import ParameterError
from ..parameters import KalmanParameters
from ..tracking.kalman import CoefficientFilter


class Smoothing(Protocol):
    """A causal filter of curves, for recordings (``apply``) and streams (``step``)."""

    def apply(self, values: np.ndarray, timestamps: np.ndarray) -> np.ndarray:
        """(F, ...) filtered values at times (F,) s; every channel on its own."""

    def step(self, value: np.ndarray, dt: float, state: Any) -> tuple[np.ndarray, Any]:
        """One sample of a stream: (filtered value, new state); ``state`` None at the start, ``dt`` s."""


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


@dataclass(frozen=True)
class KalmanSmoothing:
    """The Kalman model of section 4.2 on finished curves; ``model`` as ``kalman.model`` in the parameters.

    One sample is one step, whatever its time. ``variance`` hardly smooths and hardly lags, ``acceleration`` does both:
    :class:`CoefficientFilter` says how the paper's two noises lead to either.
    """

    model: str = "variance"

    def apply(self, values: np.ndarray, timestamps: np.ndarray) -> np.ndarray:
        """(F, A) filtered values; the times are not used."""
        smoother = CoefficientFilter(KalmanParameters(model=self.model))
        return np.array([smoother.update(value) for value in np.asarray(values, float)]).reshape(np.shape(values))

    def step(self, value: np.ndarray, dt: float, state: CoefficientFilter | None):
        """One sample (A,) of a stream: (filtered value, new state); ``state`` None at the start."""
        state = CoefficientFilter(KalmanParameters(model=self.model)) if state is None else state
        return state.update(value), state


#: The filters that the command line offers.
FILTERS: dict[str, type[Smoothing]] = {"one-euro": OneEuro, "kalman": KalmanSmoothing}
#: What reports and docs compare, the offered filters first.
COMPARED: dict[str, Smoothing] = {
    "one-euro, 2 Hz, beta 3 (--smooth)": OneEuro(),
    "one-euro, 1 Hz, beta 1": OneEuro(1.0, 1.0),
    "Kalman, noises as variances (--filter kalman)": KalmanSmoothing(),
    "Kalman, noises as accelerations": KalmanSmoothing("acceleration"),
}


@dataclass(frozen=True)
class SmoothingCost:
    """jitter: of a still face's coefficients, 0 to 1; lag: of half a step, ms; overshoot: of a step, as a share."""

    name: str
    jitter: float
    lag: float
    overshoot: float


def smoothing_costs(still: np.ndarray, fps: float = 30.0) -> tuple[SmoothingCost, ...]:
    """The cost of no filter and of every one of ``COMPARED``, on coefficients (F, A) of a still face."""
    times = np.arange(len(still)) / fps
    rows = [SmoothingCost("none", jitter(still), 0.0, 0.0)]
    for name, smoothing in COMPARED.items():
        out = step_response(smoothing.apply, fps)[2]
        rows.append(
            SmoothingCost(
                name,
                jitter(smoothing.apply(still, times)),
                step_lag(smoothing.apply, fps=fps),
                max(float(out.max()) - 1.0, 0.0),
            )
        )
    return tuple(rows)


def _share(cutoff, dt: float):
    """Exponential smoothing factor of a first-order low-pass with ``cutoff`` Hz."""
    return 1.0 / (1.0 + 1.0 / (2 * np.pi * cutoff * dt))


def jitter(values: np.ndarray) -> float:
    """Root mean square over channels of the standard deviation of a still face's coefficients (F, A)."""
    return float(np.sqrt(np.var(values, axis=0).mean()))


def step_response(smooth, fps: float = 30.0, seconds: float = 4.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (F,) s from the step on, the step (F,) from 0 to 1 in the middle, and ``smooth(values, times)`` of it (F,)."""
    count = int(seconds * fps)
    times = np.arange(count) / fps
    step = (np.arange(count) >= count // 2).astype(float)
    return times - (count // 2 - 0.5) / fps, step, smooth(step[:, None], times)[:, 0]


def step_lag(smooth, height: float = 0.8, fps: float = 30.0) -> float:
    """Milliseconds by which ``smooth(values (F, 1), timestamps (F,))`` passes half of a step later than the step."""
    times, _, out = step_response(lambda values, t: smooth(height * values, t) / height, fps)
    after = int(np.argmax(out >= 0.5))
    if not after:
        return 0.0
    fraction = (0.5 - out[after - 1]) / (out[after] - out[after - 1])
    return float((times[after - 1] + fraction / fps) * 1e3)
