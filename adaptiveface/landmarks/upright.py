"""Find out which way up the pictures are, for phones that lie on their side and rigs that hang upside down.

The detector itself is the judge. It finds faces that are rotated by up to a quarter turn, and the places of eyes and mouth show
the rotation. In a picture that is upside down, it finds no face, or an upright one in the wrong place. Each picture is
therefore shown to it in all four orientations, and the orientations collect votes.
"""

from __future__ import annotations

import dataclasses
import logging
from collections import Counter

import numpy as np

from ..geometry.frame import FEATURE_REGIONS, Features2D, RgbdFrame
from ..sensors.orientation import AnyFrame, turned

#: Orientations in which a picture is shown, in quarter turns anticlockwise. For an upright picture the first two agree.
_ORDER = (0, 1, 3, 2)
#: Lead in votes at which an orientation is final, and number of frames with a face after which the leading one is final anyway.
LEAD, MOST_FRAMES = 2, 12
_log = logging.getLogger(__name__)


class Upright:
    """Turns frames upright and detects their features.

    With :meth:`spare`, frames pass without a search while the tracker is certain of the features' places. ``quarters`` is the
    number of quarter turns anticlockwise, which is final once ``decided`` is True.

    Parameters
    ----------
    detector
        Detects features, such as a :class:`FeatureDetector`. Without a method ``look``, frames are never turned.
    name : str
        Name of the frames' source, for messages.
    """

    def __init__(self, detector, name: str = "") -> None:
        self.detector, self.name = detector, name
        self.quarters, self.decided = 0, not hasattr(detector, "look")
        self._votes: Counter[int] = Counter()
        self._frames = 0
        self._every, self._since = 1, 0

    def spare(self, every: int) -> None:
        """Search only every ``every``-th frame from now on. With 1, for an uncertain tracker, the next frame is searched."""
        self._every = every

    def detect(self, frame: AnyFrame) -> AnyFrame:
        """Return ``frame`` the right way up with its features, which are None without a face or a search."""
        found = turned(frame, self.quarters)
        self._since += 1
        if self.decided and self._since < self._every and frame.colour is not None:
            return dataclasses.replace(found, features=None, searched=False)
        self._since = 0
        features = self.detector.detect(found)
        if not self.decided and frame.colour is not None:
            before = self.quarters
            self._look_round(frame, features if before == 0 else self.detector.look(frame))
            if self.quarters != before:
                self.detector.forget()
                found = turned(frame, self.quarters)
                features = self.detector.detect(found)
        return dataclasses.replace(found, features=features)

    def _look_round(self, frame: RgbdFrame, as_it_is: Features2D | None) -> None:
        seen = False
        for quarters in _ORDER:
            features = as_it_is if quarters == 0 else self.detector.look(turned(frame, quarters))
            if features is None:
                continue
            seen = True
            self._votes[(quarters - roll_quarters(features)) % 4] += 1
            if self._lead() >= LEAD:
                break
        self._frames += seen
        leading = max(_ORDER, key=lambda quarters: (self._votes[quarters], quarters == 0))
        self.decided = self._lead() >= LEAD or self._frames >= MOST_FRAMES
        if self.decided and leading:
            _log.warning("%s: the face is turned in the pictures; they are turned by %d degrees", self.name, 90 * leading)
        self.quarters = leading

    def _lead(self) -> int:
        """Return by how many votes the first orientation leads over the second."""
        first, second, *_ = sorted((self._votes[quarters] for quarters in range(4)), reverse=True)
        return first - second


def roll_quarters(features: Features2D) -> int:
    """Return the rotation of a face in its picture, in quarter turns anticlockwise.

    The direction from the lips to the eyes shows the rotation.
    """
    eyes, lips = (np.nanmean(features.pixels[FEATURE_REGIONS == region], axis=0) for region in ("eyes", "lips"))
    right, down = eyes - lips
    return round(np.degrees(np.arctan2(-right, -down)) / 90.0) % 4
