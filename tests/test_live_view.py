"""The live run and its view without a browser, on a small live sensor with the real feature thread and tracker."""

from __future__ import annotations

import asyncio
import threading
import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")
pytest.importorskip("pyvista", reason="the extra 'notebooks' is not installed")

from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame  # noqa: E402

from adaptiveface import views  # noqa: E402
from adaptiveface.actor import Actor  # noqa: E402
from adaptiveface.errors import AdaptiveFaceError, FileFormatError, SensorError  # noqa: E402
from adaptiveface.live.run import FAILED, TRACKING, LiveRun  # noqa: E402
from adaptiveface.parameters import Parameters  # noqa: E402
from adaptiveface.sensors.live import LiveSensor, RawFrame  # noqa: E402
from adaptiveface.sensors.recording import Recording, RecordingWriter  # noqa: E402
from adaptiveface.views.live_panes import PLAIN, TO_DEPTH  # noqa: E402

#: A coarse head, made in a second.
QUICK = Parameters().set(
    fusion__voxel=4.0, fusion__passes=1, fusion__iterations=5, fit__iterations=5, shrink_wrap__iterations=1,
    shrink_wrap__detail_iterations=0, adaptive_pca__valid_min=0.01,
)  # fmt: skip


class HeadDriver:
    """A live camera on a talking head, 30 frames a second: the given frames forth and back, with their features."""

    name, live, has_features, depth_scale, fps = "test head", True, True, 10_000.0, 30.0

    def __init__(self, frames) -> None:
        self._frames, self._next = frames, 0

    def open(self) -> None:
        self._next = 0

    def grab(self, timeout: float) -> RawFrame:
        time.sleep(1 / self.fps)
        turn = self._next % (2 * len(self._frames) - 2)
        frame = self._frames[min(turn, 2 * len(self._frames) - 2 - turn)]
        self._next += 1
        return RawFrame(frame.depth, frame.camera, frame.colour, self._next, self._next / self.fps, frame.features)

    def close(self) -> None:
        pass


@pytest.fixture(scope="module")
def actor() -> Actor:
    return exact_actor()


@pytest.fixture(scope="module")
def frames(actor):
    """Eight frames of an opening jaw, in colour."""
    out = []
    for k in range(8):
        shape = posed_shape(actor, coefficients(actor, **{actor.expression_names[0]: 0.02 * k}))
        shape[actor.frontal, 2] += 1.5 * np.sin(actor.neutral[actor.frontal, 1] / 12.0) * k / 8  # in no basis
        frame = render_frame(actor, shape, head_pose((0, 0.02 * k, 0), (0, 0, 500.0)), k, noise=0.3)
        grey = np.clip(frame.depth[..., None] / 4, 0, 255).astype(np.uint8).repeat(3, axis=2)
        out.append(replace(frame, colour=grey))
    return out


@pytest.fixture
def sensor(frames):
    with LiveSensor(lambda: HeadDriver(frames)) as sensor:
        yield sensor


@pytest.fixture
def strict(monkeypatch):
    monkeypatch.setenv("ADAPTIVEFACE_STRICT", "1")


def threads_of_ours() -> list[str]:
    words = ("live run", "features", "tracker", "sensor", "recording")
    return [thread.name for thread in threading.enumerate() if thread.name.startswith(words)]


def wait_for(condition, seconds: float = 30.0) -> None:
    end = time.perf_counter() + seconds
    while not condition():
        assert time.perf_counter() < end, "it takes too long"
        time.sleep(0.02)


def test_a_run_scans_builds_tracks_and_relearns(sensor):
    seen = []
    with LiveRun(sensor, parameters=QUICK, seconds=1.0) as run:
        run.on_result(seen.append)
        wait_for(lambda: run.state == TRACKING)
        assert run.guidance.done and run.guide.vertex_coverage.max() == 1.0
        first = run.actor
        wait_for(lambda: len(seen) > 3)
        assert seen[-1].tracked.tracked and seen[-1].frame.features is not None
        run.relearn()
        wait_for(lambda: run.state == TRACKING)
        count = len(seen)
        wait_for(lambda: len(seen) > count + 2)
        assert run.actor is not first
    assert run.session is None and [name for name in threads_of_ours() if not name.startswith("sensor")] == []


def test_a_recording_ends_the_scan_with_what_it_has(frames, tmp_path):
    with RecordingWriter(tmp_path / "take", frames[0].camera) as writer:
        for frame in frames:
            writer.write(frame)
    with LiveRun(str(tmp_path / "take"), parameters=QUICK) as run:
        wait_for(lambda: run.state in (TRACKING, FAILED))
        assert run.error is None and run.guidance.done
    assert threads_of_ours() == []


def test_a_sensor_that_cannot_be_opened_is_an_error_of_the_package():
    with LiveRun("no such sensor") as run:
        wait_for(lambda: run.state == FAILED)
        assert isinstance(run.error, SensorError) and "no such sensor" in str(run.error)


