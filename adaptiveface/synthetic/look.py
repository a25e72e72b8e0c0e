"""How a synthetic performer's pictures look: the skin, the light in the room and the camera's picture, chosen by name."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields

from ..errors import ParameterError
from .noise import DEPTH_SCALES

#: What each part of a :class:`Look` may be; the first is the default.
CHOICES = {
    "skin": ("drawn", "even", "freckled", "bearded", "made-up", "oily"),
    "light": ("steady", "moving", "changing"),
    "camera": ("plain", "video"),
}
_SEED = re.compile(r"[0-9]{1,9}")


@dataclass(frozen=True)
class Look:
    """What the colour pictures show.

    Attributes
    ----------
    skin : str
        "drawn": the simple pattern of :mod:`.paint`. "even": the same without any pattern, only lips, brows, lashes and hair.
        "freckled", "bearded", "made-up", "oily": as in photographs (:mod:`.photographic`).
    light : str
        "steady"; "moving": a lamp is carried round the face; "changing": lamps of other colours go on and off (:mod:`.lamp`).
    camera : str
        "plain": white grain; "video": motion blur, automatic gain and white balance, the noise of photons and of the
        read-out, colours at half the resolution (:mod:`.video_camera`).

    Raises
    ------
    ParameterError
        For another name.
    """

    skin: str = "drawn"
    light: str = "steady"
    camera: str = "plain"

    def __post_init__(self) -> None:
        for name, known in CHOICES.items():
            if getattr(self, name) not in known:
                raise ParameterError(f"{name} = {getattr(self, name)!r}: one of {', '.join(known)} is expected")

    def __str__(self) -> str:
        """What differs from the default, as in a source's name: "skin=oily:light=moving"; empty for the default."""
        return ":".join(f"{f.name}={getattr(self, f.name)}" for f in fields(self) if getattr(self, f.name) != f.default)


#: How :func:`parse_performer` wants it, for messages and help.
PERFORMER = "SEED[:NOISE][:skin=SKIN][:light=LIGHT][:camera=CAMERA]"


def parse_performer(text: str) -> tuple[int | None, str | None, Look]:
    """Seed, noise (None: not named) and look of a synthetic source's name, without its "synthetic:" and its take.

    Raises :class:`ParameterError` for what is none.
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
