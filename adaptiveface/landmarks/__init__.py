"""Find 2D facial features in colour images with MediaPipe's face mesh, reduced to the method's 40 features."""

from .detector import FeatureDetector
from .model_file import face_landmarker_file
from .upright import Upright

__all__ = ["FeatureDetector", "Upright", "face_landmarker_file"]
