"""Kalman filter on the blendshape coefficients: position and velocity (section 4.2; Welch & Bishop 1995)."""

from __future__ import annotations

import numpy as np

from ..parameters import KalmanParameters


class CoefficientFilter:
    """One constant-velocity filter per coefficient; all share the 2 x 2 covariance, since noises are equal.

    State (2, A): coefficient and its velocity per frame. The paper names a process noise of 0.05 and a measurement noise
    of 0.02 without saying how they enter. ``kalman.model``:

    * ``"variance"`` (default): Q = 0.05 I, R = 0.02, time in frames: a gain of about 0.9, little smoothing, no lag;
    * ``"acceleration"``: 0.05 and 0.02 are the variances of a white acceleration and of the measurement, time in seconds
      at 30 frames a second: a gain of about 0.06, a lag of some twenty frames;
    * ``"off"``: the measured coefficients pass unchanged.
    """

    def __init__(self, parameters: KalmanParameters) -> None:
        dt = 1.0 if parameters.model == "variance" else 1.0 / 30.0
        q = parameters.process_noise
        self._transition = np.array([[1.0, dt], [0.0, 1.0]])
        self._q = q * np.eye(2)
        if parameters.model == "acceleration":
            self._q = q * np.array([[dt**4 / 4, dt**3 / 2], [dt**3 / 2, dt**2]])
        self._r = parameters.measurement_noise
        self._off = parameters.model == "off"
        self.reset()

    def reset(self) -> None:
        """Forget the past (first frame, or the track was lost)."""
        self._state: np.ndarray | None = None
        self._covariance = np.eye(2)

    def update(self, measured: np.ndarray) -> np.ndarray:
        """Filter the coefficients (A,) of one frame; returns (A,)."""
        if self._off:
            return measured
        if self._state is None:
            self._state = np.stack([measured, np.zeros_like(measured)])
            return measured
        predicted = self._transition @ self._state
        covariance = self._transition @ self._covariance @ self._transition.T + self._q
        gain = covariance[:, 0] / (covariance[0, 0] + self._r)
        self._state = predicted + np.outer(gain, measured - predicted[0])
        self._covariance = covariance - np.outer(gain, covariance[0])
        return self._state[0]
