"""adaptiveface: facial performance capture with on-the-fly correctives (Li, Yu, Ye, Bregler 2013).

The names most programs need; everything else is imported from its module::

    from adaptiveface import FaceTracker, capture_source, open_source

    source = open_source("synthetic")
    actor = capture_source(source, neutral_frames=40)
    tracker = FaceTracker(actor)
    for index in range(len(source)):
        result = tracker.track(source.read(index))
"""

from __future__ import annotations

import importlib

from . import renamed

__version__ = "0.1.0"

renamed.find_old_modules()

# Imported on first use: `adaptiveface --version` need not load OpenCV and numba.
_HOME = {
    "Actor": "model.actor",
    "AdaptiveFaceError": "errors",
    "Camera": "geometry.camera",
    "FaceModel": "model.face_model",
    "FaceTracker": "tracking.tracker",
    "Features2D": "geometry.frame",
    "Parameters": "parameters",
    "Recording": "sensors.recording",
    "Result": "result",
    "RgbdFrame": "geometry.frame",
    "SyntheticSensor": "synthetic.sensor",
    "TrackedFrame": "tracking.types",
    "capture_actor": "neutral.capture",
    "capture_source": "pipeline",
    "embedded_face_model": "model.face_model",
    "evaluate_run": "evaluation",
    "open_source": "sensors",
    "track_source": "pipeline",
    "write_report": "report",
}

__all__ = ["__version__", *_HOME]
_renamed_object = renamed.old_objects(__name__)


def __getattr__(name: str):
    if name not in _HOME:
        return _renamed_object(name)
    return getattr(importlib.import_module(f".{_HOME[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
