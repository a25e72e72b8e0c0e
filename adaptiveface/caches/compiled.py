"""Compile functions with numba once per machine. The code is stored beside the module, else in our cache, else nowhere.

Numba's own cache raises an error if neither the module's folder nor the home can be written, creates a folder named ``~`` if
there is no home, and cannot read a file that was cut off.
"""

from __future__ import annotations

import hashlib
import pickle
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, overload

import numba
from numba.core import caching
from numba.core.serialize import dumps

from .folders import cache_folder

F = TypeVar("F", bound=Callable[..., Any])

# Older versions of numba name them with an underscore. Numba has no type hints.
_Beside: Any
_Named: Any
_Beside, _Named = (
    getattr(caching, name, None) or getattr(caching, f"_{name}") for name in ("InTreeCacheLocator", "UserProvidedCacheLocator")
)


@overload
def compiled(function: F) -> F: ...


@overload
def compiled(*, nogil: bool = ..., inline: str = ...) -> Callable[[F], F]: ...


def compiled(function: Callable | None = None, **options: Any) -> Any:
    """Decorate as ``numba.njit(**options)`` does, with a cache if one can be written. With options, return the decorator."""
    if function is None:
        return lambda decorated: compiled(decorated, **options)
    dispatcher = numba.njit(**options)(function)
    if hasattr(dispatcher, "enable_caching"):  # numba may be switched off
        try:
            dispatcher._cache = _Cache(function)
        except RuntimeError:  # no folder can be written: the function is compiled in every process
            pass
    return dispatcher


class _OurCache(_Beside):
    """The package's own cache folder."""

    def __init__(self, function, file: str) -> None:
        super().__init__(function, file)
        folder = _folder()
        if folder is None:
            raise OSError("no folder can be written")
        self._cache_path = str(folder / "compiled" / self.get_suitable_cache_subpath(file))

    @classmethod
    def from_function(cls, function, file: str):
        """The locator, or None if nothing can be written."""
        try:
            return super().from_function(function, file)
        except OSError:
            return None


@cache
def _folder() -> Path | None:
    return cache_folder()


class _Checked(caching.CompileResultCacheImpl):
    """Stores compiled code with its checksum, because damaged machine code would be run."""

    _locator_classes = [_Named, _Beside, _OurCache]

    def reduce(self, data):
        """The checksum and the bytes to store."""
        content = dumps(super().reduce(data))
        return hashlib.sha256(content).digest(), content

    def rebuild(self, target_context, stored):
        """The compiled code from what was stored. Raises ValueError if the checksum is wrong."""
        checksum, content = stored
        if hashlib.sha256(content).digest() != checksum:
            raise ValueError("damaged")
        return super().rebuild(target_context, pickle.loads(content))


class _Cache(caching.FunctionCache):
    """Removes damaged files, and works without a cache if it can no longer be written."""

    _impl_class = _Checked

    def load_overload(self, sig, target_context):
        """The compiled code for a signature, or None if it must be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # unpickling a damaged file raises anything
            _say_damaged(self.cache_path)
            self._drop()
            return None

    def save_overload(self, sig, data) -> None:
        """Store compiled code. If the disk is full or read-only, the function is only compiled again next time."""
        try:
            super().save_overload(sig, data)
        except OSError:
            pass
        except Exception:  # a damaged index
            self._drop()

    def _drop(self) -> None:
        try:
            self.flush()
        except OSError:
            pass


@cache
def _say_damaged(folder: str) -> None:
    print(f"adaptiveface: damaged compiled code in {folder} is thrown away and made again", file=sys.stderr)
