"""Smooth coefficient curves with a one-euro filter or the Kalman model, and measure what that costs.

The benefit is less jitter on a still face, and the cost is the lag after a step.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from ..errors import ParameterError
from ..parameters import KalmanParameters
from ..tracking.kalman import CoefficientFilter


class Smoothing(Protocol):
    """A causal filter of curves for recordings (:meth:`apply`) and streams (:meth:`step`)."""

    def apply(self, values: np.ndarray, timestamps: np.ndarray) -> np.ndarray:
        """(F, ...) filtered values at times (F,), s. Every channel is filtered separately."""

    def step(self, value: np.ndarray, dt: float, state: Any) -> tuple[np.ndarray, Any]:
        """Filter one sample of a stream, ``dt`` s after the last. ``state`` is None at the start.

        Returns the filtered value and the new state.
        """


@dataclass(frozen=True)
class OneEuro:
    """One-euro filter (Casiez, Roussel & Vogel 2012): a low-pass filter whose cut-off follows the speed of the signal.

    Parameters
    ----------
    cutoff : float
        Cut-off of a signal at rest, Hz. A lower one smooths more.
    beta : float
        Increase of the cut-off per unit of speed. A larger one lags less. It is of order 1, because the values lie in [0, 1].
    speed_cutoff : float
        Cut-off of the low-pass filter of the speed, Hz.
    """

    cutoff: float = 2.0
    beta: float = 3.0
    speed_cutoff: float = 1.0

    def __post_init__(self) -> None:
        for name in ("cutoff", "speed_cutoff"):
            if not 1e-6 < getattr(self, name) < 1e6:
                raise ParameterError(f"{name} = {getattr(self, name)}: a frequency in Hz is expected")
        if not 0 <= self.beta < 1e6:
            raise ParameterError(f"beta = {self.beta}: a number of at least 0 is expected")

    def apply(self, values: np.ndarray, timestamps: np.ndarray) -> np.ndarray:
        """(F, ...) filtered values at times (F,), s. Every channel is filtered separately."""
        values = np.asarray(values, float)
        out, state = np.empty_like(values), None
        for frame, value in enumerate(values):
            dt = 1 / 30 if frame == 0 else float(timestamps[frame] - timestamps[frame - 1])
            out[frame], state = self.step(value, dt, state)
        return out

    def step(self, value: np.ndarray, dt: float, state: tuple[np.ndarray, np.ndarray] | None):
        """Filter one sample of a stream, ``dt`` s after the last. ``state`` is None at the start.

        Returns the filtered value and the new state.
        """
        if state is None:
            return value, (value, np.zeros_like(value))
        before, speed = state
        dt = max(dt, 1e-4)
        speed = speed + _share(self.speed_cutoff, dt) * ((value - before) / dt - speed)
        out = before + _share(self.cutoff + self.beta * np.abs(speed), dt) * (value - before)
        return out, (out, speed)


@dataclass(frozen=True)
class KalmanSmoothing:
    """The Kalman filter of section 4.2, applied to finished curves. Every sample is one step, whatever its time.

    Parameters
    ----------
    model : str
        As ``kalman.model`` in the parameters. "variance" hardly smooths and hardly lags, and "acceleration" does both.
        :class:`CoefficientFilter` explains how the paper's two noises lead to either.
    """

    model: str = "variance"

    def apply(self, values: np.ndarray, timestamps: np.ndarray) -> np.ndarray:
        """(F, A) filtered values. The times are not used."""
        smoother = CoefficientFilter(KalmanParameters(model=self.model))
        return np.array([smoother.update(value) for value in np.asarray(values, float)]).reshape(np.shape(values))

    def step(self, value: np.ndarray, dt: float, state: CoefficientFilter | None):
        """Filter one sample (A,) of a stream. ``state`` is None at the start. Returns the filtered value and the new state."""
        state = CoefficientFilter(KalmanParameters(model=self.model)) if state is None else state
        return state.update(value), state


#: The filters that the command line offers.
FILTERS: dict[str, type[Smoothing]] = {"one-euro": OneEuro, "kalman": KalmanSmoothing}
#: The filters that reports and docs compare. The first and the third are those of the command line.
COMPARED: dict[str, Smoothing] = {
    "one-euro, 2 Hz, beta 3 (--smooth)": OneEuro(),
    "one-euro, 1 Hz, beta 1": OneEuro(1.0, 1.0),
    "Kalman, noises as variances (--filter kalman)": KalmanSmoothing(),
    "Kalman, noises as accelerations": KalmanSmoothing("acceleration"),
}


@dataclass(frozen=True)
class SmoothingCost:
    """What a filter costs.

    Attributes
    ----------
    name : str
        Name of the filter.
    jitter : float
        Jitter of a still face's coefficients that is left (:func:`jitter`).
    lag : float
        Delay at half of a step, ms.
    overshoot : float
        Overshoot after a step, as a share of it.
    """

    name: str
    jitter: float
    lag: float
    overshoot: float


def smoothing_costs(still: np.ndarray, fps: float = 30.0) -> tuple[SmoothingCost, ...]:
    """The cost of no filter, and of every filter of ``COMPARED``, measured on coefficients (F, A) of a still face."""
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
    """The factor of exponential smoothing that makes a first-order low-pass filter with ``cutoff``, Hz."""
    return 1.0 / (1.0 + 1.0 / (2 * np.pi * cutoff * dt))


def jitter(values: np.ndarray) -> float:
    """Root mean square over channels of the standard deviation of a still face's coefficients (F, A)."""
    return float(np.sqrt(np.var(values, axis=0).mean()))


def step_response(smooth, fps: float = 30.0, seconds: float = 4.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Apply a filter to a step from 0 to 1.

    Parameters
    ----------
    smooth : callable
        ``smooth(values (F, 1), times (F,))`` returns the filtered values (F, 1).
    fps, seconds : float
        Rate and length of the signal, which steps in its middle.

    Returns
    -------
    times, step, filtered : (F,)
        Times relative to the step, s, and the signal before and after the filter.
    """
    count = int(seconds * fps)
    times = np.arange(count) / fps
    step = (np.arange(count) >= count // 2).astype(float)
    return times - (count // 2 - 0.5) / fps, step, smooth(step[:, None], times)[:, 0]


def step_lag(smooth, height: float = 0.8, fps: float = 30.0) -> float:
    """How much later than the step a filter passes half of it, ms. The parameters are those of :func:`step_response`."""
    times, _, out = step_response(lambda values, t: smooth(height * values, t) / height, fps)
    after = int(np.argmax(out >= 0.5))
    if not after:
        return 0.0
    fraction = (0.5 - out[after - 1]) / (out[after] - out[after - 1])
    return float((times[after - 1] + fraction / fps) * 1e3)
