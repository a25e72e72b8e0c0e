"""Hold the output of tracking: rows while it runs (:mod:`.rows`), the whole :class:`Result`, and access to its frames."""

from .result import COLOUR_ONLY, MESHES, Result, ResultBuilder

__all__ = ["COLOUR_ONLY", "MESHES", "Result", "ResultBuilder"]
