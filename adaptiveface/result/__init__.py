"""What a tracked performance leaves behind: entries as they come (``rows``), the whole (``Result``), ways to look into it."""

from .result import COLOUR_ONLY, MESHES, Result, ResultBuilder

__all__ = ["COLOUR_ONLY", "MESHES", "Result", "ResultBuilder"]
