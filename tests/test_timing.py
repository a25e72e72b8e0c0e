"""The time of a frame: units, single wrong values, clocks that start again, rates, and how long films last."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from export_scene import tracked_result

from adaptiveface.cli import main
from adaptiveface.errors import FileFormatError
from adaptiveface.export.animation import actor_animation
from adaptiveface.runtime.timing import (
    STANDARD_RATES,
    clean_times,
    duration,
    film_frames,
    frame_rate,
    frame_times,
    gif_frames,
    increasing,
    standard_rate,
    time_codes,
)
from adaptiveface.sensors.tables import read_timestamps

GOOD = np.arange(74) / 30  # 0 to 2.433 s


def times(values, fps: float = 30.0):
    return frame_times(dict(enumerate(values)), len(values), fps, "take/timestamps.csv")


@pytest.mark.parametrize("start", [0.0, 12.5, 1.7e9])
@pytest.mark.parametrize("fps", [15.0, 30.0, 60.0])
@pytest.mark.parametrize(
    ("per_second", "unit"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e7, "100 ns"), (1e9, "nanoseconds")]
)
def test_other_units_become_seconds_with_one_line(start, fps, per_second, unit):
    found = times((start + np.arange(74) / fps) * per_second, fps)
    np.testing.assert_allclose(np.diff(found.seconds), 1 / fps, atol=1e-6)
    (note,) = found.notes
    assert unit in note and "take/timestamps.csv" in note and f"{per_second / fps:.6g}"[:4] in note


def test_frame_numbers_are_told_from_seconds():
    found = times(np.arange(100, 174))
    np.testing.assert_allclose(found.seconds - found.seconds[0], GOOD)
    assert "counts frames" in found.notes[0]


@pytest.mark.parametrize("factor", [100.0, 25.0, 1 / 60, 1 / 3600])
def test_a_step_that_fits_no_unit_is_refused_with_file_and_values(factor):
    with pytest.raises(FileFormatError, match=r"take/timestamps\.csv: a median step of .* does not fit 30 frames"):
        times(GOOD * factor)


@pytest.mark.parametrize("fps", [8.0, 15.0, 29.97, 60.0, 90.0])
def test_seconds_at_another_rate_than_the_stated_one_stay(fps):
    found = times(np.arange(30) / fps)
    np.testing.assert_allclose(found.seconds, np.arange(30) / fps)
    assert not found.notes


@pytest.mark.parametrize("start", [0.0, 1.7e9])
@pytest.mark.parametrize("unit", [1.0, 1e3])
@pytest.mark.parametrize("frame", [0, 1, 20, 72, 73])
@pytest.mark.parametrize("value", ["the last", 0.0, -1e6, 1e12, "the next"])
def test_one_wrong_value_is_repaired_alone_and_said(start, unit, frame, value):
    values = (start + GOOD) * unit
    if isinstance(value, str):
        value = values[max(frame - 1, 0) if value == "the last" else min(frame + 1, 73)]
    if values[frame] == value:
        return
    values[frame] = value
    found = times(values)
    np.testing.assert_allclose(found.seconds, start + GOOD, atol=0.034)
    others = np.setdiff1d(np.arange(74), [frame - 1, frame, frame + 1])
    np.testing.assert_allclose(found.seconds[others], start + GOOD[others], atol=1e-6)
    assert (np.diff(found.seconds) > 0).all()
    note = found.notes[-1]
    assert "1 time does not fit" in note and "take/timestamps.csv" in note


def test_several_wrong_values_are_repaired_and_all_others_kept():
    values = GOOD.copy()
    values[[5, 6, 30, 60]] = [GOOD[4], GOOD[4], 700.0, 0.0]
    found = times(values)
    np.testing.assert_allclose(found.seconds, GOOD, atol=1e-9)
    assert "4 times do not fit" in found.notes[0]


@pytest.mark.parametrize("start", [0.0, 5e5])
def test_a_clock_that_starts_again_goes_on(start):
    found = times(np.concatenate([start + GOOD[:30], GOOD[:44]]))
    np.testing.assert_allclose(found.seconds - found.seconds[0], GOOD, atol=1e-6)
    assert "starts again at frame 30" in found.notes[0]


def test_pauses_and_dropped_frames_are_real():
    for take in (GOOD[np.r_[0:20, 30:74]], np.concatenate([GOOD[:30], 40 + GOOD[30:]])):
        found = times(take)
        np.testing.assert_allclose(found.seconds, take)
        assert not found.notes


def test_a_clock_of_whole_seconds_keeps_the_length():
    found = times(np.floor(np.arange(300) / 30))
    assert (np.diff(found.seconds) > 0).all() and found.seconds[-1] == pytest.approx(299 / 30, abs=1 / 30)


def test_times_that_never_rise_are_those_of_the_rate():
    for take in (np.zeros(74), GOOD[::-1]):
        found = times(take)
        np.testing.assert_allclose(found.seconds - found.seconds[0], GOOD)
        assert "do not rise" in found.notes[0]


def test_any_times_end_increasing():
    rng = np.random.default_rng(5)
    for _ in range(60):
        values = np.cumsum(rng.choice([0.0, 0.033, -0.5, 1e-9, 40.0, np.nan], size=rng.integers(1, 80)))
        out = increasing(values)
        assert len(out) == len(values) and np.isfinite(out).all() and (np.diff(out) > 0).all()


def test_a_table_in_milliseconds_is_read_as_seconds(tmp_path):
    path = tmp_path / "timestamps.csv"
    path.write_text("frame,timestamp\n" + "".join(f"{k},{1000 * t:.0f}\n" for k, t in enumerate(GOOD)))
    found = read_timestamps(path, range(74), 30.0)
    np.testing.assert_allclose(found.seconds, GOOD, atol=6e-4)
    assert str(path) in found.notes[0] and "milliseconds" in found.notes[0]


@pytest.mark.parametrize("rate", STANDARD_RATES)
def test_rates_are_snapped_to_the_standard(rate):
    assert standard_rate(rate * 1.0004) == pytest.approx(rate, rel=1e-12)
    for digits in (3, 6):
        assert frame_rate(np.round(np.arange(300) / rate, digits)) == pytest.approx(rate, rel=1e-12)
    assert frame_rate(np.arange(90) * round(1 / rate, 6)) == pytest.approx(rate, rel=1e-12)


def test_an_odd_rate_stays():
    assert frame_rate(np.arange(90) / 17.3) == pytest.approx(17.3) and frame_rate(np.zeros(1)) == 30


def test_codes_are_whole_where_the_times_lie_on_the_rate():
    codes = time_codes(np.round(np.arange(90) * 1001 / 30000, 6), 30000 / 1001)
    assert (codes == np.arange(90)).all()
    assert time_codes(np.array([0.5 / 30]), 30.0)[0] == pytest.approx(0.5)


def test_a_film_lasts_as_long_as_the_take_and_repeats_where_frames_were_dropped():
    kept = np.r_[0:20, 30:74]
    rate, shown = film_frames(GOOD[kept])
    assert rate == 30 and len(shown) == 74 and (shown[19:30] == 19).all() and shown[30] == 20
    assert sorted(set(shown)) == list(range(64))
    jittered = np.sort(GOOD + np.random.default_rng(1).uniform(-0.01, 0.01, 74))
    rate, shown = film_frames(jittered - jittered[0])
    assert rate == pytest.approx(30, rel=2e-3) and len(shown) / rate == pytest.approx(duration(jittered), abs=1 / 30)


def test_a_film_of_a_varying_rate_shows_every_frame():
    varying = np.concatenate([np.arange(20) * 0.04, 0.8 + np.arange(38) * 0.1])
    rate, shown = film_frames(varying)
    assert set(shown) == set(range(58)) and len(shown) / rate == pytest.approx(duration(varying), abs=0.05)


@pytest.mark.parametrize("rate", [10.0, 12.5, 15.0, 1000 / 60, 24.0, 25.0, 30000 / 1001, 30.0, 60.0, 120.0])
def test_the_delays_of_a_gif_add_up_to_the_take(rate):
    take = np.arange(round(20 * rate)) / rate
    shown, delays = gif_frames(take)
    assert delays.sum() / 1000 == pytest.approx(duration(take), abs=0.07)
    assert (delays >= 20).all() and (delays % 10 == 0).all()
    starts = np.concatenate([[0], np.cumsum(delays)[:-1]]) / 1000
    assert np.abs(starts - take[shown]).max() <= 0.5 / 15 + 0.006


def test_a_take_of_years_is_refused():
    with pytest.raises(FileFormatError, match="a film at most"):
        film_frames(np.array([0.0, 0.03, 0.06, 1e9]))


# ---- what follows it ----
@pytest.fixture(scope="module")
def result():
    return tracked_result()[1]


def test_usd_counts_in_the_standard_rate(result, tmp_path):
    pytest.importorskip("pxr")
    from pxr import Usd
    from written import read_usd

    from adaptiveface.export.usd import write_usd

    take = dataclasses.replace(result, timestamps=np.arange(len(result)) * 0.033367)  # 29.96973 a second, as printed
    write_usd(tmp_path / "a.usda", actor_animation(take))
    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    assert stage.GetTimeCodesPerSecond() == pytest.approx(30000 / 1001, rel=1e-12)
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, len(result) - 1)
    np.testing.assert_allclose(read_usd(tmp_path / "a.usda").timestamps, take.timestamps, atol=1e-4)


def test_an_export_says_what_it_repaired_and_keeps_the_length(result, tmp_path, capsys):
    values = np.arange(len(result)) / 30
    values[3] = values[2]
    dataclasses.replace(result, timestamps=values).save(tmp_path / "r.npz")
    assert main(["export", str(tmp_path / "r.npz"), "--format", "arkit-csv", "--out", str(tmp_path / "r.csv")]) == 0
    printed = capsys.readouterr().out
    assert "r.npz" in printed and "frame 3" in printed
    last = (tmp_path / "r.csv").read_text().splitlines()[-1].split(",")[0]
    seconds, frame = last.split(":")[-2:]
    assert int(seconds) + float(frame) / 60 == pytest.approx(values[-1], abs=1e-4)
    np.testing.assert_allclose(clean_times(values).seconds, np.arange(len(result)) / 30, atol=1e-9)
