"""Run ``adaptiveface live livelink``: save an iPhone's curves as a take, and send them to avatars and other programs."""

from __future__ import annotations

import argparse
import time
from contextlib import ExitStack, nullcontext
from pathlib import Path
from typing import TextIO

import numpy as np

from ..errors import AdaptiveFaceError, ParameterError, SensorError
from ..export.destinations import destinations
from ..export.messages import FaceState
from ..files import check_output, replacing
from ..livelink.convention import ARKIT_NAMES, rotations
from ..livelink.packet import LiveLinkFrame
from ..livelink.receiver import LOOPBACK, LiveLinkReceiver, parse_address
from ..livelink.take import header_line, row_line
from ..runtime.interrupt import CtrlC
from .status import StatusLine

#: Options of ``live`` that need pictures, with their defaults.
_OF_SENSORS: dict[str, object] = {
    "actor": None,
    "save_actor": None,
    "personal_actor": None,
    "record": None,
    "set": [],
    "mirrored": False,
}
_SHOWN = ("jawOpen", "mouthSmileLeft", "eyeBlinkLeft")


def run_livelink(args: argparse.Namespace) -> int:
    """Run ``live livelink[:[HOST:]PORT] [--out take.csv] [--vmc ...]``. Returns the exit status."""
    _check(args)
    host, port = parse_address(args.sensor)
    with ExitStack() as stack:
        receiver = stack.enter_context(LiveLinkReceiver(host, port))
        ctrl_c = stack.enter_context(CtrlC())
        sender, said = destinations(args)
        here = ", this machine only; for a phone in your network: livelink:0.0.0.0:11111" if host == LOOPBACK else ""
        print("\n".join([f"listening to Live Link Face on {host}:{receiver.port}{here}; Ctrl-C ends and saves", *said]))
        run = _Run(receiver, sender, args.seconds)
        output = stack.enter_context(replacing(args.out) if args.out else nullcontext())
        run.until_the_end(output, ctrl_c)
        if not run.count:
            reason = f"; {receiver.bad} datagrams were no frames ({receiver.reason})" if receiver.bad else ""
            raise SensorError(f"livelink on {host}:{receiver.port}: no frame came{reason}")
    print(f"{args.out}: {run.summary}" if args.out else run.summary)
    if run.error is not None:
        raise run.error
    return 0


def run_livelink_stream(args: argparse.Namespace) -> int:
    """Run ``adaptiveface stream livelink``, which does what ``live livelink`` does, but saves no take.

    Without another destination, it sends VMC to this machine. Returns the exit status.
    """
    values = dict(vars(args), sensor=args.source, out=None, seconds=None)
    if args.vmc is None and args.osc is None and args.livelink is None:
        values["vmc"] = ""
    return run_livelink(argparse.Namespace(**values))


def _check(args: argparse.Namespace) -> None:
    given = [f"--{name.replace('_', '-')}" for name, value in _OF_SENSORS.items() if getattr(args, name, value) != value]
    if given:
        raise ParameterError(f"{args.sensor}: sends curves and no pictures; {', '.join(given)} needs a sensor with depth")
    if args.out is not None:
        check_output(args.out, "arkit-csv")


class _Run:
    """Receives frames until Ctrl-C or for ``seconds``. An error ends it, and is raised after the take is saved."""

    def __init__(self, receiver: LiveLinkReceiver, sender, seconds: int | None) -> None:
        self._receiver, self._sender, self._seconds = receiver, sender, seconds
        self.count, self.lost = 0, 0
        self.error: AdaptiveFaceError | None = None
        self._line = StatusLine()
        self._began: float | None = None
        self._last: LiveLinkFrame | None = None

    @property
    def summary(self) -> str:
        """Summarise the frames that were received."""
        text = f"{self.count} frames of '{self._receiver.subject}', {self.lost} without a face"
        text += f", {self._receiver.late} late" if self._receiver.late else ""
        others = ", ".join(sorted(self._receiver.others))
        return text + (f"; other phones were left out: {others}" if others else "")

    def until_the_end(self, output: Path | None, ctrl_c: CtrlC) -> None:
        """Receive until the end. The take is written to ``output`` as it arrives."""
        with open(output, "w", encoding="utf-8", newline="\n") if output else nullcontext() as stream:
            if stream:
                stream.write(header_line())
            try:
                start = time.monotonic()
                while not ctrl_c.pressed and (self._seconds is None or time.monotonic() - start < self._seconds):
                    for frame in self._receiver.frames(0.2):
                        self._take(frame, stream)
                    self._show()
            except AdaptiveFaceError as error:
                self.error = error
        self._line.end()

    def _take(self, frame: LiveLinkFrame, stream: TextIO | None) -> None:
        self._began = time.monotonic() if self._began is None else self._began
        self.count += 1
        self.lost += not frame.tracked
        if stream:
            stream.write(row_line(frame.time, np.concatenate([frame.curves, frame.head, frame.eyes]), frame.tracked))
        self._last = frame
        if self._sender is not None:
            self._sender.send(face_state(frame))

    def _show(self) -> None:
        last = self._last
        if last is None or self._began is None:
            bad = f" ({self._receiver.bad} datagrams that are none: {self._receiver.reason})" if self._receiver.bad else ""
            self._line.show(f"waiting for Live Link Face{bad}")
            return
        rate = self.count / max(time.monotonic() - self._began, 1e-3)
        levels = ", ".join(f"{name} {last.curves[ARKIT_NAMES.index(name)]:.2f}" for name in _SHOWN)
        face = levels if last.tracked else "no face"
        self._line.show(f"{self._receiver.subject}: {self.count} frames, {rate:.0f} a second, {face}")


def face_state(frame: LiveLinkFrame) -> FaceState:
    """Return the part of a phone's frame that is sent on."""
    return FaceState(frame.time, frame.tracked, np.clip(frame.curves, 0, 1), rotations(frame.head), eyes=frame.eyes)
