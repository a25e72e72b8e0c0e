"""Drivers that play numbered frames: recordings from start to end, and the synthetic live sensor."""

from __future__ import annotations

import time
from collections.abc import Callable

from ..errors import EndOfRecording, FrameError
from ..geometry.frame import RgbdFrame
from ..geometry.source import Abilities
from ..synthetic.noise import DEPTH_SCALES
from .driver import Driver, RawFrame

NOISES = tuple(DEPTH_SCALES)
#: The live synthetic performance: a neutral scan and expressions, rendered once and played back and forth.
NEUTRAL_FRAMES, EXPRESSION_FRAMES = 20, 70
#: Frames that wait in the synthetic sensor until it is polled, as in the vendors' libraries.
DEVICE_QUEUE = 8


def raw_frame(frame: RgbdFrame, sequence: int, timestamp: float) -> RawFrame:
    """Return a frame in the form in which a driver delivers it.

    Parameters
    ----------
    frame : RgbdFrame
        The frame.
    sequence : int
        Its number.
    timestamp : float
        Its time, s.

    Returns
    -------
    RawFrame
        The same arrays, with this number and time.
    """
    return RawFrame(frame.depth, frame.camera, frame.colour, sequence, timestamp, frame.features)


class PlaybackDriver(Driver):
    """Plays a source with numbered frames as fast as they are read.

    Broken frames count as lost by the device. ``broken`` lists the reasons.

    Parameters
    ----------
    source : FrameSource
        The source.
    """

    live, reopens = False, False

    def __init__(self, source) -> None:
        self.source, self.name = source, source.name
        known = Abilities.of(source)
        self.fps, self.depth_scale = known.fps, known.depth_scale or 10_000.0
        self.has_features, self.colour_only = known.has_features, known.colour_only
        self.broken: list[str] = []

    def open(self) -> None:
        """Start at the first frame."""
        self._next = 0

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next frame, or None if it is broken."""
        if self._next >= len(self.source):
            raise EndOfRecording(f"{self.name}: the recording ends after {len(self.source)} frames")
        index, self._next = self._next, self._next + 1
        try:
            frame = self.source.read(index)
        except FrameError as error:
            self.broken.append(str(error))
            return None
        return raw_frame(frame, index, frame.timestamp)

    def close(self) -> None:
        """Do nothing, because there is nothing to release."""


class SyntheticDriver(Driver):
    """The synthetic sensor in real time: 30 frames per second with 2D features, without end.

    The frames are played back and forth, so that the head never jumps. Like a camera, the sensor does not wait: a reader that
    polls too late misses frames (``DEVICE_QUEUE``).

    Parameters
    ----------
    source : SyntheticSensor
        The frames.
    frames : dict
        Rendered frames by number. The dictionary keeps them for the next driver.
    clock : callable
        Returns the time, s.
    ahead : int, optional
        Number of frames that :meth:`open` renders. Each other frame is rendered when it is due for the first time. By default,
        all are rendered in :meth:`open`, which takes some seconds.
    """

    has_features, open_timeout, unconnected = True, 180.0, "ready"
    description = "a synthetic performer at 30 frames a second, no hardware"

    def __init__(
        self,
        source,
        frames: dict[int, RgbdFrame],
        clock: Callable[[], float] = time.perf_counter,
        ahead: int | None = None,
    ) -> None:
        self.source, self._frames, self._clock = source, frames, clock
        self._ahead = len(source) if ahead is None else ahead
        self.name, self.depth_scale = source.name, source.depth_scale

    @classmethod
    def named(cls, argument: str) -> Callable[[], Driver]:
        """Return a function that makes the driver of the performer ``[SEED[:NOISE][:skin=SKIN]...]``.

        The performer's frames are rendered once for all reconnections.
        """
        from ..synthetic.look import parse_performer
        from ..synthetic.sensor import SyntheticSensor

        seed, noise, look = parse_performer(argument)
        source = SyntheticSensor(seed or 0, noise or NOISES[0], NEUTRAL_FRAMES, EXPRESSION_FRAMES, repeats=1, look=look)
        frames: dict[int, RgbdFrame] = {}
        return lambda: cls(source, frames, ahead=NEUTRAL_FRAMES)

    def open(self) -> None:
        """Render the first frames, unless an earlier driver did."""
        for index in range(self._ahead):
            self._frame(index)
        self._start, self._next = self._clock(), 0

    def _frame(self, index: int) -> RgbdFrame:
        if index not in self._frames:
            self._frames[index] = self.source.read(index)
        return self._frames[index]

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the frame that is due now, or None if it is not due within ``timeout`` s."""
        wait = self._start + self._next / self.fps - self._clock()
        if wait > timeout:
            time.sleep(timeout)
            return None
        if wait > 0:
            time.sleep(wait)
        sequence = max(self._next, int((self._clock() - self._start) * self.fps) - DEVICE_QUEUE)
        self._next = sequence + 1
        return raw_frame(self._frame(forth_and_back(sequence, len(self.source))), sequence, sequence / self.fps)

    def close(self) -> None:
        """Do nothing. The rendered frames stay for the next driver."""


def forth_and_back(step: int, length: int) -> int:
    """Return the frame that is played at a step.

    Parameters
    ----------
    step : int
        Number of the step.
    length : int
        Number of frames.

    Returns
    -------
    int
        The sequence is 0, 1, ..., length - 1, length - 2, ..., 1, 0, 1, ... and so on. It is always 0 for a single frame.
    """
    turn = step % max(2 * length - 2, 1)
    return min(turn, 2 * length - 2 - turn)
