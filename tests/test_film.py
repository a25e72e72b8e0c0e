"""Films last as long as their take, and are drawn fast by the same light as other pictures."""

from __future__ import annotations

import dataclasses
import time

import cv2
import numpy as np
import pytest
from export_scene import tracked_result
from PIL import Image

from adaptiveface import cli
from adaptiveface.export.video import AHEAD, PANEL, side_by_side, tracked_panel, write_film
from adaptiveface.geometry import rendering
from adaptiveface.geometry.painting import lit, paint
from adaptiveface.geometry.rendering import picture
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.portrait import FACING, painted_portrait, portrait
from adaptiveface.runtime.timing import duration
from adaptiveface.sensors.recording import Recording, RecordingWriter
from adaptiveface.synthetic.sensor import SyntheticSensor


@pytest.fixture(scope="module")
def result():
    return tracked_result()[1]


def numbered(frame: int) -> np.ndarray:
    """A panel whose grey value tells the frame."""
    return np.full((PANEL, PANEL, 3), 10 * frame, np.uint8)


def film(path) -> tuple[np.ndarray, float]:
    """Which frame each picture of an .mp4 shows, and its rate."""
    capture = cv2.VideoCapture(str(path))
    shown = []
    while True:
        good, image = capture.read()
        if not good:
            return np.array(shown), capture.get(cv2.CAP_PROP_FPS)
        shown.append(round(float(image[200:].mean()) / 10))


TAKES = {
    "even": np.arange(24) / 30,
    "29.97": np.arange(24) * 1001 / 30000,
    "dropped": (np.arange(24) + 12 * (np.arange(24) >= 10)) / 30,
    "slow": np.arange(24) / 12.5,
    "varying": np.cumsum(np.r_[0.0, np.full(11, 0.04), np.full(12, 0.12)]),
    "epoch": 1.7e9 + np.arange(24) / 30,
}


@pytest.mark.parametrize("name", TAKES)
def test_an_mp4_lasts_as_long_as_its_take(tmp_path, name):
    times = TAKES[name] - TAKES[name][0]
    write_film(tmp_path / "film.mp4", [numbered], [""], times)
    shown, rate = film(tmp_path / "film.mp4")
    assert len(shown) / rate == pytest.approx(duration(times), abs=0.5 / rate + 1e-3)
    for k, number in enumerate(shown):
        assert abs(k / rate - times[number]) <= 0.51 / rate or times[number] < k / rate < np.append(times, 1e9)[number + 1]
    assert set(shown) == set(range(24))


@pytest.mark.parametrize("name", TAKES)
def test_a_gif_lasts_as_long_as_its_take(tmp_path, name):
    times = TAKES[name] - TAKES[name][0]
    write_film(tmp_path / "film.gif", [numbered], [""], times)
    total = 0
    with Image.open(tmp_path / "film.gif") as image:
        for k in range(image.n_frames):
            image.seek(k)
            assert image.info["duration"] >= 20
            total += image.info["duration"]
    assert total / 1000 == pytest.approx(duration(times), abs=0.06)


@pytest.mark.parametrize("kind", ["mp4", "gif"])
def test_the_command_films_a_take_with_dropped_frames_at_its_true_length(result, tmp_path, kind):
    dataclasses.replace(result, timestamps=TAKES["dropped"]).save(tmp_path / "r.npz")
    out = tmp_path / f"r.{kind}"
    assert cli.main(["export", str(tmp_path / "r.npz"), "--format", kind, "--out", str(out)]) == 0
    if kind == "mp4":
        shown, rate = film(out)
        assert (len(shown), rate) == (36, 30)
        return
    with Image.open(out) as image:
        delays = [image.seek(k) or image.info["duration"] for k in range(image.n_frames)]
    assert sum(delays) / 1000 == pytest.approx(1.2, abs=0.01) and max(delays) >= 400


def test_a_panel_is_drawn_once_a_frame_in_order_and_not_far_ahead():
    drawn = []

    def panel(frame: int) -> np.ndarray:
        drawn.append(frame)
        return numbered(frame)

    pictures = side_by_side([panel, numbered], ["a", "b"], [0, 0, 0, *range(1, 20), 19])
    first = next(pictures)
    assert first.shape == (PANEL, 2 * PANEL, 3)
    time.sleep(0.2)
    assert len(drawn) <= AHEAD + 2
    assert len(list(pictures)) == 22 and drawn == list(range(20))


def test_an_error_in_a_panel_ends_the_film():
    def panel(frame: int) -> np.ndarray:
        if frame == 9:
            raise ValueError("frame 9")
        return numbered(frame)

    with pytest.raises(ValueError, match="frame 9"):
        list(side_by_side([panel], ["a"], range(30)))


def test_painted_pictures_are_those_of_the_rays(result):
    sensor = SyntheticSensor(1, "none", 2, 2)
    points, triangles = result.vertices[5].astype(float), np.ascontiguousarray(result.triangles, np.int64)
    rays = picture(sensor.camera, points, triangles)
    painted = paint(sensor.camera, points, triangles, lit(points, triangles, (205, 170, 150)), cull=True)
    difference = np.abs(rays.astype(float) - painted).max(axis=2)
    assert (rays.min(axis=2) < 250).mean() > 0.02 and difference.mean() < 0.3
    inside = cv2.erode((painted.min(axis=2) < 250).astype(np.uint8), np.ones((5, 5))) > 0
    assert np.percentile(difference[inside], 95) < 4


@pytest.mark.parametrize("name", ["baby", "hag", "ogre"])
def test_painted_characters_are_those_of_the_portraits(name):
    character = load_character(name)
    rays = portrait(character, character.neutral, 300, rays=1)
    painted = painted_portrait(character, character.neutral, 300, FACING)
    assert np.abs(rays.astype(float) - painted).mean() < 1.0


def test_nothing_behind_the_camera_is_painted(result):
    camera = SyntheticSensor(1, "none", 2, 2).camera
    points, triangles = -result.vertices[0].astype(float), np.ascontiguousarray(result.triangles, np.int64)
    assert (paint(camera, points, triangles, np.zeros(points.shape, np.uint8)) == 255).all()


def test_panels_are_painted_and_not_cast_ray_by_ray(result, monkeypatch):
    # Rays take two to three times as long, and a film has hundreds of pictures.
    def cast(*arguments, **options):
        raise AssertionError("a film's panel was ray-cast")

    monkeypatch.setattr(rendering, "ray_cast", cast)
    with pytest.raises(AssertionError, match="ray-cast"):
        portrait(load_character("hag"), load_character("hag").neutral, PANEL, rays=1)
    assert np.ptp(tracked_panel(result)(3)) > 100
    character = load_character("hag")
    assert np.ptp(painted_portrait(character, character.neutral, PANEL, FACING)) > 100


def test_a_recordings_colour_is_read_without_its_depth(tmp_path):
    sensor = SyntheticSensor(2, "none", 2, 2)
    with RecordingWriter(tmp_path / "take", sensor.camera) as writer:
        for frame in sensor:
            writer.write(frame)
    recording = Recording(tmp_path / "take")
    wanted = [recording.read(k).colour for k in range(len(recording))]
    for depth in (tmp_path / "take" / "depth").iterdir():
        depth.write_bytes(b"damaged")
    for k, colour in enumerate(wanted):
        np.testing.assert_array_equal(recording.read_colour(k), colour)
    with pytest.raises(IndexError):
        recording.read_colour(99)
