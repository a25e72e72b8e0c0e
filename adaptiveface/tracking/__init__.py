"""Sections 4 and 5: the real-time tracker and its stages."""
