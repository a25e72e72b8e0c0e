"""Read and write Live Link Face's formats: ARKit's 52 face shapes with head and eye rotations, as iPhones send and store them.

Only ``convention`` holds signs, axes and units. ``take`` reads and writes the CSV files of Live Link Face, ``packet`` encodes
and decodes its datagrams, and ``receiver`` listens for them.
"""

from .convention import ARKIT_NAMES, ROTATIONS
from .take import LiveLinkTake, read_take, write_take

__all__ = ["ARKIT_NAMES", "ROTATIONS", "LiveLinkTake", "read_take", "write_take"]
