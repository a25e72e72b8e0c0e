"""Tell whether a captured head can be a person's, by its size, its identity coefficients and its fit to the scan.

Depth with a wrong unit gives a head of the wrong size that fits perfectly. The limits were measured on three people and a
mannequin with detected features, and on synthetic performers. Their faces are 0.91 to 1.13 times as large as the model's (that
of a child of five: 0.84). Their coefficients have root mean squares of 0.6 to 2.0 and are at most 6.6. A unit that is wrong by
a factor of two gives sizes of 1.8 to 2.2, and coefficients of 3.4 to 6.4, up to 17.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import TrackingError
from ..geometry.frame import RgbdFrame
from ..geometry.mesh import surface_points
from ..geometry.source import Abilities
from ..model.actor import Actor
from ..model.face_model import FaceModel
from ..tracking.detection import measured_size

if TYPE_CHECKING:
    from .fit import IdentityFit

#: Size of a face relative to the average one. Beyond the first limits it is not a person's, and beyond the second ones it is
#: doubtful.
POSSIBLE, USUAL = (0.65, 1.35), (0.87, 1.14)
#: The same before the head is fitted, when only the features are known.
POSSIBLE_FEATURES = (0.6, 1.55)
#: Largest identity coefficients in standard deviations (root mean square, single one); largest distance from the scan, mm.
MOST_IDENTITY, MOST_COEFFICIENT, MOST_RESIDUAL = 3.2, 10.5, 2.5
#: Size of the face in a recording relative to the actor's, beyond which it cannot be the same person.
SAME_PERSON = (0.7, 1.4)
#: Number of frames whose features give the size.
SAMPLE = 15
#: Usual numbers of depth units per metre.
USUAL_UNITS = (100.0, 1000.0, 2000.0, 4000.0, 5000.0, 8000.0, 10_000.0, 100_000.0)
_log = logging.getLogger(__name__)


class ImplausibleFaceError(TrackingError):
    """The captured head cannot be a person's. ``size`` is relative to the average one, or 1 if the size is not the reason."""

    def __init__(self, message: str, size: float = 1.0) -> None:
        super().__init__(message)
        self.size = size

    def of(self, source: Any) -> ImplausibleFaceError:
        """Return the same error with the name of the ``source`` (or None) and the likely fault of its depth."""
        name = f"{source.name}: " if source is not None else ""
        return ImplausibleFaceError(f"{name}{self}{likely_unit(source, self.size)}", self.size)


def check_features(frames: Sequence[RgbdFrame], model: FaceModel) -> None:
    """Raise :class:`ImplausibleFaceError` if the depth at the frames' features gives a size that no face has."""
    size = median_size(frames, surface_points(model.mean, model.feature_triangles, model.feature_weights))
    if not np.isnan(size) and not POSSIBLE_FEATURES[0] < size < POSSIBLE_FEATURES[1]:
        raise ImplausibleFaceError(f"the face is {size:.2g} times as large as a person's", size)


