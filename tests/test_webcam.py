"""Colour only: video files and cameras through OpenCV's real VideoCapture, tracked with the real MediaPipe."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import cv2
import numpy as np
import pytest
from live_faults import ScriptedDriver, raw, without_depth

from adaptiveface.errors import (
    EndOfRecording,
    FileFormatError,
    FrameError,
    ParameterError,
    SensorDisconnectedError,
    SensorError,
    SensorNotFoundError,
)
from adaptiveface.evaluation import ErrorCollector
from adaptiveface.geometry.frame import Features2D
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.live.feed import FeatureFeed
from adaptiveface.live.session import LiveSession
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.capture import build_actor
from adaptiveface.neutral.colour import capture_colour_actor
from adaptiveface.parameters import Parameters
from adaptiveface.pipeline import capture_source, track_source
from adaptiveface.report.sections import heading
from adaptiveface.result import COLOUR_ONLY, Result
from adaptiveface.sensors import list_sensors, open_sensor, open_source
from adaptiveface.sensors.file_player import FilePlayer
from adaptiveface.sensors.live import LiveSensor
from adaptiveface.sensors.record import record_sensor
from adaptiveface.sensors.recording import Recording
from adaptiveface.sensors.video_file import VideoFile
from adaptiveface.sensors.webcam import WebcamDriver, WebcamOptions, linux_cameras
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.colour_tracker import ColourTracker, make_tracker
from adaptiveface.tracking.tracker import FaceTracker
from adaptiveface.tracking.types import SampleState

NEUTRAL = 16


def encode(path, pictures, codec: str = "MJPG", fps: float = 25.0):
    """A video file of RGB pictures."""
    height, width = pictures[0].shape[:2]
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*codec), fps, (width, height))
    assert writer.isOpened()
    for picture in pictures:
        writer.write(np.ascontiguousarray(picture[:, :, ::-1]))
    writer.release()
    return path


@pytest.fixture(scope="module")
def performer():
    return SyntheticSensor(4, "none", NEUTRAL, 40, repeats=1)


@pytest.fixture(scope="module")
def frames(performer):
    return list(performer)


@pytest.fixture(scope="module")
def clip(frames, tmp_path_factory):
    return encode(tmp_path_factory.mktemp("clip") / "clip.avi", [frame.colour for frame in frames])


@pytest.fixture(scope="module")
def average():
    return build_actor(embedded_face_model(), embedded_face_model().mean)


def expression_share(performer, actor, tracked) -> float:
    """Active share of v4 with the pose's error left out: 1 is a face that never moves."""
    collector = ErrorCollector(performer, actor, ("v4",))
    for frame in tracked:
        pose = performer.ground_truth(frame.index).head_pose @ collector.alignment
        collector.score(frame.index, frame.head_pose, {"v4": transform_points(pose, frame.v4)})
    return collector.finish().active_share("v4", None)


def turns(poses) -> np.ndarray:
    """(F, 3) rotation vectors in degrees since the first pose, in the camera frame."""
    return np.array([np.degrees(cv2.Rodrigues(p[:3, :3] @ poses[0][:3, :3].T)[0].ravel()) for p in poses])


@pytest.mark.slow
def test_a_video_of_a_performer_is_tracked_from_its_pictures_alone(performer, clip, detector, tmp_path):
    source, tracked = open_source(str(clip)), []
    actor = capture_source(source, neutral_frames=NEUTRAL, detector=detector)
    result = track_source(source, actor, detector=detector, on_frame=lambda face, _: tracked.append(face))

    assert len(result) == len(performer) and result.tracked.all()
    assert result.colour_only and COLOUR_ONLY in result.summary()
    assert (result.sample_state == SampleState.IN_ANCHOR_SPACE).all() and result.corrective_updates.max() == 0
    assert expression_share(performer, actor, tracked[NEUTRAL:]) < 0.85
    true = turns([performer.ground_truth(k).head_pose for k in range(len(performer))])
    assert np.ptp(true[:, 1]) > 10  # the head does turn
    assert np.median(np.linalg.norm(turns(result.head_pose) - true, axis=1)) < 5

    result.save(tmp_path / "result.npz")
    assert Result.load(tmp_path / "result.npz").colour_only
    assert COLOUR_ONLY in heading("clip", result.colour_only)


