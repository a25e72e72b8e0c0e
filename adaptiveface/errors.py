"""Define the errors of the package, whose messages name the file or value, the reason, and the way out.

The command line turns any :class:`AdaptiveFaceError` into one line on stderr and exit status 2.
"""

#: What MediaPipe, and the OpenCV that it brings, are linked against; a bare Debian lacks it.
SYSTEM_LIBRARIES_HINT = "on Debian or Ubuntu: apt install libegl1 libgles2 libgl1 libglib2.0-0"


def abbreviated(value: object, length: int = 60) -> str:
    """A value out of a file or a command line as text for a message, with "..." for what is beyond ``length`` characters.

    A float is written with the digits that say what it is; a whole number may have thousands of them.
    """
    if isinstance(value, float):
        return f"{value:g}"
    try:
        text = str(value)
    except ValueError:  # Python writes no whole number of more than 4300 digits
        return "a huge number"
    return text if len(text) <= length else f"{text[: length - 3]}..."


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


class SensorError(AdaptiveFaceError):
    """Base class of what a live sensor reports; a vendor's own exception never leaves its driver."""


class SensorNotFoundError(SensorError):
    """No sensor of that kind (or with that serial number) is connected."""


class SensorTimeoutError(SensorError):
    """The sensor is connected but sent no new frame in time."""


class SensorDisconnectedError(SensorError):
    """The sensor was unplugged or stopped answering; it is opened again as soon as it is back."""


class EndOfRecording(SensorError):  # noqa: N818 - the regular end of a recording, not a failure
    """A recording that plays as a sensor has no more frames."""


class DriverMissingError(SensorError, MissingExtraError):
    """The vendor's library is not installed; the message holds the exact pip line."""


class RecordingError(AdaptiveFaceError):
    """A recording could not be written on (the disk is full, ...); what was written before stays."""