def median_size(frames: Sequence[RgbdFrame], feature_points: np.ndarray) -> float:
    """Median of :func:`measured_size` over some of the frames, spread evenly; NaN if no frame shows it."""
    seen = [frame for frame in frames if frame.features is not None]
    sizes = [measured_size(frame, feature_points) for frame in seen[:: max(1, len(seen) // SAMPLE)]]
    sizes = [size for size in sizes if not np.isnan(size)]
    return float(np.median(sizes)) if sizes else float("nan")


def face_size(model: FaceModel, vertices: np.ndarray) -> tuple[float, float, float]:
    """Size of a head (V, 3) relative to the model's average, and the width and height of its face, mm."""
    (width, height, _), average = (np.ptp(shape[model.frontal], axis=0) for shape in (vertices, model.mean))
    return float(np.sqrt(width * height / (average[0] * average[1]))), float(width), float(height)


def check_fit(fit: IdentityFit, model: FaceModel) -> None:
    """Raise :class:`ImplausibleFaceError` for a fitted head that cannot be a person's."""
    size, width, height = face_size(model, fit.vertices)
    measured = f"the face is {width:.0f} mm wide and {height:.0f} mm high, {size:.2g} times the average one's"
    if not POSSIBLE[0] < size < POSSIBLE[1]:
        raise ImplausibleFaceError(measured, size)
    check_identity(fit.identity, size if not USUAL[0] < size < USUAL[1] else 1.0)
    if fit.residual > MOST_RESIDUAL:
        raise ImplausibleFaceError(
            f"the head lies {fit.residual:.1f} mm from the neutral scan: the frames do not show one calm face"
        )


def check_identity(identity: np.ndarray, size: float = 1.0) -> None:
    """Raise :class:`ImplausibleFaceError` for identity coefficients (M,), in standard deviations, that nobody has."""
    spread, most = float(np.sqrt(np.mean(np.square(identity)))), float(np.abs(identity).max(initial=0.0))
    if spread > MOST_IDENTITY or most > MOST_COEFFICIENT:
        raise ImplausibleFaceError(
            f"the face is unlike any person's (identity coefficients of {spread:.1f} standard deviations, at most {most:.1f})",
            size,
        )


def likely_unit(source: Any, size: float) -> str:
    """Advice on a face that is ``size`` times too large in the depth of a source, or ""."""
    if np.isnan(size) or USUAL[0] < size < USUAL[1]:
        return ""
    known = Abilities.of(source)
    units, where = known.depth_scale, known.unit_file
    if units is None or where is None:
        return "; the unit of its depth, or its focal length, is wrong by that"
    likely = min(USUAL_UNITS, key=lambda usual: abs(np.log(usual / (units * size))))
    if not 0.75 < likely / (units * size) < 1.33 or likely == units:
        likely = float(f"{units * size:.2g}")
    return f"; depth_scale = {units:g} in {where} is wrong, {likely:g} is likely (or the focal length is wrong)"


def say_doubtful_size(source: Any, model: FaceModel, vertices: np.ndarray) -> None:
    """Warn about a head (V, 3) that few people have."""
    size, width, height = face_size(model, vertices)
    if doubt := likely_unit(source, size):
        name = f"{source.name}: " if source is not None else ""
        _log.warning(
            "%sthe face is %.0f mm wide and %.0f mm high, %.2f times the average one's; a %s face%s",
            name,
            width,
            height,
            size,
            "child's" if size < 1 else "very large",
            doubt,
        )


class SizeWatch:
    """Compares the first ``SAMPLE`` faces of a source once with the actor that is tracked in it.

    :meth:`see` raises :class:`ImplausibleFaceError` if the depth shows a face so much larger or smaller than the actor that it
    cannot be the same person, and warns if that is doubtful.
    """

    def __init__(self, source: Any, actor: Actor) -> None:
        self._source = source
        self._sizes: list[float] = []
        self._points = surface_points(actor.neutral, actor.feature_triangles, actor.feature_weights)
        self._done = Abilities.of(source).colour_only

    def see(self, frame: RgbdFrame) -> None:
        """Add a frame with features."""
        if self._done:
            return
        size = measured_size(frame, self._points)
        if not np.isnan(size):
            self._sizes.append(size)
        if len(self._sizes) == SAMPLE:
            self.judge()

    def judge(self) -> None:
        """Judge the frames so far, unless this was already done."""
        if self._done or not self._sizes:
            return
        self._done, size = True, float(np.median(self._sizes))
        text = f"the face is {size:.2f} times as large as the actor's"
        if not SAME_PERSON[0] < size < SAME_PERSON[1]:
            raise ImplausibleFaceError(text, size).of(self._source)
        if hint := likely_unit(self._source, size):
            _log.warning("%s: %s: another person's%s", self._source.name, text, hint.replace("; ", ", or ", 1))
