"""Skins, lights and cameras of the synthetic performers: chosen by name, on the surface, and still faces for a detector."""

from __future__ import annotations

import numpy as np
import pytest

from adaptiveface.errors import FeatureDetectionError, MissingExtraError, ParameterError
from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.geometry.mesh import vertex_normals
from adaptiveface.model.skin import skin_channels
from adaptiveface.sensors.playback import SyntheticDriver
from adaptiveface.sensors.sources import open_source
from adaptiveface.synthetic.lamp import lamp
from adaptiveface.synthetic.look import CHOICES, Look, parse_performer
from adaptiveface.synthetic.pattern import noise, spots
from adaptiveface.synthetic.performer import Performer
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.synthetic.video_camera import VideoCamera, blurred

SEED = 4
PHOTOGRAPHIC = ("freckled", "bearded", "made-up", "oily")


@pytest.fixture(scope="module")
def performer() -> Performer:
    return Performer(SEED)


def sensor_of(performer: Performer, **look: str) -> SyntheticSensor:
    return SyntheticSensor(SEED, "none", 30, 90, 1, performer=performer, look=Look(**look))


@pytest.fixture(scope="module")
def pictures(performer) -> dict[str, list[RgbdFrame]]:
    """The neutral face of every skin, from the front and turned by 12 degrees."""
    return {skin: [sensor_of(performer, skin=skin).read(index) for index in (0, 7)] for skin in CHOICES["skin"]}


