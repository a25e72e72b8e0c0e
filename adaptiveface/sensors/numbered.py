"""What sources with numbered frames share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator

from ..errors import FrameError
from ..frame import RgbdFrame


class NumberedFrames(ABC):
    """A sequence of frames; iteration passes over those that cannot be used."""

    @abstractmethod
    def __len__(self) -> int:
        """Number of frames, broken ones included."""

    @abstractmethod
    def read(self, index: int) -> RgbdFrame:
        """Frame ``index`` (0-based); raises :class:`FrameError` for one that cannot be used."""

    def __iter__(self) -> Iterator[RgbdFrame]:
        for index in range(len(self)):
            try:
                yield self.read(index)
            except FrameError:
                continue
