"""Read the frames of a source with their 2D features. Each frame is decoded once, and one detector looks at it once."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from ..errors import FrameError, TrackingError
from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.source import Abilities
from ..landmarks import FeatureDetector, Upright
from ..landmarks.irises import IrisFinder
from ..runtime.closing import Closing
from ..sensors import FrameSource
from ..sensors.orientation import turned

#: Largest size of the frames that are remembered, bytes. Of further frames only the features are remembered, and they are
#: decoded again.
HELD_BYTES = 256 << 20


@dataclass(frozen=True)
class _Remembered:
    """A frame that was read: its features, the quarters by which it was turned, and the frame itself if there is room."""

    features: Features2D | None
    quarters: int
    frame: RgbdFrame | None


class FrameReader(Closing):
    """Reads the frames of a source with their 2D features, and counts the broken ones.

    It is a context manager, which closes the detectors that it made.

    Parameters
    ----------
    source : FrameSource
        Where the frames come from.
    detector : FeatureDetector, optional
        Finds features if the source brings none. It is made when it is needed. A given detector stays open.
    irises : bool
        Whether to find irises in the colour images of frames whose features come without them.
    remember : bool
        Whether to keep what is read until :meth:`rewind`, so that the neutral frames are not read again for tracking.

    Attributes
    ----------
    skipped : dict
        Reason why a frame could not be used, by its number.
    reads : int
        Number of requested frames.
    """

    def __init__(
        self, source: FrameSource, detector: FeatureDetector | None = None, *, irises: bool = False, remember: bool = False
    ) -> None:
        self.source, self.detector, self._abilities = source, detector, Abilities.of(source)
        self._own_detector: FeatureDetector | None = None
        self._irises = IrisFinder() if irises else None
        self._upright: Upright | None = None
        self._remember, self._in_order = remember, True
        self._known: dict[int, _Remembered | None] = {}  # None: broken
        self._room = HELD_BYTES
        self.skipped: dict[int, str] = {}
        self.reads = 0

    def close(self) -> None:
        """Close the detectors that were made here."""
        if self._own_detector is not None:
            self._own_detector.close()
        if self._irises is not None:
            self._irises.close()

    def read(self, index: int) -> RgbdFrame | None:
        """Return frame ``index``, with features if a face is found; None, and an entry in ``skipped``, for a broken frame."""
        self.reads += 1
        if not self._remember and index in self._known:
            return self._recall(index)
        frame = self._decode(index)
        frame = None if frame is None else self._with_features(frame)
        if self._remember:
            self._take_note(index, frame)
        return frame

    def spare(self, every: int) -> None:
        """Search only every ``every``-th of the following frames (:meth:`.Upright.spare`)."""
        if self._upright is not None:
            self._upright.spare(every)

    def again(self, index: int, features: Features2D) -> RgbdFrame:
        """Return frame ``index``, which was read before, with the features that it had."""
        known = self._known.get(index)
        if known is not None and known.frame is not None:
            return known.frame
        return dataclasses.replace(turned(self.source.read(index), self.quarters), features=features)

    def rewind(self) -> None:
        """Begin again with the first frame.

        If the frames were read in order from the first one on, :meth:`read` returns the same frames again, and then continues
        as if it had never stopped. Otherwise everything is forgotten, because the face that the detector follows, and its
        upright direction, depend on the order of the frames.
        """
        self._remember, self._abilities = False, Abilities.of(self.source)
        self.spare(1)
        if not self._in_order:
            self.close()
            if self._own_detector is not None:
                self.detector = self._own_detector = None
            self._upright = None
            self._known.clear()
            self.skipped.clear()

    def camera_changed(self) -> None:
        """Keep only the features of what is remembered, because the source's camera has changed."""
        for index, known in self._known.items():
            self._known[index] = None if known is None else dataclasses.replace(known, frame=None)

    def _decode(self, index: int) -> RgbdFrame | None:
        try:
            return self.source.read(index)
        except FrameError as error:
            self.skipped[index] = str(error)
            return None

    def _with_features(self, frame: RgbdFrame) -> RgbdFrame:
        if frame.features is not None or self._abilities.has_features:
            return frame if self._irises is None else self._irises.onto(frame)
        if frame.colour is None:
            raise TrackingError(f"{self.source.name}: neither colour images nor features.csv, so no face can be found")
        if self.detector is None:
            self.detector = self._own_detector = FeatureDetector()
        if self._upright is None:
            self._upright = Upright(self.detector, self.source.name)
        return self._upright.detect(frame)

    def _take_note(self, index: int, frame: RgbdFrame | None) -> None:
        self._in_order &= index == len(self._known)
        if not self._in_order:
            self._known.clear()
        elif frame is None:
            self._known[index] = None
        else:
            size = frame.depth.nbytes + (0 if frame.colour is None else frame.colour.nbytes)
            held = size <= self._room
            self._room -= size if held else 0
            self._known[index] = _Remembered(frame.features, self.quarters, frame if held else None)

    def _recall(self, index: int) -> RgbdFrame | None:
        """Return and forget what was read before, because tracking goes on from frame to frame."""
        known = self._known.pop(index)
        if known is None or known.frame is not None:
            return None if known is None else known.frame
        frame = self._decode(index)
        return None if frame is None else dataclasses.replace(turned(frame, known.quarters), features=known.features)

    @property
    def quarters(self) -> int:
        """Quarters of a turn anticlockwise; 0 if the features come with the frames."""
        return 0 if self._upright is None else self._upright.quarters

    def timestamp(self, index: int) -> float:
        """Time at which an unreadable frame ``index`` was due, s."""
        timestamps = self._abilities.timestamps
        return float(timestamps[index]) if timestamps is not None else index / self._abilities.fps

    def fail(self, message: str) -> TrackingError:
        """Make an error with ``message`` and, if frames were skipped, their number and the first reason."""
        if self.skipped:
            message += f"; {len(self.skipped)} broken frames, the first: {next(iter(self.skipped.values()))}"
        return TrackingError(f"{self.source.name}: {message}")


@contextmanager
def reading(source: FrameSource | FrameReader, detector: FeatureDetector | None) -> Iterator[FrameReader]:
    """Return a given reader, which its owner closes, or a new reader of a source, which is closed at the end."""
    if isinstance(source, FrameReader):
        yield source
    else:
        with FrameReader(source, detector) as reader:
            yield reader
