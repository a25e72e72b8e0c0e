"""adaptiveface: facial performance capture with on-the-fly correctives (Li, Yu, Ye, Bregler 2013)."""

__version__ = "0.1.0"
