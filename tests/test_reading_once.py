"""What the capture has read and looked at is not read and looked at again for the tracking."""

from __future__ import annotations

import sys
from collections import Counter

import numpy as np
import pytest
from recordings import SMALL, talking_head

from adaptiveface.cli import main
from adaptiveface.errors import FrameError
from adaptiveface.geometry.frame import Features2D, RgbdFrame
from adaptiveface.pipeline import FrameReader
from adaptiveface.pipeline import reader as module
from adaptiveface.sensors import Recording

SIZE = SMALL.height * SMALL.width * (4 + 3)  # bytes of a frame


class Source:
    """Frames that are alike but for their colour; the third one is broken."""

    name = "alike"

    def __init__(self):
        self.read_of = Counter()

    def __len__(self):
        return 8

    def read(self, index):
        self.read_of[index] += 1
        if index == 2:
            raise FrameError("frame 2: torn")
        shape = SMALL.height, SMALL.width
        return RgbdFrame(np.zeros(shape, np.float32), SMALL, np.full((*shape, 3), index, np.uint8), index, index / 30)


class Detector:
    """Counts the frames that it has seen, and puts that count into the features."""

    looked_at = Counter()

    def __init__(self):
        self.count = 0

    def detect(self, frame):
        self.looked_at[frame.index] += 1
        self.count += 1
        return None if frame.index == 1 else Features2D(np.full((40, 2), float(self.count)), np.ones(40))

    def close(self):
        pass


@pytest.fixture
def detectors(monkeypatch):
    monkeypatch.setattr(Detector, "looked_at", Counter())
    monkeypatch.setattr(module, "FeatureDetector", Detector)
    return Detector


def places(frames):
    return [None if f is None else f.features if f.features is None else f.features.pixels[0, 0] for f in frames]


def test_track_without_an_actor_reads_every_frame_once(tmp_path, monkeypatch, capsys):
    """The neutral frames, too, which are tracked as well."""
    actor = talking_head(tmp_path / "take", 6)
    counts, read = Counter(), Recording.read
    monkeypatch.setattr(Recording, "read", lambda self, index: (counts.update([index]), read(self, index))[1])
    monkeypatch.setattr("adaptiveface.pipeline.capture.capture_actor", lambda frames, *_: actor if len(frames) == 4 else None)
    words = ["track", str(tmp_path / "take"), "--out", str(tmp_path / "r.npz"), "--neutral-frames", "4"]
    assert main(words) == 0
    assert counts == dict.fromkeys(range(6), 1)


@pytest.mark.parametrize("room", [0, 2 * SIZE, 100 * SIZE])
def test_frames_are_looked_at_once(detectors, monkeypatch, room):
    """Where there is no room to hold a frame it is decoded again, but its features are known."""
    monkeypatch.setattr(module, "HELD_BYTES", room)
    source = Source()
    with FrameReader(source) as plain:
        expected = places([plain.read(index) for index in range(8)])
    source.read_of.clear()
    detectors.looked_at.clear()
    with FrameReader(source, remember=True) as reader:
        first = [reader.read(index) for index in range(5)]
        reader.rewind()
        second = [reader.read(index) for index in range(8)]
    held = min(room // SIZE, 4)
    assert detectors.looked_at == dict.fromkeys((0, 1, 3, 4, 5, 6, 7), 1)
    assert sum(source.read_of.values()) == 8 + 4 - held and source.read_of[2] == 1
    assert sum(a is b for a, b in zip(first, second[:5], strict=True) if a is not None) == held
    assert places(second) == expected and places(first) == expected[:5]
    assert all(np.array_equal(a.colour, b.colour) for a, b in zip(first, second, strict=False) if a is not None)
    assert reader.skipped == {2: "frame 2: torn"}


def test_after_other_frames_the_detector_begins_anew(detectors):
    """What it finds depends on what it saw before: results must not depend on which frames were the neutral."""
    with FrameReader(Source(), remember=True) as reader:
        for index in (4, 5, 6):
            reader.read(index)
        reader.rewind()
        assert places([reader.read(index) for index in range(8)]) == [1.0, None, None, 3.0, 4.0, 5.0, 6.0, 7.0]
    assert detectors.looked_at[5] == 2


def test_another_camera_is_not_forgotten(detectors):
    """A focal length that the capture finds belongs to the frames that were read before, too."""
    source = Source()
    with FrameReader(source, remember=True) as reader:
        reader.read(0)
        reader.camera_changed()
        reader.rewind()
        reader.read(0)
    assert source.read_of[0] == 2 and detectors.looked_at[0] == 1


#: What each frame passes on its way from the recording to result.npz (docs/architecture.md), in this order.
WAY = (
    "Recording.read",
    "read_depth",
    "FaceTracker.track",
    "BlendshapeFit.fit",
    "AdaptiveModel.learn",
    "ResultBuilder.add",
    "FileRows.append",
)


def test_each_frame_passes_every_station_once_and_in_order(tmp_path):
    talking_head(tmp_path / "take", frames=4).save(tmp_path / "actor.npz")
    words = ["track", str(tmp_path / "take"), "--actor", str(tmp_path / "actor.npz"), "--out", str(tmp_path / "result.npz")]
    passed = []

    def note(frame, event, _):
        if event == "call" and frame.f_code.co_qualname in WAY and "adaptiveface" in frame.f_code.co_filename:
            passed.append(frame.f_code.co_qualname)

    sys.setprofile(note)
    try:
        assert main(words) == 0
    finally:
        sys.setprofile(None)
    assert passed == [*WAY] * 4
