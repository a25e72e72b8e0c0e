"""Track live in a notebook: choose a sensor, scan the neutral face under guidance, then watch and steer the tracking."""

from __future__ import annotations

import asyncio
import html
import time
from collections.abc import Callable
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import ClassVar

from ..errors import AdaptiveFaceError, TrackingError
from ..files import check_output
from ..live.recorder import LiveRecorder
from ..live.run import BUILDING, CLOSED, FAILED, OPENING, SCANNING, TRACKING, LiveRun
from ..live.session import LiveResult, LiveSession
from ..model.actor import Actor
from ..model.face_model import embedded_face_model
from ..parameters import Parameters
from ..sensors.live import LiveFrame, LiveSensor
from .kernel import BackgroundTask, Displayed, on_main_thread, running_loop, strict
from .live_controls import LiveControls, alert, coverage_bars, dropped_frames, figures, instruction
from .live_panes import CharacterPane, CurvesPane, InputPane, MeshPane

#: Largest rates at which the face and the curves are drawn, pictures per second.
PICTURES, CHARTS = 25.0, 4.0
BUILD_STEPS = {
    "fuse": "merging the scan",
    "fit": "fitting the identity",
    "shrink_wrap": "shrink-wrap",
    "blendshapes": "making the blendshapes",
    "compile": "preparing the tracker",
}
_DEGRADED = "<b>colour only: no depth, degraded.</b> Pose and expression come from 2D landmarks; no correctives. "