def test_exact_features_track_better_than_a_face_that_never_moves(performer, frames, average):
    tracker = ColourTracker(average)
    tracked = [tracker.track(frame) for frame in frames]
    assert all(face.tracked for face in tracked)
    assert expression_share(performer, average, tracked[NEUTRAL:]) < 0.8


def test_depth_does_not_change_colour_only_tracking(frames, average):
    seeing, blind = ColourTracker(average), ColourTracker(average)
    for frame in frames[:4]:
        a, b = seeing.track(frame), blind.track(without_depth(frame, 0.0))
        assert np.array_equal(a.head_pose, b.head_pose) and np.array_equal(a.v4, b.v4)


def test_resolution_does_not_matter(frames, average):
    """The same picture with three times the pixels is the same measurement."""
    frame = frames[0]
    c = frame.camera
    large = dataclasses.replace(c, width=3 * c.width, height=3 * c.height, fx=3 * c.fx, fy=3 * c.fy, cx=3 * c.cx, cy=3 * c.cy)
    features = Features2D(3 * frame.features.pixels, frame.features.confidence)
    small = ColourTracker(average).track(frame)
    big = ColourTracker(average).track(dataclasses.replace(frame, camera=large, features=features))
    assert np.allclose(small.head_pose, big.head_pose, atol=1e-6) and np.allclose(small.v4, big.v4, atol=1e-4)


def test_the_face_leaves_and_comes_back(frames, average):
    tracker = ColourTracker(average)
    before = tracker.track(frames[0])
    gone = dataclasses.replace(frames[1], features=None)
    few = Features2D(frames[2].features.pixels, np.where(np.arange(40) < 3, 1.0, 0.0))
    nonsense = Features2D(np.random.default_rng(0).uniform(0, 400, (40, 2)), np.ones(40))
    for features in (None, few, None, nonsense, None):
        lost = tracker.track(dataclasses.replace(gone, features=features))
        assert not lost.tracked and lost.reason and np.isfinite(lost.v4).all()
    again = tracker.track(frames[0])
    assert before.tracked and again.tracked and np.allclose(before.head_pose, again.head_pose, atol=1e-6)


def test_an_rgbd_sensor_without_depth_is_not_taken_for_a_webcam(frames, average, tmp_path):
    dark = [without_depth(frame, 0.0) for frame in frames[:3]]
    with LiveSensor(lambda: ScriptedDriver([raw(frame, k) for k, frame in enumerate(dark)])) as sensor:
        assert sensor.colour_only is False
    tracker = make_tracker(average, None, False)
    assert type(tracker) is FaceTracker and not tracker.track(dark[0]).tracked
    (tmp_path / "color").mkdir()
    cv2.imwrite(str(tmp_path / "color" / "00000.png"), frames[0].colour)
    (tmp_path / "intrinsic.json").write_text(
        json.dumps({"width": 640, "height": 480, "depth_scale": 1000, "intrinsic_matrix": [525, 0, 0, 0, 525, 0, 320, 240, 1]})
    )
    with pytest.raises(FileFormatError, match="no depth images"):
        Recording(tmp_path)


def test_a_video_plays_as_a_sensor_to_its_end_and_is_not_recorded(clip, frames, tmp_path):
    with open_sensor(str(clip)) as sensor:
        assert sensor.colour_only and not sensor.live
        with pytest.raises(SensorError, match="no depth"):
            record_sensor(sensor, tmp_path / "recording")
        for k, frame in enumerate(frames):
            seen = sensor.read(timeout=60)
            assert seen.sequence == k and not seen.depth.any()
            assert np.abs(seen.colour.astype(float) - frame.colour).mean() < 5
        with pytest.raises(EndOfRecording):
            sensor.read(timeout=60)
    assert not (tmp_path / "recording").exists()


def test_a_driver_that_is_not_open_says_so(clip):
    for driver in (WebcamDriver(), FilePlayer(clip)):
        with pytest.raises(SensorError, match="is not open"):
            driver.grab(0.1)
        driver.close()


