"""Replace one function of the tracker for a while."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


@contextmanager
def replaced(owner: Any, name: str, function: Callable) -> Iterator[None]:
    """Context in which ``owner.name`` (a module's function or a class's method) is ``function``; restored on exit."""
    original = getattr(owner, name)
    setattr(owner, name, function)
    try:
        yield
    finally:
        setattr(owner, name, original)
