"""Live capture: guided neutral scan, features and tracking in threads of their own; every lost frame is counted."""

from .feed import FeatureFeed
from .session import LiveResult, LiveSession, LiveStatistics

__all__ = ["FeatureFeed", "LiveResult", "LiveSession", "LiveStatistics"]
