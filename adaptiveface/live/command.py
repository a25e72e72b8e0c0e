"""``adaptiveface live``: from a sensor's name to a tracked face, in the notebook or, ``--headless``, in the terminal."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from ..actor import Actor
from ..blas import one_blas_thread
from ..errors import AdaptiveFaceError, EndOfRecording, ParameterError, SensorError, TrackingError
from ..export.result import ResultBuilder
from ..neutral.colour import capture_colour_actor
from ..parameters import Parameters
from ..sensors.catalogue import list_sensors, open_sensor
from ..sensors.live import LiveFrame, LiveSensor
from .feed import FeatureFeed
from .guided import STEPS, Guidance, GuidedCapture
from .recorder import LiveRecorder
from .run import COLOUR_FRAMES
from .session import LiveSession
from .status import StatusLine

NOTEBOOK = "live_sensor.ipynb"
#: What the notebook reads: the sensor's name and the file of the rig.
SENSOR_VARIABLE, ACTOR_VARIABLE = "ADAPTIVEFACE_SENSOR", "ADAPTIVEFACE_ACTOR"
#: Results kept before their storage grows.
FIRST_RESULTS = 900


def run_live(args: argparse.Namespace, parameters: Parameters) -> int:
    """``adaptiveface live [SENSOR]``; returns the exit status."""
    if not args.headless:
        return _open_notebook(args)
    if args.sensor is None:
        for sensor in list_sensors():
            print(f"{sensor.name:<24}{sensor.description}" + ("" if sensor.ready else f" [{sensor.state}]"))
        return 0
    return _Headless(args, parameters).run()


def _open_notebook(args: argparse.Namespace) -> int:
    from ..lab import open_lab

    given = [
        f"--{name.replace('_', '-')}"
        for name in ("save_actor", "record", "out", "vmc", "osc", "seconds", "set")
        if getattr(args, name) not in (None, [])
    ]
    if given:
        raise ParameterError(f"{', '.join(given)}: only with --headless; the notebook has buttons and sliders for it")
    if args.actor is not None:
        Actor.load(args.actor)  # a wrong file ends here, not in the browser
        os.environ[ACTOR_VARIABLE] = str(args.actor.resolve())
    if args.sensor is not None:
        path = Path(args.sensor)
        os.environ[SENSOR_VARIABLE] = str(path.resolve()) if path.exists() else args.sensor
    return open_lab(args.dir, notebook=NOTEBOOK)


class _Headless:
    """One run in the terminal: scan where no rig is given, track until it ends, keep everything."""

    def __init__(self, args: argparse.Namespace, parameters: Parameters) -> None:
        self.args, self.parameters, self.line = args, parameters, StatusLine()
        self._check_outputs()
        self.actor = Actor.load(args.actor) if args.actor else None

    def _check_outputs(self) -> None:
        from ..sensors.record import check_new

        for path in (self.args.out, self.args.save_actor):
            if path is None:
                continue
            if path.suffix != ".npz":
                raise AdaptiveFaceError(f"{path}: the output's name must end in .npz")
            if path.is_dir() or not path.resolve().parent.is_dir():
                raise AdaptiveFaceError(f"{path}: is a folder, or lies in one that does not exist")
        if self.args.record is not None:
            check_new(self.args.record)
        if self._addresses() != (None, None):
            from ..export.stream import check_streaming

            check_streaming()

    def run(self) -> int:
        with ExitStack() as stack:
            sensor = stack.enter_context(open_sensor(self.args.sensor))
            print(f"{sensor.name}: " + ("Ctrl-C ends and saves" if sensor.live else "every frame, until its end"))
            stack.enter_context(self._recording(sensor))
            feed = stack.enter_context(FeatureFeed(sensor))
            if self.actor is None:
                self.actor = self._capture(feed)
            if self.args.save_actor is not None:
                self.actor.save(self.args.save_actor)
                print(f"{self.args.save_actor}: {len(self.actor.neutral)} vertices")
            self._track(feed)
        return 0

    @contextmanager
    def _recording(self, sensor: LiveSensor) -> Iterator[None]:
        if self.args.record is None:
            yield
            return
        recorder = LiveRecorder(sensor, self.args.record)
        try:
            yield
        finally:
            print(recorder.close())

    # ---- the neutral scan ------------------------------------------------------------------------------------------
    def _capture(self, feed: FeatureFeed) -> Actor:
        """A rig by the guided neutral scan."""
        if feed.sensor.colour_only:
            return self._proportions(feed)
        guide, spoken = GuidedCapture(), None
        print("neutral scan: keep your face relaxed")
        while not guide.done:
            try:
                guidance = guide.add(feed.read(1.0))
            except EndOfRecording:
                guidance = guide.finish()
            except SensorError as error:
                if not feed.running:
                    raise
                self.line.show(str(error))
                continue
            if guidance.text != spoken:
                spoken = guidance.text
                self.line.end(f"  {spoken}")
            self.line.show(_scan_line(guidance))
        self.line.end()
        for warning in guidance.warnings:
            print(f"  note: {warning}")
        with one_blas_thread():
            actor = guide.build(self.parameters, lambda step, share: self.line.show(f"{step} {share:.0%}"))
        self.line.end()
        return actor

    def _proportions(self, feed: FeatureFeed) -> Actor:
        """Without depth: the average head with the person's proportions, from some frames that show the face."""
        print("no depth: a degraded mode; sizes and distances are guesses, and nothing is learned")
        print(f"  {STEPS['straight']}")
        frames: list[LiveFrame] = []
        while len(frames) < COLOUR_FRAMES:
            try:
                frame = feed.read(1.0)
            except EndOfRecording:
                break
            except SensorError as error:
                if not feed.running:
                    raise
                self.line.show(str(error))
                continue
            frames += [frame] if frame.features is not None else []
            self.line.show(f"{len(frames) / COLOUR_FRAMES:4.0%} " + ("" if frame.features is not None else "no face"))
        self.line.end()
        return capture_colour_actor(frames, parameters=self.parameters)

    # ---- tracking --------------------------------------------------------------------------------------------------
    def _track(self, feed: FeatureFeed) -> None:
        builder = self._builder(feed.sensor.colour_only) if self.args.out else None
        callbacks = [lambda result: builder.add(result.tracked)] if builder else []
        callbacks += self._streams()
        session = LiveSession(feed, self.actor, self.parameters, callbacks)
        try:
            with session:
                self._follow(session)
        except KeyboardInterrupt:
            self.line.end("ended by Ctrl-C")
        finally:
            self.line.end(str(session.statistics))
            if builder is not None and builder.done:
                result = builder.finish(session.model.correctives)
                result.save(self.args.out)
                print(f"{self.args.out}: {result.summary()}")
        statistics = session.statistics
        if session.ended and not statistics.tracked + statistics.lost:
            raise TrackingError(
                f"{feed.sensor.name}: the recording ended with the neutral scan; keep it by --save-actor FILE, then "
                "track with --actor FILE"
            )
        if not statistics.tracked:
            raise TrackingError(f"{feed.sensor.name}: the face was never found")

    def _builder(self, colour_only: bool) -> ResultBuilder:
        return ResultBuilder(self.actor, self.parameters, FIRST_RESULTS, colour_only=colour_only)

    def _follow(self, session: LiveSession) -> None:
        start, last = time.monotonic(), -1
        while session.running and (self.args.seconds is None or time.monotonic() - start < self.args.seconds):
            result = session.latest(last, 0.5)
            state = "waiting"
            if result is not None:
                last, tracked = result.index, result.tracked
                state = tracked.sample_state.name.lower().replace("_", " ") if tracked.tracked else "no face"
            self.line.show(f"{state}: {session.statistics}")
        session.latest(last)  # raises what ended it, unless that is the end of the recording

    def _addresses(self):
        from ..export.stream import OSC_PORT, VMC_PORT, Address

        pairs = ((self.args.vmc, VMC_PORT), (self.args.osc, OSC_PORT))
        return tuple(None if text is None else Address.parse(text, port) for text, port in pairs)

    def _streams(self) -> list:
        vmc, osc = self._addresses()
        if vmc is None and osc is None:
            return []
        from ..export.stream import Streamer
        from ..retargeting.smoothing import OneEuro

        smoothing = OneEuro() if getattr(self.args, "smooth", False) else None
        streamer = Streamer(self.actor, self.parameters.blendshapes.A, vmc, osc, smoothing)
        for kind, address in (("VMC", vmc), ("OSC", osc)):
            if address:
                print(f"{kind} to {address.host}:{address.port}")
        return [lambda result: streamer.send(result.tracked)]


def _scan_line(guidance: Guidance) -> str:
    return f"{guidance.progress:4.0%} " + "; ".join(guidance.warnings)


def run_live_stream(args: argparse.Namespace, parameters: Parameters) -> int:
    """``adaptiveface stream SENSOR``: as ``live --headless --vmc``, until Ctrl-C."""
    from ..export.stream import VMC_PORT

    values = dict(vars(args), sensor=args.source, headless=True, out=None, save_actor=None, record=None, seconds=None)
    if args.vmc is None and args.osc is None:
        values["vmc"] = str(VMC_PORT)
    return _Headless(argparse.Namespace(**values), parameters).run()
