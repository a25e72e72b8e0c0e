"""Files as they come and go: writing that leaves the old file or the whole new one, reading that is bounded."""

from .atomic import replacing
from .bounded import read_bytes, read_text

__all__ = ["read_bytes", "read_text", "replacing"]
