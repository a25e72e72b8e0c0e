"""Speak Live Link Face's conventions: ARKit's 52 face shapes, head and eye rotations, as iPhones send and store them.

``convention`` is the one place that holds signs, axes and units. ``take`` reads and writes Live Link Face's CSV,
``packet`` its datagrams, ``receiver`` listens to them.
"""

from .convention import ARKIT_NAMES, ROTATIONS
from .take import LiveLinkTake, read_take, write_take

__all__ = ["ARKIT_NAMES", "ROTATIONS", "LiveLinkTake", "read_take", "write_take"]
