"""Keep old names working for one more version, with a ``DeprecationWarning``.

One table is for classes (parameters, keywords and attributes), one for names in modules, one for modules. Files keep the names
that they have (``rigid`` in ``result.npz``, the parameters stored there), and are read without a warning.
"""

from __future__ import annotations

import functools
import importlib
import importlib.abc
import importlib.machinery
import sys
import warnings
from collections.abc import Callable, Mapping
from types import ModuleType
from typing import Any, TypeVar

_REACH = "max_correspondence_distance"
_POSE = {"rigid": "head_pose"}
_ANGLE = {"normal_angle": "max_normal_angle"}
#: Class -> its old names -> those of today.
OLD_NAMES: dict[str, dict[str, str]] = {
    "DepthParameters": {"min_view": "min_cosine"},
    "RigidParameters": {
        **{"prune": _REACH, "lost": "max_residual", "outlier": "outlier_distance", "converged": "min_step"},
        **{"stiff": "half_weight_motion", "relocate": "max_reprojection_error"},
    },
    "BlendshapeParameters": {
        **{"prune": _REACH, "turned": "profile_stiffness", "every": "vertex_stride", "outlier": "outlier_distance"},
        "habits": "expression_prior",
    },
    "LaplacianParameters": {"prune": _REACH, "steps": "cg_iterations"},
    "FusionParameters": {"prune": _REACH, **_ANGLE},
    "FitParameters": {"reach": _REACH, **_ANGLE},
    "ShrinkWrapParameters": {"reach": _REACH, **_ANGLE},
    "RefinementParameters": {"alike": "correlation_length"},
    "SkinParameters": {"looks": "gauss_newton_steps"},
    "PersonalBlendshapesParameters": {"spread": "prior_deviation"},
    "AnimatedMesh": _POSE,
    "GroundTruth": _POSE,
    "Performance": _POSE,
    "Result": _POSE,
    "ResultFrame": _POSE,
    "TrackedFrame": _POSE,
    "TruthFrame": _POSE,
    "Correspondences": {"alike": "equally_weighted"},
}
#: Module -> its old names -> module and name of today.
OLD_OBJECTS: dict[str, dict[str, tuple[str, str]]] = {
    "adaptiveface": {"capture_from": ("adaptiveface.pipeline", "capture_source")},
    "adaptiveface.pipeline": {
        "capture_from": ("adaptiveface.pipeline", "capture_source"),
        "one_blas_thread": ("adaptiveface.runtime.threads", "one_thread"),
    },
    "adaptiveface.runtime.threads": {"one_blas_thread": ("adaptiveface.runtime.threads", "one_thread")},
    "adaptiveface.views": {"Workbench": ("adaptiveface.views.stage_explorer", "StageExplorer")},
    "adaptiveface.retargeting.character": {"load_character": ("adaptiveface.retargeting.loading", "load_character")},
}

#: Module -> where it is now.
OLD_MODULES = {
    f"adaptiveface.{old}": f"adaptiveface.{new}"
    for old, new in {
        "actor": "model.actor",
        "appearance": "model.appearance",
        "blas": "runtime.threads",
        "runtime.blas": "runtime.threads",
        "blendshapes": "model.blendshapes",
        "camera": "geometry.camera",
        "face_model": "model.face_model",
        "feature_set": "model.feature_set",
        "frame": "geometry.frame",
        "gaze": "insides.gaze",
        "interrupt": "runtime.interrupt",
        "mesh": "geometry.mesh",
        "npz": "files.npz",
        "painting": "geometry.painting",
        "polydata": "geometry.polydata",
        "rendering": "geometry.rendering",
        "result_access": "result.access",
        "rows": "result.rows",
        "sensors.numbered": "geometry.source",
        "stages": "parameters.stages",
        "timing": "runtime.timing",
        "importers.obj": "formats.obj",
        "export.gltf_edit": "formats.gltf.edit",
        **{
            f"retargeting.gltf_{name}": f"formats.gltf.{name}"
            for name in ("bones", "compressed", "container", "file", "nodes", "pieces")
        },
        **{f"views.{name}": f"studies.{name}" for name in ("measures", "recorded", "session")},
    }.items()
}

AnyClass = TypeVar("AnyClass", bound=type)


def warn(old: str, new: str, stacklevel: int = 3) -> None:
    """Say that ``old`` is called ``new``; ``stacklevel`` as of :func:`warnings.warn`, seen from here."""
    warnings.warn(f"{old} is now called {new}; the next version is without the old name", DeprecationWarning, stacklevel)


def renamed(cls: AnyClass) -> AnyClass:
    """Class decorator: the old names of ``OLD_NAMES`` work as attributes and as keywords of the constructor.

    Where both names are given, the old one counts: ``dataclasses.replace(x, old=value)`` passes both.
    """
    names, make = OLD_NAMES[cls.__name__], cls.__init__  # type: ignore[misc]

    @functools.wraps(make)
    def __init__(self: Any, *args: Any, **kwargs: Any) -> None:
        for old in names.keys() & kwargs.keys() if kwargs else ():
            warn(f"{cls.__name__}({old}=...)", names[old])
            kwargs[names[old]] = kwargs.pop(old)
        make(self, *args, **kwargs)

    cls.__init__ = __init__  # type: ignore[misc]
    for old, new in names.items():
        setattr(cls, old, property(_reader(cls.__name__, old, new)))
    return cls


def _reader(owner: str, old: str, new: str) -> Callable[[Any], Any]:
    def read(self: Any) -> Any:
        """Return the attribute under its name of today, with a warning."""
        warn(f"{owner}.{old}", new)
        return getattr(self, new)

    read.__doc__ = f"Deprecated; now ``{new}``."
    return read


def old_objects(module: str) -> Callable[[str], Any]:
    """The ``__getattr__`` of a module whose names have changed, by ``OLD_OBJECTS``."""
    names: Mapping[str, tuple[str, str]] = OLD_OBJECTS[module]

    def find(name: str) -> Any:
        """Return the object that was called ``name``, with a warning; raises AttributeError for an unknown name."""
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        home, new = names[name]
        warn(f"{module}.{name}", f"{home}.{new}")
        return getattr(importlib.import_module(home), new)

    return find


class _OldModules(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finds modules by the names in ``OLD_MODULES``: the old name is the very module of the new one."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> importlib.machinery.ModuleSpec | None:
        """The specification of a module that has moved."""
        return importlib.machinery.ModuleSpec(name, self) if name in OLD_MODULES else None

    def exec_module(self, module: ModuleType) -> None:
        """Put the module of the new name in the place of the one that the import system has prepared."""
        new = OLD_MODULES[module.__name__]
        warn(module.__name__, new)
        sys.modules[module.__name__] = importlib.import_module(new)


def find_old_modules() -> None:
    """Make the names in ``OLD_MODULES`` importable."""
    if not any(isinstance(finder, _OldModules) for finder in sys.meta_path):
        sys.meta_path.insert(0, _OldModules())
