"""Seeded faults of a sensor, through all three threads: no crash, no hang, found again, nothing bad learned.

``python tests/fault_runs.py --runs 100`` runs many more of the same; see there for what is judged.
"""

from __future__ import annotations

import numpy as np
import pytest
from fault_runs import FAULTS, Outcome, Script, judge, learned, make_stage, run
from live_faults import STALL, ScriptedDriver, raw

from adaptiveface.errors import SensorTimeoutError
from adaptiveface.runtime.threads import one_thread
from adaptiveface.sensors.live import LiveSensor

SEEDS = range(4)


@pytest.fixture(scope="module")
def stage():
    with one_thread():
        yield make_stage()


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_does_no_harm_and_the_face_is_found_again(stage, fault, monkeypatch):
    monkeypatch.setattr("adaptiveface.sensors.live.RECONNECT_SECONDS", 0.01)
    for seed in SEEDS:
        outcome = run(stage, fault, seed)
        assert outcome.problem == "", f"seed {seed}: {outcome.problem}"
        assert outcome.relock <= 15 and outcome.off < 1.0  # mm; below 0.2 when this was written
        if fault == "duplicated, out of order":
            assert outcome.off == 0.0  # nothing has changed at all
        if fault in ("all-zero depth", "NaN depth", "leaving and re-entering"):
            assert outcome.lost > 0  # the fault was there


def test_what_is_judged_would_show_a_fault(stage):
    """A face that stays away, a frame that is missing, and a bad frame that teaches are all told."""
    tracked = [stage.clean[i] for i in range(20)]
    empty, more = (np.zeros((3, 0)), 0, 0), (np.zeros((3, 1)), 1, 1)
    script = Script([], list(range(20)), (5, 8), 8)

    def results(taught=(), gone=()):
        return [
            (stage.tracker().untracked(stage.scene(i), "gone") if i in gone else t, more if i in taught else empty)
            for i, t in enumerate(tracked)
        ]

    assert judge(stage, script, results()) == Outcome(relock=1)
    assert "taught" in judge(stage, script, results(taught=range(6, 20))).problem
    assert judge(stage, script, results(gone=range(5, 12))).relock == 5
    assert "not found again" in judge(stage, Script([], list(range(20)), (2, 3), 3), results(gone=range(3, 19))).problem
    assert judge(stage, script, results()[:-1]).problem == "19 results of 20 frames"
    elsewhere = [(tracked[(i + 9) % 20] if i >= 8 else tracked[i], empty) for i in range(20)]
    assert judge(stage, script, elsewhere).relock > 1  # tracked, but not where the head is


def test_the_stages_model_is_read_as_it_is(stage):
    class Session:
        model = stage.tracker().model

    assert learned(Session)[0].shape[1] == learned(Session)[1] == 0


def test_a_stalled_live_sensor_serves_no_old_frame(stage):
    """No frame during the stall, a timeout instead of an old one, then the newest, with every lost one counted."""
    pending: list = []

    class Stalling(ScriptedDriver):
        def grab(self, timeout):
            return pending.pop(0) if pending else STALL

    tracker = stage.tracker()
    with LiveSensor(lambda: Stalling([], live=True), max_age=60) as sensor:
        for i in range(6):
            pending.append(raw(stage.scene(i), i))
            assert tracker.track(sensor.read(30)).tracked
        with pytest.raises(SensorTimeoutError):
            sensor.read(0.05)
        pending.append(raw(stage.scene(66), 66))
        frame = sensor.read(30)
        assert frame.dropped == 60 and tracker.track(frame).tracked
