"""Show in notebooks what other packages compute; this is the only package that imports ipywidgets.

The extra ``notebooks`` is required. :func:`load_session` gives a performance, and :class:`StageExplorer` shows a stage. The
modules whose names end in ``_study`` show what a single notebook needs; :mod:`adaptiveface.studies` computes it.
"""

import cv2
from threadpoolctl import threadpool_limits

from ..errors import MissingExtraError
from ..parameters import Parameters
from ..renamed import old_objects
from ..tracking.verdict import verdict_of

try:
    import anywidget  # noqa: F401
    import ipywidgets  # noqa: F401
except ImportError:
    raise MissingExtraError('the notebooks need more packages: python -m pip install "adaptiveface[notebooks]"') from None

from ..studies.measures import Measures, depth_distance, plain
from ..studies.session import Session, fast, load_session
from . import saved
from .charts import BarChart, GridChart, LiveChart
from .face_view import FaceView
from .kernel import on_main_thread, running_tasks, strict
from .live_view import LiveView
from .parameter_panel import ParameterPanel
from .pictures import CameraView
from .player import Player
from .replay import Replay
from .stage_explorer import SeriesCache, StageExplorer, error_chart, figure_11
from .turntable import Turntable

__getattr__ = old_objects(__name__)

# What is displayed leaves pictures in the notebook.
saved.install()

# For the whole kernel: on shared cores a second BLAS thread stalls small products for up to 100 ms, a stutter, and a second
# thread of OpenCV only takes time from the others.
threadpool_limits(limits=1, user_api="blas")
cv2.setNumThreads(1)

__all__ = [
    "BarChart",
    "CameraView",
    "FaceView",
    "GridChart",
    "LiveChart",
    "LiveView",
    "Measures",
    "ParameterPanel",
    "Parameters",
    "Player",
    "Replay",
    "SeriesCache",
    "Session",
    "StageExplorer",
    "depth_distance",
    "error_chart",
    "fast",
    "figure_11",
    "load_session",
    "Turntable",
    "on_main_thread",
    "plain",
    "running_tasks",
    "strict",
    "verdict_of",
]
