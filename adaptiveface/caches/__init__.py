"""Keep files that can be made again: compiled code, the detector's model, the performance that the notebooks render."""

from .folders import cache_folder, cache_folders, writable

__all__ = ["cache_folder", "cache_folders", "writable"]
