"""Which way up the pictures are, by what the detector itself finds in them: phones lie on their side, rigs hang upside down.

The detector finds faces that are turned by up to a quarter, and says so by where it puts eyes and mouth; upside down it finds
none, or an upright one in the wrong place. So each picture is shown to it in all four ways, and the ways vote.
"""

from __future__ import annotations

import dataclasses
import logging
from collections import Counter

import numpy as np

from ..geometry.frame import FEATURE_REGIONS, Features2D, RgbdFrame
from ..sensors.orientation import AnyFrame, turned

#: Ways in which a picture is shown, in quarters of a turn anticlockwise: the first two agree where it is upright.
_ORDER = (0, 1, 3, 2)
#: Votes by which one way must lead to be taken for good; frames with a face after which the leading one is taken anyhow.
LEAD, MOST_FRAMES = 2, 12
_log = logging.getLogger(__name__)


class Upright:
    """Finds features as ``detector`` does, in frames turned upright; ``name`` of their source, for what is said.

    With :meth:`spare` it lets frames pass unsearched, as long as the tracker is certain where the features are.

    ``quarters``: by how much frames are turned anticlockwise, for good once it is ``decided``. A detector that has no
    ``look`` is taken as it is, and frames are never turned.
    """

    def __init__(self, detector, name: str = "") -> None:
        self.detector, self.name = detector, name
        self.quarters, self.decided = 0, not hasattr(detector, "look")
        self._votes: Counter[int] = Counter()
        self._frames = 0
        self._every, self._since = 1, 0

    def spare(self, every: int) -> None:
        """From now on search every ``every``-th frame; 1, for a tracker that is not certain, searches the next one."""
        self._every = every

    def detect(self, frame: AnyFrame) -> AnyFrame:
        """``frame`` the right way up, with its features or None where no face is seen."""
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
        """By how many votes the leading way leads."""
        first, second, *_ = sorted((self._votes[quarters] for quarters in range(4)), reverse=True)
        return first - second


def roll_quarters(features: Features2D) -> int:
    """By how many quarters of a turn anticlockwise a face is turned in its picture: from the lips up to the eyes."""
    eyes, lips = (np.nanmean(features.pixels[FEATURE_REGIONS == region], axis=0) for region in ("eyes", "lips"))
    right, down = eyes - lips
    return round(np.degrees(np.arctan2(-right, -down)) / 90.0) % 4
