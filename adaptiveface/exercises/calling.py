"""Calling a learner's function: by keyword or by position, within a time limit, with the failing line of their own code."""

from __future__ import annotations

import ctypes
import inspect
import linecache
import threading
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

#: Seconds that one call may take. The package's own functions take milliseconds.
TIME_LIMIT = 10.0
#: How often, and how long after the limit, the call is asked to stop before it is left alone.
_ATTEMPTS, _PATIENCE = 20, 0.1


class OutOfTime(Exception):
    """The function did not end within the limit."""


def call(function: Callable, arguments: dict[str, Any], limit: float = TIME_LIMIT) -> Any:
    """``function(**arguments)``, or by position where the learner named the parameters otherwise.

    Raises
    ------
    OutOfTime
        The call took longer than ``limit`` seconds. It is stopped, so that no processor is kept busy by it; a call that
        sits in compiled code is left to end by itself.
    Exception
        Whatever the function raised.
    """
    outcome: dict[str, Any] = {}

    def run() -> None:
        try:
            with np.errstate(all="ignore"):
                outcome["answer"] = function(**arguments) if _takes(function, arguments) else function(*arguments.values())
        except BaseException as error:  # noqa: BLE001 - raised again in the caller's thread
            outcome["error"] = error

    worker = threading.Thread(target=run, daemon=True)
    worker.start()
    worker.join(limit)
    for _ in range(_ATTEMPTS):
        if not worker.is_alive():
            break
        ctypes.pythonapi.PyThreadState_SetAsyncExc(ctypes.c_ulong(worker.ident or 0), ctypes.py_object(OutOfTime))
        worker.join(_PATIENCE)
    if worker.is_alive() or isinstance(outcome.get("error"), OutOfTime):
        raise OutOfTime(f"it did not end within {limit:g} seconds")
    if "error" in outcome:
        raise outcome["error"]
    return outcome["answer"]


def _takes(function: Callable, arguments: dict[str, Any]) -> bool:
    """Whether the function takes the arguments by their names."""
    try:
        signature = inspect.signature(function)
    except (TypeError, ValueError):  # a built-in one
        return True
    try:
        signature.bind(**arguments)
        return True
    except TypeError:
        pass
    try:
        signature.bind(*arguments.values())
    except TypeError:
        names = ", ".join(arguments)
        raise TypeError(f"the function must take the {len(arguments)} arguments ({names})") from None
    return False


def where(error: BaseException, function: Callable) -> str:
    """``" in line 4: x = np.linalg.solve(h, g)"`` of the learner's own code; "" where the error arose elsewhere."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    if code is None:
        return ""
    own = [entry for entry in traceback.extract_tb(error.__traceback__) if entry.filename == code.co_filename]
    if not own:
        return ""
    line = own[-1].line or linecache.getline(code.co_filename, own[-1].lineno or 0).strip()
    number = (own[-1].lineno or code.co_firstlineno) - code.co_firstlineno + 1
    return f" in line {number} of your function" + (f": {line.strip()}" if line else "")
