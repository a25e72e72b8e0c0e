"""2D facial features on colour images: MediaPipe's face mesh, reduced to the 40 features of the method."""

from .detector import FeatureDetector
from .model_file import face_landmarker_file

__all__ = ["FeatureDetector", "face_landmarker_file"]
