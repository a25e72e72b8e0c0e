"""The measure that the sensors' tests share: zero for the same frames, and not blind to a wrong sensor."""

from __future__ import annotations

import dataclasses

import numpy as np
from equivalence import performance, units_of

from adaptiveface.geometry.camera import Camera


def test_the_same_frames_give_exactly_the_same_result():
    p = performance()
    result = p.compare(p.quantised(1000), 1000)
    assert result.worst == 0 and result.frames == len(p) == 35
    for frame, recorded in zip(p.quantised(1000), p.recording(1000), strict=True):
        np.testing.assert_array_equal(frame.depth, recorded.depth)
        np.testing.assert_array_equal(units_of(frame, 1000), recorded.depth.astype(np.uint16))


def test_it_sees_a_wrong_calibration_and_frames_in_disorder():
    p = performance()
    c = p.camera
    wrong = Camera(c.width, c.height, c.fx, c.fy, c.cx + 1, c.cy)
    assert p.compare((dataclasses.replace(f, camera=wrong) for f in p.quantised(1000)), 1000).worst > 0.5
    late = [p.frames[max(n - 1, 0)] for n in range(len(p))]
    assert p.compare(late, 10_000, range(len(p))).worst > 0.3


def test_frames_are_told_by_their_depth():
    p = performance()
    order = [3, 20, 7, 34, 0]
    assert p.numbers_of([p.quantised(1000)[n] for n in order]) == order


def test_what_quantising_alone_costs():
    """Whole millimetres against tenths: below what the sensors' tests allow for a format that keeps depth exactly."""
    p = performance()
    result = p.compare(p.quantised(1000), 10_000)
    print(f"\ndepth in whole millimetres instead of tenths: {result}")
    assert 0 < result.worst < 0.2
