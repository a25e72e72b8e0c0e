"""Choose by name how a synthetic performer's pictures look: the skin, the light in the room and the camera's picture."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields

from ..errors import ParameterError
from .noise import DEPTH_SCALES

#: The possible values of each part of a :class:`Look`. The first one is the default.
CHOICES = {
    "skin": ("drawn", "even", "freckled", "bearded", "made-up", "oily"),
    "light": ("steady", "moving", "changing"),
    "camera": ("plain", "video"),
}
_SEED = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True)
class Look:
    """The look of the colour pictures.

    Attributes
    ----------
    skin : str
        "drawn" is the simple pattern of :mod:`.paint`. "even" has only lips, brows, lashes and hair, and no pattern.
        "freckled", "bearded", "made-up" and "oily" look like photographs (:mod:`.photographic`).
    light : str
        "steady", "moving" (a lamp is carried round the face) or "changing" (lamps of other colours go on and off). See
        :mod:`.lamp`.
    camera : str
        "plain" adds white grain. "video" adds motion blur, automatic gain and white balance, the noise of photons and of the
        read-out, and colours at half the resolution (:mod:`.video_camera`).

    Raises
    ------
    ParameterError
        A name is unknown.
    """

    skin: str = "drawn"
    light: str = "steady"
    camera: str = "plain"

    def __post_init__(self) -> None:
        for name, known in CHOICES.items():
            if getattr(self, name) not in known:
                raise ParameterError(f"{name} = {getattr(self, name)!r}: one of {', '.join(known)} is expected")

    def __str__(self) -> str:
        """Write what differs from the default as in a source's name: "skin=oily:light=moving", or "" for the default."""
        return ":".join(f"{f.name}={getattr(self, f.name)}" for f in fields(self) if getattr(self, f.name) != f.default)


#: The form that :func:`parse_performer` reads, for messages and help.
PERFORMER = "SEED[:NOISE][:skin=SKIN][:light=LIGHT][:camera=CAMERA]"


def parse_performer(text: str) -> tuple[int | None, str | None, Look]:
    """Read the name of a synthetic source.

    Parameters
    ----------
    text : str
        The name without "synthetic:" and without the take.

    Returns
    -------
    seed : int or None
        None if it is not named.
    noise : str or None
        None if it is not named.
    look : Look

    Raises
    ------
    ParameterError
        The text is not of the form ``PERFORMER``.
    """
    seed, *rest = text.split(":")
    if seed and not _SEED.fullmatch(seed):
        raise ParameterError(f"synthetic:{text}: the seed {seed!r} is not a whole number of at most 9 digits")
    noise, chosen = None, {}
    for number, entry in enumerate(rest):
        name, equals, value = entry.partition("=")
        if equals and name in CHOICES and name not in chosen:
            chosen[name] = value
        elif entry in DEPTH_SCALES and number == 0:
            noise = entry
        elif entry or number:
            options = "; ".join(f"{name}={'|'.join(known)}" for name, known in CHOICES.items())
            raise ParameterError(f"synthetic:{text}: unknown noise {entry!r}; possible: {', '.join(DEPTH_SCALES)}; {options}")
    try:
        return int(seed) if seed else None, noise, Look(**chosen)
    except ParameterError as error:
        raise ParameterError(f"synthetic:{text}: {error}") from None
