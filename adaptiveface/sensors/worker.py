"""Provide what every live thread needs: a body that runs until it is told to stop, and a slot for its newest item."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from ..errors import AdaptiveFaceError, SensorError, SensorTimeoutError

T = TypeVar("T")

#: Longest time that a thread waits for an item, s. It is short, so that closing, messages and changes stay responsive.
POLL_SECONDS = 0.1


class Latest(Generic[T]):
    """Hands items from the thread that makes them to the thread that reads them.

    Without room, an item takes the place of the oldest one, so that a slow reader never falls behind. The exception is a
    producer that waits.

    Parameters
    ----------
    name : str
        Name of the sensor, for messages.
    what : str
        Name of the slot's owner, for messages.
    waits : bool
        Whether the producer waits until there is room. A recording does, because it hands over every item.

    Attributes
    ----------
    changed : threading.Condition
        Guards the slot, and everything that its owner changes together with it.
    capacity : int
        Largest number of unread items.
    closed : bool
        Whether :meth:`close` was called.
    newest : object or None
        The last item that was put, whether it was read or not.
    """

    def __init__(self, name: str, what: str, waits: bool = False) -> None:
        self.name, self._what, self._waits = name, what, waits
        self.changed = threading.Condition()
        self.capacity, self.closed = 1, False
        self.newest: T | None = None
        self._items: deque[T] = deque()
        self._end: AdaptiveFaceError | None = None
        self._unsaid: AdaptiveFaceError | None = None
        self._overdue: AdaptiveFaceError | None = None

    # ---- for the thread that makes the items -----------------------------------------------------------------------
    def put(self, item: T) -> int:
        """Hand over an item, unless the slot is closed. Returns the number of unread items that it replaced."""
        with self.changed:
            self.wait_for_room()
            replaced = 0
            while len(self._items) >= self.capacity:
                self._items.popleft()
                replaced += 1
            if not self.closed:
                self._items.append(item)
                self.newest = item
            self.resume()
            self.changed.notify_all()
        return replaced

    def wait_for_room(self) -> None:
        """Wait until there is room for an item, if the producer waits. The item may depend on that moment."""
        with self.changed:
            if self._waits:
                self.changed.wait_for(lambda: len(self._items) < self.capacity or self.closed)

    def interrupt(self, error: AdaptiveFaceError, overdue: AdaptiveFaceError | None = None) -> None:
        """Tell readers that there are no items for now.

        Parameters
        ----------
        error : AdaptiveFaceError
            The error that the next call of :meth:`read` raises immediately. If several interruptions follow each other, only
            the first one's is raised in this way.
        overdue : AdaptiveFaceError, optional
            The error that later calls raise after their timeout. The default is ``error``.
        """
        with self.changed:
            if self._overdue is None:
                self._unsaid = error
            self._overdue = overdue or error
            self.changed.notify_all()

    def resume(self) -> None:
        """End an interruption, although there is no new item yet."""
        with self.changed:
            self._unsaid = self._overdue = None

    def end(self, error: AdaptiveFaceError) -> None:
        """Tell readers that there will be no further item. They get the unread items, and then ``error``.

        If the producer waits, the call returns after the last item was read.
        """
        with self.changed:
            if self._waits:
                self.changed.wait_for(lambda: not self._items or self.closed)
            self._end = error
            self.changed.notify_all()

    def drop(self) -> int:
        """Drop the unread items, which are out of date, unless the producer waits. Returns their number."""
        with self.changed:
            dropped = 0 if self._waits else len(self._items)
            if dropped:
                self._items.clear()
        return dropped

    # ---- for readers -----------------------------------------------------------------------------------------------
    def read(self, timeout: float, fresh: Callable[[T], bool] = lambda item: True) -> T:
        """Return the oldest unread item.

        Parameters
        ----------
        timeout : float
            Longest time to wait for an item, s.
        fresh : callable
            Returns whether an item may be handed out. Other items are dropped.

        Returns
        -------
        object
            The item.

        Raises
        ------
        SensorTimeoutError
            There was no item within the time.
        AdaptiveFaceError
            The error of :meth:`end` or :meth:`interrupt`, or a :class:`SensorError` if the slot is closed.
        """
        deadline = time.perf_counter() + timeout
        with self.changed:
            while True:
                if self.closed:
                    raise SensorError(f"{self.name}: the {self._what} is closed")
                while self._items:
                    item = self._items.popleft()
                    self.changed.notify_all()  # a waiting producer can continue
                    if fresh(item):
                        return item
                if self._end is not None:
                    raise self._end
                if self._unsaid is not None:
                    error, self._unsaid = self._unsaid, None
                    raise error
                left = deadline - time.perf_counter()
                if left <= 0:
                    raise self._overdue or SensorTimeoutError(f"{self.name}: no new frame within {timeout:g} s")
                self.changed.wait(left)

    def convert(self, change: Callable[[T], T]) -> None:
        """Replace every unread item by ``change(item)``."""
        with self.changed:
            self._items = deque(map(change, self._items))

    def close(self) -> None:
        """Drop the unread items, and end every wait. Calling it again does nothing."""
        with self.changed:
            self.closed = True
            self._items.clear()
            self.changed.notify_all()


class Worker:
    """A daemon thread that runs a function once, and hands over its exceptions as errors of the package.

    Parameters
    ----------
    name : str
        Name of the thread.
    body : callable
        The function. It returns or raises an exception after its owner was closed.
    failed : callable
        Called on the thread with the error if ``body`` has raised an exception.
    wrap : callable
        Turns an exception of another library into an error of the package, as :func:`packaged` does.
    done : callable
        Called on the thread at the end, in any case.
    """

    def __init__(
        self,
        name: str,
        body: Callable[[], None],
        failed: Callable[[AdaptiveFaceError], None],
        wrap: Callable[[Exception], AdaptiveFaceError],
        done: Callable[[], None] = lambda: None,
    ) -> None:
        self._body, self._failed, self._wrap, self._done = body, failed, wrap, done
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Run the body."""
        self._thread.start()

    @property
    def alive(self) -> bool:
        """Whether the body still runs."""
        return self._thread.is_alive()

    def join(self, timeout: float | None) -> bool:
        """Wait until the body ends.

        Parameters
        ----------
        timeout : float or None
            Longest time to wait, s. There is no limit if it is None.

        Returns
        -------
        bool
            Whether the call waited. It returns False immediately on the thread itself, which cannot wait for its own end.
        """
        if threading.current_thread() is self._thread:
            return False
        self._thread.join(timeout)
        return True

    def _run(self) -> None:
        try:
            self._body()
        except Exception as error:  # a library may raise anything
            self._failed(self._wrap(error))
        finally:
            self._done()


def packaged(error: Exception, what: str, kind: type[AdaptiveFaceError]) -> AdaptiveFaceError:
    """Return an exception as an error of the package.

    Parameters
    ----------
    error : Exception
        The exception.
    what : str
        What failed, for the message.
    kind : type
        The class of the new error.

    Returns
    -------
    AdaptiveFaceError
        ``error`` itself if it is an error of the package. Otherwise, it is the :func:`failure` that it causes.
    """
    return error if isinstance(error, AdaptiveFaceError) else failure(error, what, kind)


def failure(error: Exception, what: str, kind: type[AdaptiveFaceError]) -> AdaptiveFaceError:
    """Return an error of class ``kind`` that states ``what`` failed, with ``error`` as the reason."""
    made = kind(f"{what} ({str(error) or type(error).__name__})")
    made.__cause__ = error
    return made
