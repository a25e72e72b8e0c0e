"""What the tracked mesh lacks: eyeballs, teeth, tongue and the dark of the mouth, for exports and pictures."""

from .head import Insides, make_insides, moved, placed

__all__ = ["Insides", "make_insides", "moved", "placed"]
