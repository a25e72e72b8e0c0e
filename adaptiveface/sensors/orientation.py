"""Show frames the right way round: flip mirrored recordings, and turn those of a camera that lay on its side.

Colour, depth, calibration and features change together, so that the frame is one that a real camera could have taken.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np

from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_IDS, Features2D, RgbdFrame
from ..geometry.source import Abilities, FrameSource, NumberedFrames

AnyFrame = TypeVar("AnyFrame", bound=RgbdFrame)
#: Ending of the name of a source whose pictures are mirrored, as selfie videos are.
MIRRORED = ",mirrored"
#: iBUG-68 numbers that change places in a mirror, region by region: brows, eyes, outer lips, inner lips.
_PAIRS = (
    *zip(range(18, 22), range(25, 21, -1), strict=True),
    *((36, 45), (37, 44), (38, 43), (39, 42), (40, 47), (41, 46)),
    *((48, 54), (49, 53), (50, 52), (55, 59), (56, 58)),
    *((60, 64), (61, 63), (65, 67)),
)
_SWAP = np.arange(len(FEATURE_IDS))
for _a, _b in np.searchsorted(FEATURE_IDS, _PAIRS):
    _SWAP[[_a, _b]] = _b, _a


def split_mirrored(text: str) -> tuple[str, bool]:
    """Split the ending ``,mirrored`` from the name of a source.

    Parameters
    ----------
    text : str
        The name of a source. The ending is kept if a file of exactly this name exists.

    Returns
    -------
    text : str
        The name without the ending.
    mirrored : bool
        Whether the name had the ending.
    """
    if text.endswith(MIRRORED) and not Path(text).exists():
        return text.removesuffix(MIRRORED), True
    return text, False


def mirrored(frame: AnyFrame) -> AnyFrame:
    """Flip a frame left to right.

    Parameters
    ----------
    frame : RgbdFrame
        The frame. It is not changed.

    Returns
    -------
    RgbdFrame
        The flipped frame, which has the class of ``frame``. Its left and right features have changed places.
    """
    camera, features = frame.camera, frame.features
    if features is not None:
        flip, right = [-1.0, 1.0], [camera.width - 1.0, 0.0]
        irises = features.iris_centres
        irises = None if irises is None else irises[::-1] * flip + right
        features = Features2D(features.pixels[_SWAP] * flip + right, features.confidence[_SWAP], irises=irises)
    return dataclasses.replace(
        frame,
        depth=np.ascontiguousarray(frame.depth[:, ::-1]),
        colour=None if frame.colour is None else np.ascontiguousarray(frame.colour[:, ::-1]),
        camera=mirrored_camera(camera),
        features=features,
    )


def turned(frame: AnyFrame, quarters: int) -> AnyFrame:
    """Turn a frame anticlockwise.

    Parameters
    ----------
    frame : RgbdFrame
        The frame. It is not changed.
    quarters : int
        The number of quarter turns.

    Returns
    -------
    RgbdFrame
        The turned frame, which has the class of ``frame``. Without a turn, it is ``frame`` itself.
    """
    if quarters % 4 == 0:
        return frame
    features = frame.features
    if features is not None:
        irises = features.iris_centres
        pixels = features.pixels if irises is None else np.concatenate([features.pixels, irises])
        for step in range(quarters % 4):
            side = frame.camera.width if step % 2 == 0 else frame.camera.height
            pixels = np.stack([pixels[:, 1], side - 1.0 - pixels[:, 0]], axis=1)
        count = len(features.pixels)
        features = Features2D(pixels[:count], features.confidence, irises=None if irises is None else pixels[count:])
    return dataclasses.replace(
        frame,
        depth=np.ascontiguousarray(np.rot90(frame.depth, quarters)),
        colour=None if frame.colour is None else np.ascontiguousarray(np.rot90(frame.colour, quarters)),
        camera=turned_camera(frame.camera, quarters),
        features=features,
    )


def mirrored_camera(camera: Camera) -> Camera:
    """Return the calibration that fits the pictures of a camera after they are flipped left to right.

    Parameters
    ----------
    camera : Camera
        The calibration of the pictures before the flip.

    Returns
    -------
    Camera
        The calibration of the flipped pictures.
    """
    return dataclasses.replace(camera, cx=camera.width - 1 - camera.cx)


def turned_camera(camera: Camera, quarters: int) -> Camera:
    """Return the calibration that fits the pictures of a camera after they are turned.

    Parameters
    ----------
    camera : Camera
        The calibration of the unturned pictures.
    quarters : int
        The number of anticlockwise quarter turns.

    Returns
    -------
    Camera
        The calibration of the turned pictures.
    """
    for _ in range(quarters % 4):
        camera = Camera(camera.height, camera.width, camera.fy, camera.fx, camera.cy, camera.width - 1.0 - camera.cx)
    return camera


class OrientedSource(NumberedFrames):
    """Mirrors and turns every frame of a source with numbered frames.

    What the source declares about itself is declared here, too. Only its ground truth and its path are left out, because they
    describe unturned frames.

    Parameters
    ----------
    source : FrameSource
        The source of the frames.
    mirrored : bool
        Whether each frame is flipped left to right. The flip comes before the turn.
    quarters : int
        The number of anticlockwise quarter turns.
    """

    def __init__(self, source: FrameSource, mirrored: bool = False, quarters: int = 0) -> None:
        self._source, self._known, self._flipped = source, Abilities.of(source), mirrored
        self.quarters, self.name = quarters, source.name
        known = self._known
        self.mirrored = known.mirrored != mirrored
        self.fps, self.depth_scale, self.unit_file = known.fps, known.depth_scale, known.unit_file
        self.timestamps, self.notes = known.timestamps, known.notes
        self.has_features, self.colour_only = known.has_features, known.colour_only
        self.guessed_camera = known.guessed_camera

    @property
    def camera(self) -> Camera:
        """The calibration of the oriented frames. Setting it sets the one of the source."""
        camera = self._source.camera
        return turned_camera(mirrored_camera(camera) if self._flipped else camera, self.quarters)

    @camera.setter
    def camera(self, camera: Camera) -> None:
        camera = turned_camera(camera, -self.quarters % 4)
        self._source.camera = mirrored_camera(camera) if self._flipped else camera

    def __len__(self) -> int:
        return len(self._source)

    def read(self, index: int) -> RgbdFrame:
        """Return frame ``index`` the right way round. Errors of the source are passed on."""
        frame = self._source.read(index)
        return turned(mirrored(frame) if self._flipped else frame, self.quarters)

    def close(self) -> None:
        """Close the source."""
        self._known.close()


class Tracked(Protocol):
    """A result that tells how its source was oriented, as :class:`~adaptiveface.result.Result` does."""

    @property
    def mirrored(self) -> bool:
        """Whether the frames were flipped left to right."""

    @property
    def turned(self) -> int:
        """The number of anticlockwise quarter turns after the flip."""


def as_tracked(source: FrameSource | None, result: Tracked) -> FrameSource | None:
    """Flip and turn a source as it was when a result was tracked, so that pictures and meshes agree.

    Parameters
    ----------
    source : FrameSource or None
        The source of the pictures.
    result : Result
        The result.

    Returns
    -------
    FrameSource or None
        The oriented source. It is ``source`` itself if nothing has to change, and None if ``source`` is None.
    """
    if source is None:
        return None
    flip, quarters = result.mirrored and not Abilities.of(source).mirrored, result.turned % 4
    return OrientedSource(source, flip, quarters) if flip or quarters else source