def seen(performer: Performer, index: int, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values (V, C) of an image at the vertices of the tracking mesh, and which of those face the camera, (V,)."""
    sensor = SyntheticSensor(SEED, "none", 30, 90, 1, performer=performer, colour=False)
    vertices = sensor.ground_truth(index).vertices
    u, v = np.round(sensor.camera.project(vertices)).astype(int).T
    normals = vertex_normals(vertices, performer.triangles)
    facing = -np.einsum("vd,vd->v", normals, vertices) / np.linalg.norm(vertices, axis=1) > 0.7
    return image[np.clip(v, 0, 479), np.clip(u, 0, 639)].astype(float), facing & performer.model.depth_valid


def test_names_say_what_is_shown():
    assert parse_performer("") == (None, None, Look())
    assert parse_performer("7:truedepth") == (7, "truedepth", Look())
    assert parse_performer("7:skin=oily:camera=video") == (7, None, Look(skin="oily", camera="video"))
    look = Look("made-up", "moving", "video")
    assert parse_performer(f"3:none:{look}") == (3, "none", look) and str(Look()) == ""
    sensor = open_source("synthetic:3:none:skin=bearded:light=changing")
    assert sensor.look == Look("bearded", "changing") and "skin bearded, light changing" in sensor.name
    assert SyntheticDriver.named("5:skin=even")().source.look == Look("even")


@pytest.mark.parametrize("text", ["1:loud", "x", "1:skin=blue", "1:hair=red", "1:skin=oily:none", "1:skin=oily:skin=even"])
def test_wrong_names_are_told(text):
    with pytest.raises(ParameterError, match="oily|digits"):
        open_source(f"synthetic:{text}")


def test_the_default_is_the_simple_skin(performer, pictures):
    plain = SyntheticSensor(SEED, "none", 30, 90, 1, performer=performer).read(7)
    np.testing.assert_array_equal(plain.colour, pictures["drawn"][1].colour)
    for skin in CHOICES["skin"][1:]:
        assert not np.array_equal(pictures[skin][1].colour, plain.colour)
        np.testing.assert_array_equal(pictures[skin][1].depth, plain.depth)


@pytest.mark.parametrize("skin", PHOTOGRAPHIC)
def test_the_pattern_sticks_to_the_skin(performer, pictures, skin):
    """Colour differences at the same vertices, front and turned: alike, far above what the same face without pattern shows."""
    (front, first), (turned, second) = (
        seen(performer, index, skin_channels(frame.colour)) for index, frame in zip((0, 7), pictures[skin], strict=True)
    )
    both = first & second
    assert both.sum() > 500
    assert np.corrcoef(front[both, 1], turned[both, 1])[0, 1] > 0.5


def test_gloss_moves_over_oily_skin(performer, pictures):
    """From another side the highlights lie elsewhere; matt skin only gets a little brighter or darker."""
    changes = {}
    for skin in ("freckled", "oily"):
        values = [seen(performer, index, frame.colour) for index, frame in zip((0, 7), pictures[skin], strict=True)]
        both = values[0][1] & values[1][1]
        ratio = np.log((values[1][0].mean(axis=1) + 1)[both] / (values[0][0].mean(axis=1) + 1)[both])
        changes[skin] = np.percentile(ratio, 98) - np.percentile(ratio, 50)
    assert changes["oily"] > 1.5 * changes["freckled"]


def test_even_skin_has_no_pattern(performer, pictures):
    def contrast(skin: str) -> float:
        values, face = seen(performer, 0, pictures[skin][0].colour)
        shade = np.log(values[face, 0] / values[face, 2])  # red against blue: no shading
        return float(np.median(np.abs(shade - np.median(shade))))

    assert contrast("even") < 0.7 * contrast("drawn")


def test_what_pixels_cannot_show_is_left_out():
    rng = np.random.default_rng(0)
    points = rng.uniform(-50, 50, (4000, 3))
    near, far = np.full(4000, 0.1), np.full(4000, 2.0)
    assert 0.8 < noise(points, near, (3.0,), (1.0,), 5).std() < 1.2
    assert noise(points, far, (3.0,), (1.0,), 5).std() == 0.0
    assert 0.4 < spots(points, near, np.ones(4000), 3.0, (0.8, 0.9), 5).max() < 2.0  # two may overlap
    assert spots(points, np.full(4000, 4.0), np.ones(4000), 3.0, (0.8, 0.9), 5).max() == 0.0


def test_lights_move_and_change():
    directions = np.array([lamp("moving", t).light.key_direction for t in np.arange(0, 7, 0.5)])
    assert np.ptp(directions[:, 0]) > 1.5 and np.ptp([lamp("moving", 0).brightness, lamp("moving", 1.75).brightness]) > 0.1
    assert lamp("changing", 1.0).brightness.mean() > 1.5 * lamp("changing", 3.0).brightness.mean()
    steps = [lamp("changing", t).brightness for t in np.arange(0, 10, 1 / 300)]
    assert np.abs(np.diff(steps, axis=0)).max() < 0.06  # lamps take a moment


def test_gain_follows_the_light_late():
    """The lamps change 2.5 s after the start: the picture is dark for a while, then as bright as before."""
    camera = VideoCamera("changing", 30.0)
    level = [float((camera.gain(k) * lamp("changing", k / 30.0).brightness).mean()) for k in range(60, 140)]
    before, dark, after = level[10], min(level[16:26]), level[72]
    assert dark < 0.75 * before and after == pytest.approx(before, rel=0.1)


def test_motion_blurs_and_noise_follows_the_light():
    edge = np.zeros((40, 60, 3), np.float32)
    edge[:, 30:] = 200.0
    motion = np.zeros((40, 60, 2))
    np.testing.assert_array_equal(blurred(edge, motion), edge)
    motion[..., 0] = 10.0
    assert 2 <= ((blurred(edge, motion)[20, :, 0] % 200) > 0).sum() <= 6
    camera = VideoCamera("steady", 30.0)
    dark, bright = (
        camera.develop(np.full((80, 80, 3), level, np.float32), np.zeros((80, 80, 2)), 0, np.random.default_rng(1))
        for level in (70.0, 200.0)
    )
    assert 0.5 < bright.std() < dark.std() < 8.0  # in sRGB, dark is noisier


def test_every_look_is_a_function_of_the_frame(performer):
    first, second = (sensor_of(performer, skin="oily", light="moving", camera="video") for _ in range(2))
    for index in (70, 40):
        second.read(index)
    np.testing.assert_array_equal(first.read(40).colour, second.read(40).colour)


@pytest.mark.parametrize("skin", CHOICES["skin"])
def test_the_detector_finds_every_skin(performer, skin):
    from adaptiveface.landmarks import FeatureDetector

    try:
        detector = FeatureDetector()
    except (MissingExtraError, FeatureDetectionError) as reason:
        pytest.skip(str(reason))
    errors = []
    for light, camera in (("steady", "plain"), ("changing", "video"), ("moving", "video")):
        sensor = sensor_of(performer, skin=skin, light=light, camera=camera)
        for index in (3, 80, 110):
            found = detector.look(sensor.read(index))
            assert found is not None
            errors.append(np.linalg.norm(found.pixels - sensor.ground_truth(index).features, axis=1))
    detector.close()
    assert np.nanmedian(errors) < 2.0
