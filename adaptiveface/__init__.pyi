"""What `adaptiveface` exports, for type checkers and editors: __init__.py imports each name on first use (SPEC 1)."""

from .errors import AdaptiveFaceError as AdaptiveFaceError
from .evaluation import evaluate_run as evaluate_run
from .geometry.camera import Camera as Camera
from .geometry.frame import Features2D as Features2D
from .geometry.frame import RgbdFrame as RgbdFrame
from .model.actor import Actor as Actor
from .model.face_model import FaceModel as FaceModel
from .model.face_model import embedded_face_model as embedded_face_model
from .neutral.capture import capture_actor as capture_actor
from .parameters import Parameters as Parameters
from .pipeline import capture_source as capture_source
from .pipeline import track_source as track_source
from .report import write_report as write_report
from .result import Result as Result
from .sensors import open_source as open_source
from .sensors.recording import Recording as Recording
from .synthetic.sensor import SyntheticSensor as SyntheticSensor
from .tracking.tracker import FaceTracker as FaceTracker
from .tracking.types import TrackedFrame as TrackedFrame

__version__: str
