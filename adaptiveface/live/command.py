"""Run ``adaptiveface live``: track the face that a sensor sees, in the notebook or, with ``--headless``, in the terminal."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from ..errors import ParameterError, TrackingError
from ..files import check_distinct, check_new_folder, check_output
from ..insides.gaze import GazeTrack
from ..livelink.receiver import is_livelink
from ..model.actor import Actor
from ..parameters import Parameters
from ..result import ResultBuilder
from ..result.rows import discard, unfinished_folder
from ..runtime.interrupt import CtrlC, Terminated
from ..sensors.catalogue import list_sensors, open_sensor
from ..sensors.live import LiveSensor
from ..sensors.orientation import MIRRORED, split_mirrored
from ..sensors.worker import POLL_SECONDS
from .guided import STEPS
from .recorder import LiveRecorder
from .run import BUILDING, SCANNING, STARTING, LiveRun
from .session import LiveResult, LiveSession
from .status import StatusLine

NOTEBOOK = "live_sensor.ipynb"
#: What the notebook reads: the sensor's name and the file of the rig.
SENSOR_VARIABLE, ACTOR_VARIABLE = "ADAPTIVEFACE_SENSOR", "ADAPTIVEFACE_ACTOR"
#: Number of results for which there is room before the storage grows.
FIRST_RESULTS = 900
DEGRADED = "no depth: a degraded mode; sizes and distances are guesses, and nothing is learned"


def run_live(args: argparse.Namespace, parameters: Parameters) -> int:
    """Run ``adaptiveface live [SENSOR]``.

    Parameters
    ----------
    args : argparse.Namespace
        The options. Without a sensor, ``--headless`` lists the sensors.
    parameters : Parameters
        The parameters of the tracker.

    Returns
    -------
    int
        The exit status.
    """
    if args.sensor is not None and is_livelink(args.sensor):
        from .livelink import run_livelink

        return run_livelink(args)
    if not args.headless:
        return _open_notebook(args)
    if args.sensor is None:
        for sensor in list_sensors():
            print(f"{sensor.name:<24}{sensor.description}" + ("" if sensor.ready else f" [{sensor.state}]"))
        print(f"{'livelink':<24}an iPhone's curves (Live Link Face): no depth, drives avatars and makes takes")
        return 0
    return _Headless(args, parameters).run()


def _open_notebook(args: argparse.Namespace) -> int:
    from ..lab import open_lab

    given = [
        f"--{name.replace('_', '-')}"
        for name in (
            "save_actor",
            "personal_actor",
            "record",
            "out",
            "vmc",
            "osc",
            "livelink",
            "vmc_avatar",
            "vmc_root",
            "seconds",
            "set",
        )
        if getattr(args, name) not in (None, [], False)
    ]
    if given:
        raise ParameterError(f"{', '.join(given)}: only with --headless; the notebook has buttons and sliders for it")
    if args.actor is not None:
        Actor.load(args.actor)  # a wrong file is an error here, not in the browser
        os.environ[ACTOR_VARIABLE] = str(args.actor.resolve())
    if args.sensor is not None:
        name, flipped = split_mirrored(args.sensor)
        name = str(Path(name).resolve()) if Path(name).exists() else name
        os.environ[SENSOR_VARIABLE] = name + MIRRORED if flipped else name
    return open_lab(args.dir, notebook=NOTEBOOK)


class _Headless:
    """A run in the terminal. It scans the neutral if no rig is given, tracks until the end, and saves everything."""

    def __init__(self, args: argparse.Namespace, parameters: Parameters, smooth: bool = False) -> None:
        self.args, self.parameters, self.smooth, self.line = args, parameters, smooth, StatusLine()
        self._check_outputs()
        self._given = Actor.load(args.actor) if args.actor else None
        self._kept: tuple[ResultBuilder, GazeTrack] | None = None
        self._spoken: str | None = None  # the last of the scan's instructions
        self._building = False
        self._recorder: LiveRecorder | None = None
        self._told = False  # whether it was printed that the recording has stopped

    def _check_outputs(self) -> None:
        args, inputs = self.args, [self.args.sensor, self.args.actor]
        for path, kind in ((args.out, "result"), (args.save_actor, "actor"), (args.personal_actor, "actor")):
            if path is not None:
                check_output(path, kind, inputs)
        if args.record is not None:
            check_new_folder(args.record, inputs)
        check_distinct(args.out, args.save_actor, args.personal_actor, args.record)
        from ..export.destinations import addresses, avatar

        self._destinations, self._avatar = addresses(self.args), avatar(self.args)

    def run(self) -> int:
        """Run until the recording is over, ``--seconds`` have passed, or Ctrl-C is pressed. Returns the exit status."""
        with ExitStack() as stack:
            sensor = stack.enter_context(open_sensor(self.args.sensor))
            ctrl_c = stack.enter_context(CtrlC())
            print(f"{sensor.name}: " + ("Ctrl-C ends and saves" if sensor.live else "every frame, until its end"))
            stack.enter_context(self._recording(sensor))
            run = stack.enter_context(LiveRun(sensor, self._given, self.parameters, watch=self._show))
            while not run.wait(POLL_SECONDS):
                ctrl_c.check()
                self._watch_recording()
            if run.session is None:
                raise TrackingError(f"{sensor.name}: the run was closed before it tracked anything")
            self._track(run.session, ctrl_c)
        return 0

    @contextmanager
    def _recording(self, sensor: LiveSensor) -> Iterator[None]:
        if self.args.record is None:
            yield
            return
        self._recorder = recorder = LiveRecorder(sensor, self.args.record)
        try:
            yield
        finally:
            print(recorder.close())

    def _watch_recording(self) -> str:
        """Print immediately that the recording has stopped. Returns a note for every later line."""
        error = self._recorder.error if self._recorder else None
        if error is None:
            return ""
        if not self._told:
            self._told = True
            self.line.end(f"THE RECORDING HAS STOPPED: {error}")
        return "NOT RECORDING; "

    # ---- until it tracks, on the run's thread ----------------------------------------------------------------------
    def _show(self, run: LiveRun) -> None:
        if run.state == SCANNING:
            self._show_scan(run)
        elif run.state == BUILDING:
            self._show_building(run)
        elif run.state == STARTING:
            self._prepare(run)

    def _show_scan(self, run: LiveRun) -> None:
        if self._spoken is None:
            self._spoken = STEPS["straight"] if run.colour_only else ""
            print(f"{DEGRADED}\n  {self._spoken}" if run.colour_only else "neutral scan: keep your face relaxed")
        guidance = run.guidance
        if guidance is not None and guidance.text != self._spoken:
            self._spoken = guidance.text
            self.line.end(f"  {self._spoken}")
        if run.message:
            self.line.show(run.message)
        elif guidance is not None:
            self.line.show(f"{guidance.progress:4.0%} " + "; ".join(guidance.warnings))

    def _show_building(self, run: LiveRun) -> None:
        if not self._building:
            self._building = True
            self.line.end()
            for warning in run.guidance.warnings if run.guidance else ():
                print(f"  note: {warning}")
        step, share = run.progress
        if step:
            self.line.show(f"{step} {share:.0%}")

    def _prepare(self, run: LiveRun) -> None:
        """Save the head, which has just been built, and prepare for the first result."""
        self.line.end()
        if self.args.save_actor is not None:
            run.head.save(self.args.save_actor)
            print(f"{self.args.save_actor}: {len(run.head.neutral)} vertices")
        if self.args.out is not None:
            builder = ResultBuilder(
                run.head, self.parameters, FIRST_RESULTS, colour_only=run.colour_only, folder=unfinished_folder(self.args.out)
            )
            gaze = GazeTrack(run.head)

            def keep(live: LiveResult) -> None:
                builder.add(live.tracked)
                gaze.see(live.tracked, live.frame)

            run.on_result(keep)
            self._kept = builder, gaze
        self._stream(run)

    # ---- tracking --------------------------------------------------------------------------------------------------
    def _track(self, session: LiveSession, ctrl_c: CtrlC) -> None:
        with ExitStack() as at_the_end:  # it calls the last one first, because printing may fail
            at_the_end.callback(lambda: self.line.end(str(session.statistics)))
            at_the_end.callback(self._save, session)
            at_the_end.callback(self._save_learned, session)
            with session:
                self._follow(session, ctrl_c)
        statistics, name = session.statistics, session.feed.sensor.name
        if session.ended and not statistics.tracked + statistics.lost:
            raise TrackingError(
                f"{name}: the recording ended with the neutral scan; keep it by --save-actor FILE, then track with --actor FILE"
            )
        if not statistics.tracked:
            raise TrackingError(f"{name}: the face was never found")

    def _save_learned(self, session: LiveSession) -> None:
        if self.args.personal_actor is not None and session.statistics.tracked:
            session.personal_actor().save(self.args.personal_actor)

    def _save(self, session: LiveSession) -> None:
        if self._kept is None:
            return
        summary, (builder, gaze) = "", self._kept
        if builder.done:
            result = gaze.onto(builder.finish(session.model.correctives, session.expressions))
            result.save(self.args.out)
            summary = result.summary()
            del result  # it keeps the files open that are discarded
        discard(unfinished_folder(self.args.out))
        if summary:
            print(f"{self.args.out}: {summary}")

    def _follow(self, session: LiveSession, ctrl_c: CtrlC) -> None:
        start, last = time.monotonic(), -1
        while session.running and (self.args.seconds is None or time.monotonic() - start < self.args.seconds):
            if ctrl_c.pressed:
                self.line.end("ended by SIGTERM" if ctrl_c.pressed is Terminated else "ended by Ctrl-C")
                return
            result = session.latest(last, 0.5)
            state = "waiting"
            if result is not None:
                last, tracked = result.index, result.tracked
                state = tracked.sample_state.name.lower().replace("_", " ") if tracked.tracked else "no face"
            self.line.show(f"{self._watch_recording()}{state}: {session.statistics}")
        session.latest(last)  # raises the error that ended the session, unless it is the end of the recording

    def _stream(self, run: LiveRun) -> None:
        if not self._destinations:
            return
        from ..export.destinations import said
        from ..export.stream import Streamer
        from ..retargeting.arkit_resolve import has_units
        from ..retargeting.smoothing import OneEuro

        smoothing = OneEuro() if self.smooth else None
        fit = self.parameters.blendshapes
        streamer = Streamer(
            run.head,
            fit.A,
            smoothing=smoothing,
            avatar=self._avatar,
            parameters=fit,
            halves=has_units(run.head),
            **self._destinations,
        )
        print("\n".join(said(self._destinations)))
        run.on_result(lambda result: streamer.send(result.tracked, result.frame))


def run_live_stream(args: argparse.Namespace, parameters: Parameters) -> int:
    """Run ``adaptiveface stream SENSOR``, which does what ``live --headless --vmc`` does, until Ctrl-C.

    Parameters
    ----------
    args : argparse.Namespace
        The options.
    parameters : Parameters
        The parameters of the tracker.

    Returns
    -------
    int
        The exit status.
    """
    from ..export.stream import VMC_PORT

    values = dict(
        vars(args), sensor=args.source, headless=True, out=None, save_actor=None, personal_actor=None, record=None, seconds=None
    )
    if args.vmc is None and args.osc is None and args.livelink is None:
        values["vmc"] = str(VMC_PORT)
    return _Headless(argparse.Namespace(**values), parameters, args.smooth).run()