def test_frames_in_any_order(frames, tmp_path):
    video = VideoFile(encode(tmp_path / "clip.mp4", [frame.colour for frame in frames[:12]], "mp4v"))
    ahead = [video.read(k).colour for k in range(12)]
    for k in (11, 0, 5, 5, 4, 9):
        assert np.array_equal(video.read(k).colour, ahead[k])
    assert video.fps == 25 and video.read(5).timestamp == pytest.approx(0.2)
    mirrored = open_source(f"{video.path},mirrored")
    assert np.array_equal(mirrored.read(3).colour, ahead[3][:, ::-1])
    with pytest.raises(IndexError):
        video.read(12)


def test_calibration_is_assumed_or_read_from_beside_the_file(frames, tmp_path):
    path = encode(tmp_path / "clip.avi", [frames[0].colour])
    camera = VideoFile(path, field_of_view=90.0).camera
    assert camera.fx == pytest.approx(320) and camera.cx == 319.5
    calibration = {"width": 640, "height": 480, "intrinsic_matrix": [500, 0, 0, 0, 510, 0, 310, 250, 1]}
    beside = tmp_path / "intrinsic.json"
    beside.write_text(json.dumps(calibration))
    assert (VideoFile(path).camera.fy, VideoFile(path).camera.cx) == (510, 310)
    beside.write_text(json.dumps(calibration | {"width": 1280}))
    with pytest.raises(FileFormatError, match="1280 x 480"):
        VideoFile(path)


