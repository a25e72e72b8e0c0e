"""Errors that many landmarks share: they are eliminated from the fit, and do not turn the head."""

from __future__ import annotations

import numpy as np
import pytest
from test_feature_sets import CAMERA, MODEL, NAMES, detected, off_by, seen, turned

from adaptiveface.neutral.capture import build_actor
from adaptiveface.tracking.colour_tracker import ColourTracker
from adaptiveface.tracking.shared_errors import SharedErrors, errors_of, measured_errors


def test_eliminating_them_is_generalised_least_squares():
    rng = np.random.default_rng(1)
    jacobian, target, weights = rng.normal(size=(12, 5)), rng.normal(size=12), rng.uniform(0.5, 2.0, 12)
    modes = rng.normal(size=(8, 2, 3))
    index = np.array([0, 2, 3, 5, 6, 7])
    h, g = SharedErrors(modes, 0.7).explained(index, np.eye(4), jacobian, target, weights)
    common = modes[index].reshape(12, 3)
    precision = np.linalg.inv(np.diag(1.0 / weights) + common @ common.T / 0.7)
    np.testing.assert_allclose((jacobian.T * weights) @ jacobian - h, jacobian.T @ precision @ jacobian, atol=1e-10)
    np.testing.assert_allclose((jacobian.T * weights) @ target - g, jacobian.T @ precision @ target, atol=1e-10)


def test_they_turn_with_a_head_that_leans_to_the_side():
    leaning = np.eye(4)
    leaning[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    sideways, jacobian = np.array([[[1.0], [0.0]]]), np.eye(2)
    h, _ = SharedErrors(sideways, 1.0).explained(np.array([0]), leaning, jacobian, np.zeros(2), np.ones(2))
    np.testing.assert_allclose(h, [[0.0, 0.0], [0.0, 0.5]], atol=1e-12)


def test_landmarks_that_were_not_measured_have_none():
    ids, _ = measured_errors()
    unknown = np.setdiff1d(np.arange(478), ids)[:2]
    assert not errors_of(unknown).any()
    assert errors_of(ids).any()


@pytest.mark.parametrize("number", range(4))
def test_they_do_not_turn_the_head(number):
    pose, x = turned(8.0, 5.0), np.zeros(len(NAMES))
    landmarks = MODEL.landmarks
    error = 1.5 * 2.0 * errors_of(landmarks.ids)[:, :, number]  # in full size: half of it is taken
    frame = seen(MODEL.mean, x, pose)
    pixels = landmarks.pixels(frame.features) + error * CAMERA.fx / pose[2, 3]
    frame = detected(frame, pixels)

    def turn(tracker: ColourTracker) -> float:
        for _ in range(8):
            tracked = tracker.track(frame)
        return off_by(tracked.head_pose, pose)

    actor = build_actor(MODEL, MODEL.mean)
    believing = ColourTracker(actor)
    believing._shared_errors = lambda: None
    assert turn(ColourTracker(actor)) < 0.75 * turn(believing)
