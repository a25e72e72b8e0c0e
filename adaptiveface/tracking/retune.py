"""Deprecated; use :meth:`.base.Tracker.with_parameters`."""

from __future__ import annotations

import warnings
from typing import TypeVar

from ..parameters import Parameters
from .base import Tracker

AnyTracker = TypeVar("AnyTracker", bound=Tracker)


def retuned(tracker: AnyTracker, parameters: Parameters, relearn: bool = True) -> AnyTracker:
    """Deprecated alias of :meth:`.base.Tracker.with_parameters`; the next version is without it."""
    warnings.warn("retuned(tracker, ...) is now tracker.with_parameters(...)", DeprecationWarning, stacklevel=2)
    return tracker.with_parameters(parameters, relearn)