def test_broken_files(frames, tmp_path):
    path = encode(tmp_path / "clip.avi", [frame.colour for frame in frames[:20]])
    content = path.read_bytes()
    (tmp_path / "cut.avi").write_bytes(content[: len(content) // 2])
    cut = VideoFile(tmp_path / "cut.avi")
    readable = 0
    for k in range(len(cut)):
        try:
            readable += cut.read(k).colour is not None
        except FrameError as error:
            assert "cut.avi" in str(error)
    assert 5 <= readable <= 12
    for name, garbage in (("text.mp4", b"not a video" * 500), ("empty.webm", b"")):
        (tmp_path / name).write_bytes(garbage)
        with pytest.raises(FileFormatError, match=name):
            open_source(str(tmp_path / name))


def test_the_command_line_says_one_line_and_no_library_another(frames, tmp_path):
    path = encode(tmp_path / "clip.mp4", [frame.colour for frame in frames[:20]], "mp4v")
    path.write_bytes(path.read_bytes()[:5000])
    command = [sys.executable, "-m", "adaptiveface", "track", str(path), "--out", str(tmp_path / "result.npz")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.returncode == 2 and len(done.stderr.strip().splitlines()) == 1 and "clip.mp4: not a video" in done.stderr


@pytest.mark.parametrize("text", ["x", "0,fov=5", "0,fov=wide", "0,upside-down", "1234", "-1", "file:///etc/passwd"])
def test_options_that_make_no_sense(text):
    with pytest.raises(ParameterError, match="webcam:"):
        open_sensor(f"webcam:{text}")


def test_options():
    assert WebcamOptions.parse("") == WebcamOptions(0)
    assert WebcamOptions.parse("2,fov=75.5,mirrored") == WebcamOptions(2, 75.5, True)
    secret = WebcamOptions.parse("http://me:password@camera.local:8080/video,fov=70")
    assert secret.device == "http://me:password@camera.local:8080/video" and "password" not in WebcamDriver(secret).name


def test_a_camera_that_is_not_there(capfd):
    with pytest.raises(SensorError, match="webcam 987"):
        open_sensor("webcam:987")
    assert any(info.name.startswith("webcam") and "degraded" in info.description for info in list_sensors())
    assert capfd.readouterr().err == ""


def test_linux_lists_the_first_node_of_every_camera(tmp_path):
    for number, index in ((0, 0), (1, 1), (2, 0), (10, 0)):
        (tmp_path / f"video{number}").touch()
        (tmp_path / "about" / f"video{number}").mkdir(parents=True)
        (tmp_path / "about" / f"video{number}" / "index").write_text(f"{index}\n")
    (tmp_path / "video-other").touch()
    assert linux_cameras(tmp_path, tmp_path / "about") == [0, 2, 10]


class NetworkCamera:
    """A network camera on the loopback interface: the pictures as motion JPEG, round and round, until ``stop``."""

    def __init__(self, pictures, port: int = 0) -> None:
        encoded = [cv2.imencode(".jpg", np.ascontiguousarray(p[:, :, ::-1]))[1].tobytes() for p in pictures]
        stopped = self._stopped = threading.Event()

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):  # noqa: N802 - the library's name
                self.send_response(200)
                self.send_header("Content-Type", "multipart/x-mixed-replace; boundary=frame")
                self.end_headers()
                number = 0
                while not stopped.wait(1 / 30):
                    body = encoded[number % len(encoded)]
                    head = f"--frame\r\nContent-Type: image/jpeg\r\nContent-Length: {len(body)}\r\n\r\n".encode()
                    try:
                        self.wfile.write(head + body + b"\r\n")
                    except OSError:
                        return
                    number += 1

            def log_message(self, *_):
                pass

        self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self.port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def stop(self) -> None:
        self._stopped.set()
        self._server.shutdown()
        self._server.server_close()


def test_a_network_camera_is_lost_and_found_again(frames):
    pictures = [frame.colour for frame in frames[:10]]
    camera = NetworkCamera(pictures)
    with open_sensor(f"webcam:http://127.0.0.1:{camera.port}/video,fov=62.7") as sensor:
        assert sensor.live and sensor.colour_only
        first = sensor.read(timeout=60)
        assert min(np.abs(first.colour.astype(float) - p).mean() for p in pictures) < 5
        assert first.camera.fx == pytest.approx(525, rel=0.01) and not first.depth.any()
        camera.stop()
        with pytest.raises(SensorDisconnectedError, match="127.0.0.1"):
            for _ in range(100):
                sensor.read(timeout=60)
        camera = NetworkCamera(pictures, camera.port)
        for _ in range(10):  # as long as it takes to be found again
            try:
                again = sensor.read(timeout=60)
                break
            except SensorDisconnectedError:
                continue
        assert again.host_timestamp > first.host_timestamp
    camera.stop()
    with pytest.raises(SensorNotFoundError, match="no video stream"):
        open_sensor(f"webcam:http://127.0.0.1:{camera.port}/video")


def test_the_mannequins_turn_in_its_pictures(mannequin, detector):
    """The real head turns steadily, by 108 degrees in the RGB-D poses; seen from the first frame with a face on."""
    recording = Recording(mannequin)
    frames = [without_depth(recording.read(index), 0.0) for index in range(0, len(recording), 3)]
    frames = [dataclasses.replace(frame, features=detector.detect(frame)) for frame in frames]
    seen = [frame for frame in frames if frame.features is not None]
    tracker = ColourTracker(capture_colour_actor(seen))
    tracked = [tracker.track(frame) for frame in frames]
    assert [face.tracked for face in tracked] == [frame.features is not None for frame in frames]
    yaw = np.degrees([np.arctan2(f.head_pose[0, 2], -f.head_pose[2, 2]) for f in tracked if f.tracked])
    assert len(yaw) >= 25 and yaw[0] > 45 and yaw[-1] < -35
    assert np.diff(yaw).max() < 5 and abs(np.diff(yaw).mean() + 3.6) < 0.5


def test_a_live_session_on_colour_only_says_so_and_tracks(clip, detector, average):
    with (
        open_sensor(str(clip)) as sensor,
        FeatureFeed(sensor, detector) as feed,
        LiveSession(feed, average) as session,
    ):
        result = session.latest(timeout=60)
        assert result is not None and result.tracked.tracked
        assert result.tracked.sample_state is SampleState.IN_ANCHOR_SPACE and np.isnan(result.tracked.residual)
        session.set_parameters(Parameters().replace(blendshapes__A=10, laplacian__final_w2=20.0))
        later = session.latest(after=result.index + 2, timeout=60)
        assert later is not None and later.tracked.tracked and len(later.tracked.coefficients) in (10, 23)
        assert np.isnan(later.tracked.residual)
