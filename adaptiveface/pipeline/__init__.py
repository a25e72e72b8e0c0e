"""Run the whole method: read frames, find their features, capture the neutral, track, and collect one result per frame.

Sensors, detector, capture and tracking do not know each other and are combined here. Broken frames are skipped and counted, and
never reach the tracker.
"""

from ..renamed import old_objects
from ..runtime.threads import one_thread
from .capture import MAX_NEUTRAL_FRAMES, capture_source
from .reader import FrameReader
from .track import OnFrame, TrackingInterrupted, track_source, track_to_file

__all__ = [
    "MAX_NEUTRAL_FRAMES",
    "FrameReader",
    "OnFrame",
    "TrackingInterrupted",
    "capture_source",
    "one_thread",
    "track_source",
    "track_to_file",
]

__getattr__ = old_objects(__name__)
