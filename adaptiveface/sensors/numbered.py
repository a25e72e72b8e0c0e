"""Provide what all sources with numbered frames share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Self

import numpy as np

from ..errors import FrameError
from ..geometry.frame import RgbdFrame


@dataclass(frozen=True)
class Abilities:
    """What a source may declare about itself. Each field is an attribute of the source; without it, the default applies."""

    fps: float = 30.0
    depth_scale: float | None = None  #: units per metre of the measured depth
    unit_file: Path | None = None  #: the file that says so
    timestamps: np.ndarray | None = None  #: (F,) s
    has_features: bool = False  #: frames bring 2D features; the detector is not needed
    colour_only: bool = False  #: there is no depth camera: the degraded mode
    guessed_camera: bool = False  #: the focal length is a guess
    mirrored: bool = False  #: frames are flipped when they are read
    notes: Sequence[str] = ()  #: a line for each thing that was repaired or is missing

    @classmethod
    def of(cls, source: Any) -> Self:
        """The abilities of a ``source``; the defaults for None."""
        names = (entry.name for entry in fields(cls))
        return cls(**{name: getattr(source, name) for name in names if hasattr(source, name)})


class NumberedFrames(ABC):
    """A sequence of frames. Iteration skips those that cannot be used."""

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
