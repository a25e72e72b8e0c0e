"""Define sources with numbered frames: their interface, what they may declare about themselves, and a base class."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from ..errors import FrameError
from .camera import Camera
from .frame import RgbdFrame


@runtime_checkable
class FrameSource(Protocol):
    """A numbered sequence of RGB-D frames from one calibrated camera.

    This is all that a source needs. :class:`Abilities` lists what it may declare beyond that, and :class:`NumberedFrames` is a
    base class that has both.

    Attributes
    ----------
    camera : Camera
        The calibration.
    name : str
        For titles and file names.
    """

    camera: Camera
    name: str

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of frames, including broken ones."""

    @abstractmethod
    def read(self, index: int) -> RgbdFrame:
        """Return a frame.

        Parameters
        ----------
        index : int
            Number of the frame (0-based).

        Returns
        -------
        RgbdFrame
            The frame. Its depth is (H, W) float32 in mm.

        Raises
        ------
        FrameError
            The frame cannot be used.
        IndexError
            There is no frame of this number.
        """


class Abilities:
    """What a source may declare about itself.

    A source that inherits this class overrides the defaults, on its class or on the instance. Sources of other classes may have
    attributes of the same names, which :meth:`of` finds.

    Attributes
    ----------
    fps : float
        Frames per second.
    depth_scale : float or None
        Units per metre of the measured depth, if they are known.
    unit_file : Path or None
        The file that states ``depth_scale``.
    path : Path or None
        The folder or file that is read.
    timestamps : (F,) float64 or None
        Times of the frames, s. Without them, frames follow each other at ``fps``.
    has_features : bool
        Whether the frames bring 2D features. If not, the detector runs on the colour images.
    colour_only : bool
        Whether there is no depth camera. Such a source is tracked in the degraded mode of ``tracking/colour_tracker.py``, which
        nothing else switches on.
    guessed_camera : bool
        Whether the focal length is a guess. The capture then corrects it by setting ``camera``.
    mirrored : bool
        Whether frames are flipped when they are read.
    notes : sequence of str
        A line for each thing that was repaired or is missing.
    """

    fps: float = 30.0
    depth_scale: float | None = None
    unit_file: Path | None = None
    path: Path | None = None
    timestamps: np.ndarray | None = None
    has_features: bool = False
    colour_only: bool = False
    guessed_camera: bool = False
    mirrored: bool = False
    notes: Sequence[str] = ()

    def read_colour(self, index: int) -> np.ndarray | None:
        """Return only the colour image of a frame, for sources that can read it without the depth.

        Parameters
        ----------
        index : int
            Number of the frame (0-based).

        Returns
        -------
        (H, W, 3) uint8 RGB or None
            None if the frame has no colour image, or if only :meth:`FrameSource.read` can get it. This is the default.
        """
        return None

    def close(self) -> None:
        """Release what the source holds open. By default, there is nothing to release."""

    @classmethod
    def of(cls, source: object) -> Abilities:
        """Return what a source declares.

        Parameters
        ----------
        source : FrameSource or None
            The source. It may be of any class.

        Returns
        -------
        Abilities
            The source itself if it inherits this class. Otherwise, an object with the attributes of the source that have the
            names of this class's, and with the defaults for the others.
        """
        if isinstance(source, cls):
            return source
        known = cls()
        for name in (*Abilities.__annotations__, "read_colour", "close"):
            if hasattr(source, name):
                setattr(known, name, getattr(source, name))
        return known


class NumberedFrames(FrameSource, Abilities):
    """The base class of sources. Iteration skips the frames that cannot be used."""

    def __iter__(self) -> Iterator[RgbdFrame]:
        for index in range(len(self)):
            try:
                yield self.read(index)
            except FrameError:
                continue
