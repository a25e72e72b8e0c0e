"""Hold what tracking leaves behind: rows while it runs (:mod:`.rows`), the whole :class:`Result`, ways to look into it."""

from .result import COLOUR_ONLY, MESHES, Result, ResultBuilder

__all__ = ["COLOUR_ONLY", "MESHES", "Result", "ResultBuilder"]