class LiveView(Displayed):
    """A page for live tracking. Display its ``widget``; :meth:`close` ends every thread.

    Only one view runs at a time. A view that starts stops the one before, for example when its cell runs again. The view
    always draws the newest result, on the kernel's event loop. In code, use :meth:`until` and the methods behind the buttons.

    Parameters
    ----------
    sensor : LiveSensor or str, optional
        An open sensor, or a name for :func:`~adaptiveface.sensors.open_sensor`. Without it, the sensor is chosen on the page.
    actor : Actor or path-like, optional
        The rig or its file. Without it, the neutral scan comes first.
    character : str, optional
        A built-in character, or a file with another one, that follows the performance.
    parameters : Parameters, optional
        The parameters of the tracker; :meth:`.Parameters.live` by default.
    seconds : float
        Length of the neutral scan.
    detect : bool
        Whether MediaPipe finds the features even if the sensor brings some.
    """

    _running: ClassVar[LiveView | None] = None

    def __init__(
        self,
        sensor: LiveSensor | str | None = None,
        actor: Actor | str | PathLike | None = None,
        character: str | None = None,
        parameters: Parameters | None = None,
        seconds: float = 10.0,
        detect: bool = False,
    ) -> None:
        self._given, self._actor, self._options = sensor, actor, (seconds, detect)
        self.run: LiveRun | None = None
        self.result: LiveResult | None = None
        self.drawn = 0
        self._recorder: LiveRecorder | None = None
        self._shown_state, self._chart_due, self._rate = "", 0.0, (0.0, 0)
        self._scan_frame: LiveFrame | None = None
        self._dropped_before = (0, 0, 0)
        name = sensor if isinstance(sensor, str) or sensor is None else sensor.name
        self.controls = LiveControls(self._set_parameters, parameters or Parameters.live(), name, character, self._expressions)
        self.widget = self.controls.widget
        self.input, self.mesh, self.curves = InputPane(), MeshPane(), CurvesPane()
        self._character: CharacterPane | None = None
        self._task = BackgroundTask()
        self._connect()
        self._choose_character()
        self.controls.curves.children = [self.curves.widget]
        self.controls.show(False, False, False)
        if sensor is not None:
            self.start()

    # ---- what the buttons do, from code as well --------------------------------------------------------------------
    def start(self) -> None:
        """Open the chosen sensor. A running event loop is needed, as in a notebook."""
        if running_loop() is None:
            raise AdaptiveFaceError("the live view needs a running event loop: use it in a notebook")
        self.stop()
        if LiveView._running is not None:
            LiveView._running._give_way()
        given = self._given
        chosen = given if isinstance(given, LiveSensor) else self.controls.sensor.value
        with self._shown():
            self.run = LiveRun(chosen, self._actor, self.controls.panel.parameters, *self._options)
            self.run.on_result(self.curves.add)
            self.result = None
            self._task.start(self._draw_for_ever())
            LiveView._running = self

    def stop(self) -> None:
        """Close the sensor and end every thread. The last pictures stay, and :meth:`start` begins again."""
        self._task.stop()
        if LiveView._running is self:
            LiveView._running = None
        if self.run is not None:
            self.record(False)
            self._actor = self.run.actor
            self.run.close()
            self._show_state(self.run)
            self.run = None

    def close(self) -> None:
        """Stop, and remove the widgets."""
        self.stop()
        self.mesh.close()
        self.widget.close()

    def set(self, **values) -> None:
        """Move sliders: ``set(laplacian__w2=100)``. They act on the next frame."""
        self.controls.panel.set(**values)

    def finish_scan(self) -> None:
        """End the neutral scan now and build the head from it."""
        if self.run is not None:
            self.run.finish_scan()

    def relearn(self) -> None:
        """Scan the neutral face again."""
        if self.run is not None:
            self.record(False)
            self.run.relearn()
            self.curves.clear()

    def freeze(self, on: bool = True) -> None:
        """Stop or resume learning correctives."""
        if self.controls.freeze.value != on:
            self.controls.freeze.value = on  # this calls the function again
        elif self.run is not None and self.run.session is not None:
            self.run.session.freeze(on)

    def reset_correctives(self) -> None:
        """Forget the learned correctives and the personal blendshapes."""
        if self.run is not None and self.run.session is not None:
            self.run.session.reset_correctives()

    def record(self, on: bool = True) -> None:
        """Start or finish a recording in the folder named beside the button."""
        if on and self._recorder is None and self.run is not None and self.run.sensor is not None:
            folder = self.controls.folder.value.strip() or time.strftime("recording-%Y%m%d-%H%M%S")
            try:
                self._recorder = LiveRecorder(self.run.sensor, Path(folder))
            finally:
                self.controls.record.value = self._recorder is not None
            self._say(f"recording to {self._recorder.folder}")
        elif not on and self._recorder is not None:
            recorder, self._recorder = self._recorder, None
            self.controls.record.value = False
            self._say(str(recorder.close()))

    def save_actor(self, path: str | PathLike | None = None) -> None:
        """Write the head to a file, by default the one named beside the button."""
        path = path or self.controls.file.value.strip() or "actor.npz"
        if self.run is None or self.run.actor is None:
            raise AdaptiveFaceError(f"{path}: there is no actor to save yet")
        self.run.actor.save(check_output(Path(path), "actor"))
        self._say(f"saved {path}")

    async def until(self, condition: Callable[[LiveView], bool], timeout: float = 120.0) -> LiveView:
        """Wait until a condition holds.

        Parameters
        ----------
        condition : callable
            ``condition(view)`` -> bool, for example ``lambda view: view.drawn > 30``.
        timeout : float
            Longest time to wait, s.

        Raises
        ------
        TimeoutError
            The condition did not hold in time. An error that stopped the view is raised instead.
        """
        end = time.perf_counter() + timeout
        while not condition(self):
            if self.run is not None and self.run.error is not None:
                raise self.run.error
            if not self._task.running:
                await self._task.finished()
                raise TrackingError("the live view was stopped")
            if time.perf_counter() > end:
                raise TrackingError(
                    f"the live view is still {CLOSED if self.run is None else self.run.state} after {timeout:g} s"
                )
            await asyncio.sleep(0.02)
        return self

    def _give_way(self) -> None:
        """Stop because another view starts. Two views would compete for the camera and the processor."""
        with self._shown():
            self.stop()
            self._say("stopped: another live view was started")

    # ---- drawing, on the kernel's main thread ----------------------------------------------------------------------
    async def _draw_for_ever(self) -> None:
        while True:
            began = time.perf_counter()
            with self._shown():
                if self.run is not None:
                    self._step(self.run)
            await asyncio.sleep(max(1 / PICTURES - (time.perf_counter() - began), 0.005))

    def _step(self, run: LiveRun) -> None:
        """Draw the newest result."""
        if run.state != self._shown_state:
            self._show_state(run)
        if run.state == SCANNING:
            self._draw_scan(run)
        elif run.state == BUILDING:
            step, share = run.progress
            self.controls.status.value = f"building your head: {BUILD_STEPS.get(step, step)} {100 * share:.0f} %"
        elif run.state == TRACKING:
            self._draw_result(run)
        elif run.error is not None:
            raise run.error

    def _draw_scan(self, run: LiveRun) -> None:
        guide, guidance, frame = run.guide, run.guidance, run.frame
        if guidance is None or frame is self._scan_frame:
            self._say_trouble(run.message)
            return
        self._scan_frame = frame
        self.input.show_scan(frame)
        if guide is not None:
            self.mesh.show_scan(guide.vertex_coverage, guide.pose)
        self.drawn += 1
        self.controls.progress.value = guidance.progress
        self.controls.status.value = (_DEGRADED if run.colour_only else "") + instruction(guidance)
        self.controls.coverage.value = coverage_bars(guidance.coverage, guidance.step) if guide else ""

    def _draw_result(self, run: LiveRun) -> None:
        session, actor = run.session, run.actor
        if session is None or actor is None:
            return
        result = session.latest(-1 if self.result is None else self.result.index)
        now = time.perf_counter()
        if result is not None:
            self.result = result
            self.input.show(actor, result)
            self.mesh.show(actor, result)
            if self._character is not None:
                self._character.show(actor, result)
            self.drawn += 1
        if now >= self._chart_due:
            self._draw_figures(session, actor)
            # On a busy machine this waits, because the face comes first.
            self._chart_due = now + max(1 / CHARTS, 8 * (time.perf_counter() - now))

    def _draw_figures(self, session: LiveSession, actor: Actor) -> None:
        statistics = session.statistics
        if self.result is not None:
            self.curves.draw(actor, self.result, statistics.detect_ms)
        now, (before, drawn) = time.perf_counter(), self._rate
        self._rate = (now, self.drawn)
        rate = (self.drawn - drawn) / max(now - before, 1e-3)
        dropped = [now - before for now, before in zip(dropped_frames(statistics), self._dropped_before, strict=True)]
        if self._recorder is not None and self._recorder.error is not None:
            self.record(False)  # raises the error that stopped it
        recorded = self._recorder.frames if self._recorder else None
        correctives = session.model.mix.shape[1]
        self.controls.figures.value = figures(statistics, dropped, rate, correctives, recorded)
        self._say_trouble(statistics.message)

    def _show_state(self, run: LiveRun) -> None:
        state = self._shown_state = run.state
        self.controls.show(state == SCANNING, state == TRACKING, state not in (FAILED, CLOSED))
        texts = {
            OPENING: f"opening {run.name} ...",
            TRACKING: f"tracking: {run.name}",
            CLOSED: "stopped",
            FAILED: "",
            SCANNING: "looking for a face ...",
        }
        label = _DEGRADED if run.colour_only else ""
        self.controls.status.value = label + html.escape(texts.get(state, state))
        if state == TRACKING:
            self.controls.panel.limit_expressions(self._expressions)
            self.result = None  # the results of another session are counted from zero
            session, guidance = run.session, run.guidance
            if session is not None:  # None if the run has just ended
                self._dropped_before = dropped_frames(session.statistics)  # while the head was being built
                if self.controls.freeze.value:
                    session.freeze(True)
            if guidance is not None and guidance.warnings:
                self.controls.status.value += html.escape(f" ({'; '.join(guidance.warnings)})")

    # ---- controls --------------------------------------------------------------------------------------------------
    def _connect(self) -> None:
        c = self.controls

        def acts(action: Callable) -> Callable:
            """Return a callback that calls ``action`` on the kernel's main thread and shows its errors in the panel."""

            def guarded(*_) -> None:
                """The widget's arguments are ignored."""
                with self._shown():
                    action()

            return on_main_thread(guarded)

        for button, action in (
            (c.start, self.start),
            (c.stop, self.stop),
            (c.enough, self.finish_scan),
            (c.relearn, self.relearn),
            (c.reset, self.reset_correctives),
            (c.save, self.save_actor),
        ):
            button.on_click(acts(action))
        c.freeze.observe(acts(lambda: self.freeze(c.freeze.value)), "value")
        c.record.observe(acts(lambda: self.record(c.record.value)), "value")
        c.character.observe(acts(self._choose_character), "value")
        c.sensor.observe(acts(self._choose_sensor), "value")

    def _choose_sensor(self) -> None:
        self._given = None
        state = self.controls.states.get(self.controls.sensor.value, "ready")
        self._say_trouble("" if state == "ready" else f"{self.controls.sensor.value}: {state}")

    def _choose_character(self) -> None:
        name = self.controls.character.value
        self._character = CharacterPane(name) if name else None
        extra = [self._character.widget] if self._character else []
        self.controls.pictures.children = [self.input.widget, self.mesh.widget, self.curves.curves.widget, *extra]

    @property
    def _expressions(self) -> int:
        """Number of expressions of the actor, or of the actor that the neutral scan will give."""
        actor = self._actor if self.run is None else self.run.actor
        return len(actor.blendshapes if isinstance(actor, Actor) else embedded_face_model().generic_expressions)

    def _set_parameters(self, parameters: Parameters) -> None:
        if self.run is not None:
            self.run.set_parameters(parameters)

    def _say(self, text: str) -> None:
        self.controls.status.value = html.escape(text)

    def _say_trouble(self, text: str) -> None:
        if self.controls.trouble.value != alert(text):
            self.controls.trouble.value = alert(text)

    @contextmanager
    def _shown(self):
        """Show errors in the panel and stop what cannot continue. If :func:`strict`, also raise them."""
        try:
            yield
        except Exception as error:
            self._say_trouble(str(error) or type(error).__name__)
            if self.run is not None and self.run.state == FAILED:
                self._task.stop()
            if strict():
                raise