def test_the_view_draws_the_scan_and_then_the_tracked_face(sensor, strict):
    async def scenario() -> None:
        view = views.LiveView(sensor, parameters=QUICK, seconds=1.0)
        await view.until(lambda v: v.run.state == "scanning" and v.drawn > 3)
        assert "adaptiveface-coverage" in view.controls.coverage.value and not view.controls.enough.disabled
        assert view.controls.save.disabled
        scan = view.mesh._view._image.value
        await view.until(lambda v: v.result is not None and v.result.index > 5)
        assert view.mesh._view._image.value != scan and "done" not in view.controls.status.value
        drawn = view.drawn
        await view.until(lambda v: v.drawn > drawn + 5 and "latency" in v.controls.figures.value)
        assert view.curves.coefficients is not None and "dropped" in view.controls.figures.value
        for choice in (TO_DEPTH, PLAIN):
            before = view.mesh._view._image.value
            view.mesh.heat.value, drawn = choice, view.drawn
            await view.until(lambda v, drawn=drawn: v.drawn > drawn)
            assert view.mesh._view._image.value != before
        view.close()

    asyncio.run(scenario())
    assert [name for name in threads_of_ours() if not name.startswith("sensor")] == []
    assert views.running_tasks() == 0


def test_sliders_and_buttons_act_on_the_session(sensor, actor, strict, tmp_path):
    async def scenario() -> None:
        view = views.LiveView(sensor, actor, character="hag", parameters=QUICK)
        await view.until(lambda v: v.result is not None and v.result.tracked.tracked)
        session = view.run.session
        await view.until(lambda v: session.model.correctives.shape[1] > 0)
        view.set(laplacian__w2=40.0)
        assert session.parameters.laplacian.w2 == pytest.approx(40.0, rel=0.15)
        view.controls.freeze.value = True
        assert session.frozen
        view.controls.reset.click()
        await view.until(lambda v: session.model.correctives.shape[1] == 0)
        count = view.result.index
        await view.until(lambda v: v.result.index > count + 3)
        assert session.model.correctives.shape[1] == 0, "frozen: nothing is learned again"
        assert view._character._image.value
        view.controls.file.value = str(tmp_path / "me.npz")
        view.controls.save.click()
        assert np.allclose(Actor.load(tmp_path / "me.npz").neutral, actor.neutral, atol=1e-3)
        view.controls.folder.value = str(tmp_path / "take")
        view.controls.record.value = True
        await view.until(lambda v: v._recorder.frames >= 5)
        view.controls.record.value = False
        assert "frames in" in view.controls.status.value
        with pytest.raises(FileFormatError, match="already holds a recording"):
            view.record()
        view.close()

    asyncio.run(scenario())
    recording = Recording(tmp_path / "take")
    assert len(recording) >= 5 and recording.read(0).features is not None
    assert threads_of_ours() == [f"sensor {sensor.name}"]


def test_errors_stand_in_the_panel(sensor, actor, monkeypatch):
    monkeypatch.delenv("ADAPTIVEFACE_STRICT", raising=False)

    async def scenario() -> None:
        view = views.LiveView("no-such-sensor:0")
        while view.run.state != FAILED or view._task.running:
            await asyncio.sleep(0.02)
        assert "no-such-sensor:0: no such sensor" in view.controls.trouble.value
        assert not view.controls.start.disabled
        with pytest.raises(AdaptiveFaceError, match="no actor to save"):
            view.save_actor()
        view.close()
        view = views.LiveView(sensor, actor)
        await view.until(lambda v: v.result is not None)
        view.controls.file.value = "/no/such/folder/actor.npz"
        view.controls.save.click()
        assert "/no/such/folder" in view.controls.trouble.value
        view.stop()
        assert view.controls.status.value == "stopped"
        view.start()
        await view.until(lambda v: v.result is not None)
        view.close()

    asyncio.run(scenario())


def test_without_depth_the_view_says_so(frames, strict):
    class ColourDriver(HeadDriver):
        name, colour_only = "test webcam", True

        def grab(self, timeout: float) -> RawFrame:
            return replace(super().grab(timeout), depth=np.zeros((480, 640), np.float32))

    async def scenario(sensor) -> None:
        view = views.LiveView(sensor)
        await view.until(lambda v: v.result is not None and v.result.tracked.tracked)
        assert "colour only: no depth, degraded" in view.controls.status.value
        view.close()

    with LiveSensor(lambda: ColourDriver(frames)) as sensor:
        asyncio.run(scenario(sensor))


def test_without_a_sensor_one_is_chosen_on_the_page():
    async def scenario() -> None:
        view = views.LiveView()
        assert view.run is None and any("synthetic" in label for label, _ in view.controls.sensor.options)
        view.close()

    asyncio.run(scenario())
    with pytest.raises(AdaptiveFaceError, match="event loop"):
        views.LiveView("synthetic")
