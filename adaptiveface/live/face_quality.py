"""Where :mod:`adaptiveface.neutral.face_quality` was before recordings were judged by it, too."""

from ..neutral.face_quality import (
    Expression,
    expression,
    eye_distance,
    head_angles,
    seen_by_depth,
    sharpness,
)

__all__ = ["Expression", "expression", "eye_distance", "head_angles", "seen_by_depth", "sharpness"]
