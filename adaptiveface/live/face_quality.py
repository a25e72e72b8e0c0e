"""Keep the old place of :mod:`adaptiveface.neutral.face_quality`."""

from ..neutral.face_quality import (
    Expression,
    expression,
    eye_distance,
    head_angles,
    seen_by_depth,
    sharpness,
)

__all__ = ["Expression", "expression", "eye_distance", "head_angles", "seen_by_depth", "sharpness"]
