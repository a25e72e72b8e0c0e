"""Errors of the package: each message names the file or value, the reason, and the way out.

The command line turns any :class:`AdaptiveFaceError` into one line on stderr and exit status 2.
"""

#: What MediaPipe, and the OpenCV that it brings, are linked against; a bare Debian lacks it.
SYSTEM_LIBRARIES_HINT = "on Debian or Ubuntu: apt install libegl1 libgles2 libgl1 libglib2.0-0"


class AdaptiveFaceError(Exception):
    """Base class: anything the user can act on (a bad file, a bad value, a missing extra)."""


class ParameterError(AdaptiveFaceError, ValueError):
    """A parameter does not exist, has the wrong type, or lies outside its range."""


class FileFormatError(AdaptiveFaceError, ValueError):
    """A file is missing, truncated, malformed, or holds values that cannot be used."""


class FrameError(AdaptiveFaceError):
    """One frame of a good recording cannot be used; the caller skips and counts it."""


class FeatureDetectionError(AdaptiveFaceError):
    """The 2D feature detector (or its model file) is not available."""


class TrackingError(AdaptiveFaceError):
    """A stage could not produce a result (no face found, too few correspondences, ...)."""


class MissingExtraError(AdaptiveFaceError, ImportError):
    """An optional dependency is not installed; the message holds the exact pip line."""
