"""Performers that are driven by a Live Link Face CSV in place of the script."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from adaptiveface.errors import AdaptiveFaceError
from adaptiveface.livelink import ARKIT_NAMES, LiveLinkTake, write_take
from adaptiveface.sensors import open_source
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.synthetic.take import read_take

REAL = Path(__file__).parents[2] / "shared" / "recordings" / "people" / "arkit" / "range_of_motion.csv"


def written(path: Path, fps: float = 60.0, seconds: float = 1.0, turn: float = 0.0) -> Path:
    """A take in which the jaw opens evenly to 0.8 and the head turns to its right by ``turn`` rad."""
    times = 3600.0 + np.arange(int(seconds * fps) + 1) / fps
    share = np.linspace(0, 1, len(times))
    curves, head = np.zeros((len(times), 52)), np.zeros((len(times), 3))
    curves[:, ARKIT_NAMES.index("jawOpen")], head[:, 0] = 0.8 * share, turn * share
    write_take(path, LiveLinkTake(times, curves, head, np.zeros((len(times), 6)), np.ones(len(times), bool)))
    return path


@pytest.mark.parametrize("fps", [24.0, 30.0, 60.0])
def test_a_take_is_sampled_in_time_whatever_its_rate(tmp_path, fps):
    take = read_take(written(tmp_path / "take.csv", fps))
    names = ("jawOpen", "mouthSmileLeft", "nobody's unit")
    values = take.activations(names, 30.0)
    assert len(values) in (30, 31) and not values[:, 1:].any()
    np.testing.assert_allclose(values[:, 0], 0.8 * np.arange(len(values)) / 30.0, atol=0.01)


def test_the_source_performs_the_take_after_the_neutral(tmp_path):
    path = written(tmp_path / "my take.csv", turn=0.3)
    sensor = open_source(f"synthetic:3:truedepth@{path}")
    assert isinstance(sensor, SyntheticSensor) and len(sensor) == sensor.neutral_frames + sensor.frames
    last = sensor.ground_truth(len(sensor) - 1)
    jaw = sensor.performer.expression_names.index("jawOpen")
    assert last.activations[jaw] > 0.7 and last.performance == 0 and not sensor.ground_truth(0).activations.any()
    assert "my take" in sensor.name


def test_the_head_turns_as_in_the_take(tmp_path):
    sensor = SyntheticSensor(3, "none", 2, take=read_take(written(tmp_path / "take.csv", seconds=3.0, turn=0.3)), colour=False)
    turn = sensor.ground_truth(len(sensor) - 1).head_pose[:3, :3]
    # Yaw counts to the subject's right: the face, +z of the head, goes to -x of the head and to the right in the picture.
    assert np.degrees(np.arcsin(-turn[0, 2])) == pytest.approx(np.degrees(0.3), abs=1.0)


def test_a_part_of_a_take(tmp_path):
    take = read_take(written(tmp_path / "take.csv", seconds=2.0))
    assert take.part(0.5, 1.0).frames(30.0) in (15, 16) and not take.turns
    with pytest.raises(AdaptiveFaceError, match="outside the take"):
        take.part(5.0, 6.0)


@pytest.mark.parametrize(
    "text", ["synthetic:3@", "synthetic:3@nowhere.csv", "synthetic:x@take.csv", "synthetic:3:loud@take.csv"]
)
def test_wrong_takes_are_one_clear_line(text):
    with pytest.raises(AdaptiveFaceError) as error:
        open_source(text)
    assert "\n" not in str(error.value)


@pytest.mark.skipif(not REAL.is_file(), reason="the real take is not here")
def test_the_real_take():
    take = read_take(REAL)
    names = SyntheticSensor(0, frames=1, colour=False).performer.expression_names
    values = take.activations(names, 30.0)
    assert 4000 < len(values) < 4100 and not take.turns  # that recorder wrote no head rotations
    assert values[:, names.index("jawOpen")].max() > 0.9 and (values.max(axis=0) > 0.05).mean() > 0.95
