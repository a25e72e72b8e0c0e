"""2D facial features on colour images: MediaPipe's face mesh, reduced to the 40 features of the method."""

from .detector import FeatureDetector
from .model_file import face_landmarker_file
from .upright import Upright

__all__ = ["FeatureDetector", "Upright", "face_landmarker_file"]
