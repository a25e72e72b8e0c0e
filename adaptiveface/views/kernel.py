"""Handle callbacks, errors and background tasks of views inside a Jupyter kernel.

JupyterLab runs widget callbacks on a second thread ("subshell"), where they would change trackers and views in the middle of
what a cell or a background task does with them. Callbacks are therefore handed to the kernel's main loop. If several
arrive while the loop is busy, only the newest one runs. Long work is an asyncio task of that loop, cut into short steps, so the
views have no threads of their own.
"""

from __future__ import annotations

import asyncio
import functools
import html
import os
import threading
import traceback
import weakref
from collections.abc import Callable, Coroutine
from contextlib import contextmanager

import ipywidgets as widgets

from ..errors import AdaptiveFaceError

#: Environment variable: errors of callbacks are raised as well as shown, so that test runs fail.
STRICT = "ADAPTIVEFACE_STRICT"
#: Style of an error message: a card with its own ground, legible on a light and on a dark page.
ALERT = "background:#fdecea;color:#8c1d18;padding:4px 8px"

_tasks: weakref.WeakSet[BackgroundTask] = weakref.WeakSet()


def strict() -> bool:
    """Whether errors in callbacks must be raised (``ADAPTIVEFACE_STRICT=1``)."""
    return os.environ.get(STRICT, "") not in ("", "0")


def running_loop() -> asyncio.AbstractEventLoop | None:
    """The kernel's event loop, or None in plain Python."""
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None


class Displayed:
    """A view that a notebook shows by its ``widget``."""

    widget: widgets.Widget

    def _ipython_display_(self) -> None:
        from IPython.display import display

        display(self.widget)


def on_main_thread(function: Callable) -> Callable:
    """Decorate a widget callback so that it runs on the kernel's main thread, and only the newest of several waiting calls.

    The decorator must be applied in code that a cell calls.
    """
    loop, lock = running_loop(), threading.Lock()
    waiting: list[tuple[tuple, dict]] = []

    def run_newest() -> None:
        """Run the newest of the waiting calls, and drop the others."""
        with lock:
            arguments, options = waiting.pop()
            waiting.clear()
        function(*arguments, **options)

    @functools.wraps(function)
    def wrapper(*arguments, **options):
        """Run at once on the main thread. On any other thread, wait until the main thread is free."""
        if loop is None or threading.current_thread() is threading.main_thread():
            return function(*arguments, **options)
        with lock:
            waiting.append((arguments, options))
            first = len(waiting) == 1
        if first:
            loop.call_soon_threadsafe(run_newest)
        return None

    return wrapper


@contextmanager
def shown_errors(show: Callable[[str], None]):
    """Catch errors and pass their message to ``show`` as HTML, or "" if there was none. If :func:`strict`, also raise them."""
    try:
        yield
    except Exception as error:
        text = str(error) if isinstance(error, AdaptiveFaceError) else "".join(traceback.format_exception_only(error))
        show(f"<div role='alert' style='{ALERT}'><b>Not applied:</b> {html.escape(text.strip())}</div>")
        if strict():
            raise
    else:
        show("")


class BackgroundTask:
    """At most one asyncio task. Starting another one stops it. In plain Python, without a loop, a task runs to its end."""

    def __init__(self) -> None:
        self._task: asyncio.Task | None = None
        _tasks.add(self)

    @property
    def running(self) -> bool:
        """Whether the task has begun and has not ended."""
        return self._task is not None and not self._task.done()

    def start(self, coroutine: Coroutine) -> None:
        """Stop the current task and run ``coroutine``. Without an event loop, it runs to its end at once."""
        self.stop()
        loop = running_loop()
        if loop is None:
            asyncio.run(coroutine)
        else:
            self._task = loop.create_task(coroutine)
            self._task.add_done_callback(_tell)

    def stop(self) -> None:
        """Cancel the task if it is running. Another one can start at once."""
        if self._task is not None and not self._task.done():
            self._task.cancel()
            self._task = None

    async def finished(self) -> None:
        """Wait for the task to end, and raise its error if it failed."""
        while self.running:
            await asyncio.sleep(0.01)
        error = None if self._task is None else _error(self._task)
        if error is not None:
            raise error


def _error(task: asyncio.Task) -> BaseException | None:
    """The error that ended a task, or None."""
    return None if task.cancelled() else task.exception()


def _tell(task: asyncio.Task) -> None:
    """Show an error that nobody waits for under the cell. It also fails a test run of the notebook."""
    error = _error(task)
    if error is not None:
        from IPython import get_ipython

        if get_ipython() is not None:
            get_ipython().showtraceback((type(error), error, error.__traceback__))


def running_tasks() -> int:
    """Number of background tasks that are still running; 0 when every view is closed."""
    return sum(task.running for task in _tasks)
