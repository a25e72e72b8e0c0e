"""Kalman filter on the blendshape coefficients: position and velocity (section 4.2; Welch & Bishop 1995)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..parameters import KalmanParameters


@dataclass(frozen=True)
class FilterState:
    """State of the filter after a frame.

    Attributes
    ----------
    mean : (2, A) float
        The A coefficients and their velocities, per frame or per second, depending on the model.
    covariance : (2, 2) float
        Covariance, the same for every coefficient.
    """

    mean: np.ndarray
    covariance: np.ndarray

    @property
    def coefficients(self) -> np.ndarray:
        """The filtered coefficients (A,)."""
        first: np.ndarray = self.mean[0]
        return first


class CoefficientFilter:
    """One constant-velocity filter per coefficient. All share the 2 x 2 covariance, because their noises are equal.

    The state (2, A) holds each coefficient and its velocity. The paper names a process noise of 0.05 and a measurement noise
    of 0.02 without saying how they are used. ``kalman.model`` is one of:

    * ``"variance"`` (default): Q = 0.05 I, R = 0.02, time in frames: a gain of about 0.9, little smoothing, no lag;
    * ``"acceleration"``: 0.05 and 0.02 are the variances of a white acceleration and of the measurement, time in seconds
      at 30 frames a second: a gain of about 0.06, a lag of some twenty frames;
    * ``"off"``: the measured coefficients pass unchanged.
    """

    def __init__(self, parameters: KalmanParameters) -> None:
        dt = 1.0 if parameters.model == "variance" else 1.0 / 30.0
        self.process_noise, self.measurement_noise = parameters.process_noise, parameters.measurement_noise
        q = self.process_noise
        self._transition = np.array([[1.0, dt], [0.0, 1.0]])
        self._q = q * np.eye(2)
        if parameters.model == "acceleration":
            self._q = q * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
        self._off = parameters.model == "off"
        #: State of :meth:`update` after the frames so far; None before the first one.
        self.state: FilterState | None = None

    def reset(self) -> None:
        """Forget the past, before the first frame or after a loss."""
        self.state = None

    def update(self, measured: np.ndarray) -> np.ndarray:
        """Filter the coefficients (A,) of one frame, and return (A,)."""
        self.state = self.step(self.state, measured)
        return self.state.coefficients

    def step(self, state: FilterState | None, measured: np.ndarray) -> FilterState:
        """The state after a frame with coefficients ``measured`` (A,), from the ``state`` before it."""
        if self._off or state is None:
            return FilterState(np.stack([measured, np.zeros_like(measured)]), np.eye(2))
        return self.correct(state, measured)

    def correct(self, state: FilterState, measured: np.ndarray) -> FilterState:
        """Prediction and correction of one frame (Welch & Bishop 1995), without the special cases of :meth:`step`."""
        predicted = self._transition @ state.mean
        covariance = self._transition @ state.covariance @ self._transition.T + self._q
        gain = covariance[:, 0] / (covariance[0, 0] + self.measurement_noise)
        mean = predicted + np.outer(gain, measured - predicted[0])
        return FilterState(mean, covariance - np.outer(gain, covariance[0]))
