"""Functions that numba compiles, once per machine: the code is kept beside the module, else in our cache, else nowhere.

Numba itself ends with an error where neither the module's folder nor the home can be written, makes a folder named ``~``
where there is no home, and cannot read a file that was cut off.
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
    """As ``numba.njit(**options)``, with a cache wherever one can be written; with options it makes the decorator."""
    if function is None:
        return lambda decorated: compiled(decorated, **options)
    dispatcher = numba.njit(**options)(function)
    if hasattr(dispatcher, "enable_caching"):  # numba may be switched off
        try:
            dispatcher._cache = _Cache(function)
        except RuntimeError:  # no place for it: compiled in every process
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
        """The locator, or None where nothing can be written."""
        try:
            return super().from_function(function, file)
        except OSError:
            return None


@cache
def _folder() -> Path | None:
    return cache_folder()


class _Checked(caching.CompileResultCacheImpl):
    """Compiled code with its checksum: damaged machine code would be run."""

    _locator_classes = [_Named, _Beside, _OurCache]

    def reduce(self, data):
        """What is stored: checksum and bytes."""
        content = dumps(super().reduce(data))
        return hashlib.sha256(content).digest(), content

    def rebuild(self, target_context, stored):
        """The compiled code of what was stored; raises ValueError for another checksum."""
        checksum, content = stored
        if hashlib.sha256(content).digest() != checksum:
            raise ValueError("damaged")
        return super().rebuild(target_context, pickle.loads(content))


class _Cache(caching.FunctionCache):
    """Throws damaged files away, and does without a cache that can no longer be written."""

    _impl_class = _Checked

    def load_overload(self, sig, target_context):
        """The compiled code for a signature, or None where it must be compiled."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # whatever unpickling a damaged file raises
            _say_damaged(self.cache_path)
            self._drop()
            return None

    def save_overload(self, sig, data) -> None:
        """Store compiled code; a full or read-only disk only means that it is compiled again next time."""
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
