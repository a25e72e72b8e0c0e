"""A live sensor: one thread owns the vendor's library, the reader gets the newest frame and never a stale one.

A :class:`~adaptiveface.sensors.driver.Driver` is the part that differs between sensors. :class:`LiveSensor` runs it in a
thread of its own, checks what it delivers, opens it again after it was unplugged, and hands the frames over.
"""

from __future__ import annotations

import math
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator

from ..errors import (
    AdaptiveFaceError,
    EndOfRecording,
    SensorDisconnectedError,
    SensorError,
    SensorTimeoutError,
)
from .driver import POLL_SECONDS, Driver, LiveFrame, RawFrame, live_frame, usable
from .orientation import mirrored

#: Longest :meth:`LiveSensor.close` waits for the vendor's library, s. What takes longer ends in the background.
CLOSE_SECONDS = 0.4
#: Pause between two attempts to open a sensor again, s.
RECONNECT_SECONDS = 0.25
#: Longest :meth:`LiveSensor.read` waits unless told otherwise, s: for a camera, and for a file on a machine that is busy.
LIVE_SECONDS, FILE_SECONDS = 1.0, 60.0
#: A device's frame number that falls back by more than this is a counter that started over, not a late frame.
RESTART_GAP = 100


class LiveSensor:
    """Frames of one sensor; a context manager, and an iterator until the end of the recording or :meth:`close`.

    ``make_driver`` returns a fresh driver, also for each reconnection; ``max_age`` s: an older frame is dropped rather
    than handed out; ``reconnect``: open the sensor again after it was unplugged, where it can be;
    ``open_timeout`` s, None: the driver's own. Raises the error
    with which the driver could not be opened.
    """

    def __init__(
        self,
        make_driver: Callable[[], Driver],
        max_age: float = 0.5,
        reconnect: bool = True,
        open_timeout: float | None = None,
    ) -> None:
        self._make_driver, self.max_age = make_driver, max_age
        self._driver = make_driver()
        self.reconnect = reconnect and self._driver.reopens
        open_timeout = self._driver.open_timeout if open_timeout is None else open_timeout
        self.name, self.live = self._driver.name, self._driver.live
        self.fps, self.depth_scale = self._driver.fps, self._driver.depth_scale
        self.has_features = self._driver.has_features
        self.colour_only = self._driver.colour_only  #: there is no depth: a degraded mode
        self.dropped, self.discarded = 0, 0  #: never handed out; unusable, repeated or out of order
        self.superseded = 0  #: of the dropped ones: replaced by a newer frame or too old before anybody read them
        self.broken = self._driver.broken  #: a recording's: reason of each
        self.mirrored = False  #: every frame is flipped left to right
        self._listeners: tuple[Callable[[LiveFrame], None], ...] = ()
        self._changed = threading.Condition()
        self._unread: deque[LiveFrame] = deque()
        self._capacity = 1
        self._error: AdaptiveFaceError | None = None
        self._connected = self._opened = self._closed = False
        self._handed_out = 0
        self._last: int | None = None
        self._thread = threading.Thread(target=self._run, name=f"sensor {self.name}", daemon=True)
        self._thread.start()
        try:
            with self._changed:
                self._changed.wait_for(lambda: self._opened or self._error, open_timeout)
                opened, error = self._opened, self._error
        except BaseException:  # Ctrl-C, or an interrupted cell: nobody else could close it
            self.close()
            raise
        if not opened:
            self.close()
            raise error or SensorTimeoutError(f"{self.name}: did not start within {open_timeout:g} s; plug it in again")

    def read(self, timeout: float | None = None) -> LiveFrame:
        """The newest frame that was not handed out yet, waiting up to ``timeout`` s for it.

        By default a second for a sensor, and a minute for a recording, whose next frame surely comes. Raises
        :class:`SensorDisconnectedError` (once at once, then whenever ``timeout`` passes without a sensor),
        :class:`SensorTimeoutError`, :class:`EndOfRecording`, or what the sensor failed with.
        """
        if timeout is None:
            timeout = LIVE_SECONDS if self.live else FILE_SECONDS
        deadline = time.perf_counter() + timeout
        with self._changed:
            while True:
                if self._closed:
                    raise SensorError(f"{self.name}: the sensor is closed")
                frame = self._take()
                if frame is not None:
                    break
                if self._error is not None:
                    error = self._error
                    if isinstance(error, SensorDisconnectedError) and self.reconnect:
                        self._error = None  # said once; from now on there is hope until the time is over
                    raise error
                left = deadline - time.perf_counter()
                if left <= 0:
                    raise self._overdue(timeout)
                self._changed.wait(left)
        if not self.live:
            self._tell(frame)
        return frame

    def buffer(self, frames: int) -> None:
        """Keep up to ``frames`` unread frames, however old: for recording, where each one counts and none is late."""
        with self._changed:
            self._capacity, self.max_age = frames, math.inf

    def mirror(self) -> None:
        """Flip every frame, also those that are not read yet."""
        with self._changed:
            self._unread = deque(mirrored(frame) for frame in self._unread)
            self.mirrored = True

    @property
    def lost_by_device(self) -> int:
        """Of the dropped frames, those that the device never delivered."""
        return self.dropped - self.superseded

    def add_listener(self, listener: Callable[[LiveFrame], None]) -> None:
        """Call ``listener`` with every frame: of a live sensor as it arrives, of a recording as it is handed out.

        It must be quick and not raise.
        """
        with self._changed:
            self._listeners += (listener,)

    def remove_listener(self, listener: Callable[[LiveFrame], None]) -> None:
        """Stop calling ``listener``."""
        with self._changed:
            self._listeners = tuple(known for known in self._listeners if known != listener)

    def close(self) -> None:
        """Stop the thread and release the sensor, within half a second; calling it again does nothing."""
        with self._changed:
            self._closed = True
            self._unread.clear()
            self._changed.notify_all()
        if threading.current_thread() is not self._thread:
            self._thread.join(CLOSE_SECONDS)

    def __enter__(self) -> LiveSensor:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def __iter__(self) -> Iterator[LiveFrame]:
        while not self._closed:
            try:
                yield self.read()
            except EndOfRecording:
                return

    def _tell(self, frame: LiveFrame) -> None:
        for listener in self._listeners:
            listener(frame)

    def _take(self) -> LiveFrame | None:
        if not self._unread:
            return None
        frame = self._unread.popleft()
        self._changed.notify_all()  # a file goes on reading
        if self.live and frame.age > self.max_age:
            self.dropped += 1
            self.superseded += 1
            return None
        self._handed_out += 1
        values = {**vars(frame), "index": self._handed_out - 1, "dropped": self.dropped}
        return LiveFrame(**values)

    def _overdue(self, timeout: float) -> SensorError:
        if not self._connected:
            return SensorDisconnectedError(f"{self.name}: disconnected; waiting for it to come back")
        return SensorTimeoutError(f"{self.name}: no new frame within {timeout:g} s")

    # ---- the sensor's thread ---------------------------------------------------------------------------------------
    def _run(self) -> None:
        driver: Driver | None = self._driver
        while not self._closed:
            try:
                driver = driver or self._make_driver()
                driver.open()
                self.fps, self.depth_scale = driver.fps, driver.depth_scale
                self._last = None  # a sensor that comes back counts from the start
                self._set(connected=True)
                self._pump(driver)
            except Exception as error:  # whatever a vendor's library raises ends here
                final = not self._opened or not self.reconnect or isinstance(error, EndOfRecording)
                if self._connected or final:
                    self._set(connected=False, error=self._translate(error))
                if final:
                    return
            finally:
                _close_quietly(driver)
                driver = None
            with self._changed:
                self._changed.wait_for(lambda: self._closed, RECONNECT_SECONDS)

    def _pump(self, driver: Driver) -> None:
        while not self._closed:
            raw = driver.grab(POLL_SECONDS)
            if raw is not None:
                self._publish(raw)

    def _publish(self, raw: RawFrame) -> None:
        behind = None if self._last is None else self._last - raw.sequence
        if (behind is not None and 0 <= behind <= RESTART_GAP) or not usable(raw):
            self.discarded += 1  # a late or unusable one was counted as dropped where its number was missing
            return
        lost = max(-behind - 1, 0) if behind is not None and behind < 0 else 0
        self._last = raw.sequence
        flipped = self.mirrored
        frame = mirrored(live_frame(raw)) if flipped else live_frame(raw)
        if self.live:
            self._tell(frame)
        with self._changed:
            if self.mirrored and not flipped:
                frame = mirrored(frame)
            if not self.live:
                self._changed.wait_for(lambda: len(self._unread) < self._capacity or self._closed)
            while len(self._unread) >= self._capacity:
                self._unread.popleft()
                self.superseded += 1
                lost += 1
            self.dropped += lost
            if not self._closed:
                self._unread.append(frame)
            self._changed.notify_all()

    def _set(self, connected: bool, error: AdaptiveFaceError | None = None) -> None:
        with self._changed:
            if not connected and not self.live:
                self._changed.wait_for(lambda: not self._unread or self._closed)
            elif not connected:
                self.superseded += len(self._unread)
                self.dropped += len(self._unread)
                self._unread.clear()  # a frame from before the unplugging is not what the sensor sees now
            self._connected, self._error = connected, error
            self._opened |= connected
            self._changed.notify_all()

    def _translate(self, error: Exception) -> AdaptiveFaceError:
        if isinstance(error, AdaptiveFaceError):
            return error
        reason = str(error) or type(error).__name__
        kind = SensorDisconnectedError if self._connected else SensorError
        translated = kind(f"{self.name}: the driver failed ({reason})")
        translated.__cause__ = error
        return translated


def _close_quietly(driver: Driver | None) -> None:
    """A library whose sensor is gone often fails once more while it is torn down; that is not news."""
    try:
        if driver is not None:
            driver.close()
    except Exception:  # noqa: BLE001
        pass


__all__ = ["Driver", "LiveFrame", "LiveSensor", "RawFrame"]
