"""Where files are kept that can be made again: compiled code, the detector's model, the notebooks' performance."""

from .folders import cache_folder, cache_folders, writable

__all__ = ["cache_folder", "cache_folders", "writable"]
