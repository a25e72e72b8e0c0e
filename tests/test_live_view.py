"""The live view without a browser, on a small live sensor with the real feature thread and tracker."""

from __future__ import annotations

import asyncio

import numpy as np
import pytest

pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")
pytest.importorskip("pyvista", reason="the extra 'notebooks' is not installed")

from live_head import QUICK, ColourDriver, HeadDriver, head_frames, threads_of_ours  # noqa: E402
from scenes import exact_actor  # noqa: E402

from adaptiveface import views  # noqa: E402
from adaptiveface.errors import AdaptiveFaceError  # noqa: E402
from adaptiveface.live.run import FAILED  # noqa: E402
from adaptiveface.model.actor import Actor  # noqa: E402
from adaptiveface.sensors.live import LiveSensor  # noqa: E402
from adaptiveface.sensors.recording import Recording  # noqa: E402
from adaptiveface.views.live_panes import PLAIN, TO_DEPTH  # noqa: E402


@pytest.fixture(scope="module")
def actor() -> Actor:
    return exact_actor()


@pytest.fixture
def sensor():
    with LiveSensor(lambda: HeadDriver(head_frames())) as sensor:
        yield sensor


@pytest.fixture
def strict(monkeypatch):
    monkeypatch.setenv("ADAPTIVEFACE_STRICT", "1")


def test_the_view_draws_the_scan_and_then_the_tracked_face(sensor, strict):
    async def scenario() -> None:
        view = views.LiveView(sensor, parameters=QUICK, seconds=600.0)
        await view.until(lambda v: v.run.state == "scanning" and v.drawn > 3)
        assert "adaptiveface-coverage" in view.controls.coverage.value and not view.controls.enough.disabled
        assert view.controls.save.disabled
        scan = view.mesh._view._image.frame
        view.controls.enough.click()
        await view.until(lambda v: v.result is not None and v.result.index > 5)
        assert view.mesh._view._image.frame != scan and "done" not in view.controls.status.value
        drawn = view.drawn
        await view.until(lambda v: v.drawn > drawn + 5 and "latency" in v.controls.figures.value)
        assert view.curves.coefficients is not None and "dropped" in view.controls.figures.value
        for choice in (TO_DEPTH, PLAIN):
            before = view.mesh._view._image.frame
            view.mesh.heat.value, drawn = choice, view.drawn
            await view.until(lambda v, drawn=drawn: v.drawn > drawn)
            assert view.mesh._view._image.frame != before
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
        with pytest.raises(AdaptiveFaceError, match="holds files already"):
            view.record()
        view.close()

    asyncio.run(scenario())
    recording = Recording(tmp_path / "take")
    assert len(recording) >= 5 and recording.read(0).features is not None
    assert threads_of_ours() == [f"sensor {sensor.name}"]


def test_a_view_that_starts_stops_the_one_before(actor, strict):
    """As when the cell is run once more: the sensor is free again, and nothing goes on behind the page."""

    async def scenario() -> None:
        before = threads_of_ours()
        with LiveSensor(lambda: HeadDriver(head_frames())) as one, LiveSensor(lambda: HeadDriver(head_frames())) as two:
            first = views.LiveView(one, actor, parameters=QUICK)
            await first.until(lambda v: v.result is not None)
            second = views.LiveView(two, actor, parameters=QUICK)
            assert first.run is None and "another live view" in first.controls.status.value
            await second.until(lambda v: v.result is not None)
            first.start()  # and back
            assert second.run is None
            await first.until(lambda v: v.result is not None)
            second.close()
            assert first.run is not None
            first.close()
        assert threads_of_ours() == before

    asyncio.run(scenario())


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
        view.controls.file.value = "/dev/null/folder/actor.npz"
        view.controls.save.click()
        assert "/dev/null/folder" in view.controls.trouble.value
        view.stop()
        assert view.controls.status.value == "stopped"
        view.start()
        await view.until(lambda v: v.result is not None)
        view.close()

    asyncio.run(scenario())


def test_without_depth_the_view_says_so(strict):
    async def scenario(sensor) -> None:
        view = views.LiveView(sensor)
        await view.until(lambda v: v.result is not None and v.result.tracked.tracked)
        assert "colour only: no depth, degraded" in view.controls.status.value
        view.close()

    with LiveSensor(lambda: ColourDriver(head_frames())) as sensor:
        asyncio.run(scenario(sensor))


def test_without_a_sensor_one_is_chosen_on_the_page():
    async def scenario() -> None:
        view = views.LiveView()
        assert view.run is None and any("synthetic" in label for label, _ in view.controls.sensor.options)
        view.close()

    asyncio.run(scenario())
    with pytest.raises(AdaptiveFaceError, match="event loop"):
        views.LiveView("synthetic")
