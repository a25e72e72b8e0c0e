"""What every live thread needs: a body that runs until it is told to stop, and a slot for its newest item."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from ..errors import AdaptiveFaceError, SensorError, SensorTimeoutError

T = TypeVar("T")

#: Longest a thread waits for an item, s: closing, messages and changes have to stay responsive.
POLL_SECONDS = 0.1


class Latest(Generic[T]):
    """Hands items from the thread that makes them to the one that reads them, the newest rather than all of them.

    A producer that ``waits`` (a recording) hands over every item, and is held up until there is room. Otherwise an item
    that finds no room takes the place of the oldest one, so that a slow reader never falls behind. ``changed`` guards the
    slot, and whatever else its owner keeps in step with it.
    """

    def __init__(self, name: str, what: str, waits: bool = False) -> None:
        self.name, self._what, self._waits = name, what, waits
        self.changed = threading.Condition()
        self.capacity, self.closed = 1, False
        self.newest: T | None = None  #: the last item that was put, read or not
        self._items: deque[T] = deque()
        self._end: AdaptiveFaceError | None = None
        self._unsaid: AdaptiveFaceError | None = None
        self._overdue: AdaptiveFaceError | None = None

    # ---- for the thread that makes the items -----------------------------------------------------------------------
    def put(self, item: T) -> int:
        """Hand over an item; returns how many unread ones it replaced. Does nothing once the slot is closed."""
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
        """Where the producer waits, return once an item finds room; what is put may depend on that moment."""
        with self.changed:
            if self._waits:
                self.changed.wait_for(lambda: len(self._items) < self.capacity or self.closed)

    def interrupt(self, error: AdaptiveFaceError, overdue: AdaptiveFaceError | None = None) -> None:
        """No items for now: readers get ``error`` at once, and ``overdue`` (or ``error``) whenever their time is over.

        Only the first of several interruptions in a row is told at once.
        """
        with self.changed:
            if self._overdue is None:
                self._unsaid = error
            self._overdue = overdue or error
            self.changed.notify_all()

    def resume(self) -> None:
        """The interruption is over, although there is no new item yet."""
        with self.changed:
            self._unsaid = self._overdue = None

    def end(self, error: AdaptiveFaceError) -> None:
        """No further item: readers get what is unread, and then ``error``.

        A producer that waits is held up until its last item was read.
        """
        with self.changed:
            if self._waits:
                self.changed.wait_for(lambda: not self._items or self.closed)
            self._end = error
            self.changed.notify_all()

    def drop(self) -> int:
        """Drop what is unread, where the producer does not wait: it is not what there is now. Returns how many."""
        with self.changed:
            dropped = 0 if self._waits else len(self._items)
            if dropped:
                self._items.clear()
        return dropped

    # ---- for readers -----------------------------------------------------------------------------------------------
    def read(self, timeout: float, fresh: Callable[[T], bool] = lambda item: True) -> T:
        """The oldest unread item that is ``fresh`` enough, waiting up to ``timeout`` s for it; others are dropped.

        Raises the error of :meth:`end` or :meth:`interrupt`, and :class:`SensorTimeoutError`.
        """
        deadline = time.perf_counter() + timeout
        with self.changed:
            while True:
                if self.closed:
                    raise SensorError(f"{self.name}: the {self._what} is closed")
                while self._items:
                    item = self._items.popleft()
                    self.changed.notify_all()  # a producer that waits goes on
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
        """Drop what is unread, and end every wait; calling it again does nothing."""
        with self.changed:
            self.closed = True
            self._items.clear()
            self.changed.notify_all()


class Worker:
    """A daemon thread that runs ``body`` once; whatever that raises reaches ``failed`` as an error of the package.

    Parameters
    ----------
    name
        Of the thread.
    body
        Returns, or raises, when its owner says that it is closed.
    failed
        Called on the thread with what ``body`` raised.
    wrap
        Turns an exception of another library into one of the package; see :func:`packaged`.
    done
        Called on the thread in the end, in any case.
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
        """Wait up to ``timeout`` s for the body to end; False at once on the thread itself, which cannot wait."""
        if threading.current_thread() is self._thread:
            return False
        self._thread.join(timeout)
        return True

    def _run(self) -> None:
        try:
            self._body()
        except Exception as error:  # whatever a library raises ends here
            self._failed(self._wrap(error))
        finally:
            self._done()


def packaged(error: Exception, what: str, kind: type[AdaptiveFaceError]) -> AdaptiveFaceError:
    """``error`` itself where it is one of the package, else the :func:`failure` that it causes."""
    return error if isinstance(error, AdaptiveFaceError) else failure(error, what, kind)


def failure(error: Exception, what: str, kind: type[AdaptiveFaceError]) -> AdaptiveFaceError:
    """An error of the package that says ``what`` failed, and ``error`` as the reason."""
    made = kind(f"{what} ({str(error) or type(error).__name__})")
    made.__cause__ = error
    return made
