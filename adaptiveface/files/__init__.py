"""Files as they come and go: writing that leaves the old file or the whole new one, reading that is bounded."""

from .atomic import replacing
from .bounded import read_bytes, read_text
from .mapped import blocks, map_member, release

__all__ = ["blocks", "map_member", "read_bytes", "read_text", "release", "replacing"]
