"""Add to the tracked mesh what it lacks: eyeballs, teeth, a tongue and the dark of the mouth."""

from .head import Insides, make_insides, moved, placed

__all__ = ["Insides", "make_insides", "moved", "placed"]
