"""Colour that does not lie on the depth is said, with the likely cause; colour that does is not."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
import pytest

from adaptiveface.pipeline import capture_source, track_source
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.colour_offset import beyond_doubt


class Shifted:
    """A sensor whose pictures lie ``right`` and ``down`` px beside its depth; its features are the detector's."""

    has_features, fps, name = False, 30.0, "shifted"

    def __init__(self, sensor: SyntheticSensor, right: int, down: int) -> None:
        self._sensor, self._shift = sensor, (down, right)
        self.camera, self.depth_scale = sensor.camera, sensor.depth_scale

    def __len__(self) -> int:
        return 12

    def read(self, index: int):
        frame = self._sensor.read(index)
        return dataclasses.replace(frame, features=None, colour=np.roll(frame.colour, self._shift, (0, 1)))


@pytest.mark.parametrize(
    ("right", "down", "said"), [(0, 0, False), (20, 0, True), (-20, 0, True), (0, 20, True), (0, -20, True)]
)
def test_colour_beside_the_depth_is_said(detector, caplog, right, down, said):
    source = Shifted(SyntheticSensor(4, "structured-light", 8, 30), right, down)
    actor = capture_source(source, neutral_frames=6, detector=detector)
    with caplog.at_level(logging.WARNING, "adaptiveface"):
        result = track_source(source, actor, detector=detector)
    notes = [r.getMessage() for r in caplog.records if "not registered" in r.getMessage()]
    assert result.tracked.all() and len(notes) == said
    if said:
        assert notes[0].startswith("shifted: features lifted by the depth") and "registration" in notes[0]


@pytest.mark.parametrize(
    ("mm", "scatter", "scale", "said"),
    [
        (1.3, 0.15, 0.9, True),  # pictures 20 px too low before a TrueDepth camera
        (1.25, 1.5, 0.38, False),  # a Kinect v2, whose infrared and depth are one picture
        (1.25, 0.1, 0.38, False),  # half a pixel
        (3.5, 2.5, 0.9, False),  # no constant offset
        (0.8, 0.05, 2.0, False),
    ],
)
def test_an_offset_is_said_that_pixels_and_frames_can_tell(mm, scatter, scale, said):
    rng = np.random.default_rng(3)
    across = [0.0, mm] + scatter * rng.standard_normal((60, 2))
    found = np.column_stack([across, rng.standard_normal(60), np.full(60, scale)])
    assert beyond_doubt(found) == said
