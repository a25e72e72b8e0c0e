"""Faces that are small in their picture: found in windows, followed in their own, the kept one of several."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.landmarks import FeatureDetector
from adaptiveface.landmarks.windows import LARGE, own_window, search_windows
from adaptiveface.synthetic.sensor import SyntheticSensor


@pytest.fixture(scope="module")
def head():
    """A picture (H, W, 3) of a performer's face, 116 px wide."""
    colour = SyntheticSensor(4, "none", 4, 4).read(1).colour
    return colour[110:390, 183:463]


@pytest.fixture
def fresh(detector):
    detector.forget()
    yield detector
    detector.forget()


def scene(heads, size, time=0.0) -> RgbdFrame:
    """A colour frame of ``size`` (width, height) with pictures at their (u, v)."""
    width, height = size
    colour = np.full((height, width, 3), 120, np.uint8)
    colour += np.linspace(0, 60, width).astype(np.uint8)[None, :, None]
    for picture, (u, v) in heads:
        colour[v : v + picture.shape[0], u : u + picture.shape[1]] = picture
    return RgbdFrame(
        np.zeros((height, width), np.float32),
        Camera(*size, width, width, width / 2, height / 2),
        colour,
        round(30 * time),
        time,
    )


def shrunk(head, width):
    """The picture with its face about ``width`` px wide."""
    share = width / 116
    return cv2.resize(head, None, fx=share, fy=share, interpolation=cv2.INTER_AREA if share < 1 else cv2.INTER_LINEAR)


@pytest.mark.parametrize("size", [(1920, 1080), (1280, 720), (1080, 1920), (1000, 1000), (640, 480), (3840, 2160)])
@pytest.mark.parametrize("share", [0.085, 0.072])
@pytest.mark.parametrize("place", [(0.05, 0.1), (0.5, 0.5), (0.95, 0.85)])
def test_a_small_face_is_found_wherever_it_is(fresh, head, size, share, place):
    small = shrunk(head, share * max(size))
    corner = [round(p * (s - n)) for p, s, n in zip(place, size, small.shape[1::-1], strict=True)]
    frame = scene([(small, corner)], size)
    assert not fresh.detect_faces(frame.colour)  # as a whole it shows none
    features = fresh.detect(frame)
    assert features is not None and features.valid.sum() == 40
    inside = features.pixels - corner
    assert (inside > 0).all() and (inside < small.shape[1::-1]).all()
    large = fresh.look(RgbdFrame(np.zeros(head.shape[:2], np.float32), frame.camera, np.ascontiguousarray(head)))
    error = np.linalg.norm(inside - large.pixels * small.shape[1] / head.shape[1], axis=1)
    assert np.median(error) < 0.03 * small.shape[1]


def test_it_is_followed_with_one_search_a_frame(fresh, head, monkeypatch):
    small, searched = shrunk(head, 120), []
    look = FeatureDetector.detect_faces
    monkeypatch.setattr(FeatureDetector, "detect_faces", lambda self, c: searched.append(c.shape) or look(self, c))
    for k in range(12):
        features = fresh.detect(scene([(small, (300 + 15 * k, 200))], (1920, 1080), k / 30))
        assert features is not None and 300 + 15 * k < features.pixels[:, 0].mean() < 300 + 15 * k + small.shape[1]
    assert searched[0] == (1080, 1920, 3) and len(searched) <= 4 + 11
    assert all(max(shape) < 800 for shape in searched[4:])
    assert fresh.detect(scene([], (1920, 1080), 12 / 30)) is None  # it has left: everything is searched again
    assert fresh.detect(scene([(small, (1500, 500))], (1920, 1080), 2.0)) is not None


def test_of_two_small_faces_the_kept_one_stays(fresh, head):
    small, other = shrunk(head, 130), shrunk(head, 150)
    for k in range(10):
        heads = [(small, (400 + 10 * k, 300))] + ([(other, (1400, 300))] if k >= 2 else [])
        features = fresh.detect(scene(heads, (1920, 1080), k / 30))
        assert abs(features.pixels[:, 0].mean() - (400 + 10 * k + small.shape[1] / 2)) < 40


def test_a_large_face_is_found_as_ever(fresh, head, monkeypatch):
    frame, searched = scene([(head, (200, 50))], (640, 480)), []
    look = FeatureDetector.detect_faces
    monkeypatch.setattr(FeatureDetector, "detect_faces", lambda self, c: searched.append(c.shape) or look(self, c))
    for _ in range(3):
        assert fresh.detect(frame) is not None
    assert searched == [(480, 640, 3)] * 3


def test_a_stream_searches_one_window_a_frame(detector, head, monkeypatch):
    video = FeatureDetector(video=True)
    searched = []
    look = FeatureDetector.detect_faces
    monkeypatch.setattr(FeatureDetector, "detect_faces", lambda self, c: searched.append(c.shape) or look(self, c))
    small = shrunk(head, 140)
    found = [video.detect(scene([(small, (1500, 300))], (1920, 1080), k / 30)) is not None for k in range(8)]
    video.close()
    assert any(found[:3]) and all(found[3:]) and 0 < len(searched) <= 8


@pytest.mark.parametrize("size", [(1920, 1080), (1080, 1920), (640, 480), (500, 500), (4000, 500), (64, 64), (1, 1)])
def test_windows_lie_inside_and_overlap(size):
    width, height = size
    covered = np.zeros((height, width), int)
    for u, v, right, bottom in search_windows(height, width):
        assert 0 <= u < right <= width and 0 <= v < bottom <= height
        covered[v:bottom, u:right] += 1
    assert width / height > 3 or (covered > 0).all()


def test_a_faces_own_window_stays_in_the_picture_and_ends_when_it_is_large():
    rng = np.random.default_rng(0)
    for _ in range(200):
        width, height = rng.integers(100, 2000, 2)
        size = rng.uniform(5, LARGE * max(width, height))
        mesh = rng.uniform([-20, -20], [width, height]) + rng.uniform(0, size, (30, 2))
        u, v, right, bottom = own_window(mesh, int(height), int(width))
        assert 0 <= u < right <= width and 0 <= v < bottom <= height
    assert own_window(np.array([[0.0, 0], [400, 400]]), 1080, 1920) is None
