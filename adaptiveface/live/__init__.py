"""Capture live: a guided neutral scan, then features and tracking in their own threads, which count every lost frame."""

from .feed import FeatureFeed
from .session import LiveResult, LiveSession, LiveStatistics

__all__ = ["FeatureFeed", "LiveResult", "LiveSession", "LiveStatistics"]
