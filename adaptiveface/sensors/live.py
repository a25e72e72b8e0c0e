"""Read a live sensor: one thread owns the vendor's library, and readers get the newest frame, never a stale one.

A :class:`~adaptiveface.sensors.driver.Driver` holds what differs between sensors. :class:`LiveSensor` runs it in a separate
thread, checks what it delivers, reopens it after it was unplugged, and hands the frames over.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator

from ..errors import (
    AdaptiveFaceError,
    EndOfRecording,
    SensorDisconnectedError,
    SensorError,
    SensorTimeoutError,
)
from ..runtime.closing import Closing
from .driver import Driver, LiveFrame, RawFrame, live_frame, usable
from .orientation import mirrored
from .worker import POLL_SECONDS, Latest, Worker, packaged

#: Longest time that :meth:`LiveSensor.close` waits for the vendor's library, s. After that, it ends in the background.
CLOSE_SECONDS = 0.4
#: Pause between two attempts to open a sensor again, s.
RECONNECT_SECONDS = 0.25
#: Longest time that :meth:`LiveSensor.read` waits by default, s: for a camera, and for a file on a busy machine.
LIVE_SECONDS, FILE_SECONDS = 1.0, 60.0
#: If a device's frame number falls back by more than this, its counter has started over; otherwise the frame is late.
RESTART_GAP = 100


class LiveSensor(Closing):
    """The frames of a sensor.

    It is a context manager, and an iterator over the frames until the recording ends or :meth:`close` is called.

    Parameters
    ----------
    make_driver : callable
        Returns a new driver. It is called once more for every reconnection.
    max_age : float
        Age beyond which a frame is dropped instead of being handed out, s.
    reconnect : bool
        Whether to open the sensor again after it was unplugged, if its driver can do so.
    open_timeout : float, optional
        Longest time to wait until the driver is open, s. By default, it is the driver's ``open_timeout``.

    Raises
    ------
    AdaptiveFaceError
        The driver could not be opened.
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
        self.superseded = 0  #: how many of the dropped frames a newer one replaced, or were too old before they were read
        self.broken = self._driver.broken  #: a recording's: reason of each
        self.mirrored = False  #: every frame is flipped left to right
        self._listeners: tuple[Callable[[LiveFrame], None], ...] = ()
        self._frames: Latest[LiveFrame] = Latest(self.name, "sensor", waits=not self.live)
        self._changed = self._frames.changed
        self._error: AdaptiveFaceError | None = None  # with which it could not be opened
        self._connected = self._opened = False
        self._handed_out = 0
        self._last: int | None = None
        self._worker = Worker(f"sensor {self.name}", self._run, self._frames.end, self._translate)
        self._worker.start()
        try:
            with self._changed:
                self._changed.wait_for(lambda: self._opened or self._error, open_timeout)
                opened, error = self._opened, self._error
        except BaseException:  # after Ctrl-C or an interrupted cell, nobody else could close it
            self.close()
            raise
        if not opened:
            self.close()
            raise error or SensorTimeoutError(f"{self.name}: did not start within {open_timeout:g} s; plug it in again")

    def read(self, timeout: float | None = None) -> LiveFrame:
        """Return the newest frame that was not handed out yet.

        Parameters
        ----------
        timeout : float, optional
            Longest time to wait for a frame, s. By default, it is a second for a sensor, and a minute for a recording, whose
            next frame is certain to come.

        Returns
        -------
        LiveFrame
            The frame.

        Raises
        ------
        SensorDisconnectedError
            The sensor was unplugged. The first call raises it immediately, and later calls raise it after ``timeout``.
        SensorTimeoutError
            There was no frame within the time.
        EndOfRecording
            The recording is over.
        SensorError
            The sensor has failed.
        """
        if timeout is None:
            timeout = LIVE_SECONDS if self.live else FILE_SECONDS
        with self._changed:
            frame = self._frames.read(timeout, self._fresh)
            values = {**vars(frame), "index": self._handed_out, "dropped": self.dropped}
            self._handed_out += 1
        frame = LiveFrame(**values)
        if not self.live:
            self._tell(frame)
        return frame

    def buffer(self, frames: int) -> None:
        """Keep up to ``frames`` unread frames of any age, for recording, which needs every frame, also a late one."""
        with self._changed:
            self._frames.capacity, self.max_age = frames, math.inf

    def mirror(self) -> None:
        """Flip every frame from now on, including the unread ones."""
        with self._changed:
            self._frames.convert(mirrored)
            self.mirrored = True

    @property
    def lost_by_device(self) -> int:
        """How many of the dropped frames the device never delivered."""
        return self.dropped - self.superseded

    def add_listener(self, listener: Callable[[LiveFrame], None]) -> None:
        """Call a function with every frame.

        Parameters
        ----------
        listener : callable
            A function of one :class:`LiveFrame`. It is called when a frame arrives from a live sensor, or when a recording
            hands a frame out. It must be quick, and it must not raise an exception.
        """
        with self._changed:
            self._listeners += (listener,)

    def remove_listener(self, listener: Callable[[LiveFrame], None]) -> None:
        """Stop calling a function that :meth:`add_listener` has added."""
        with self._changed:
            self._listeners = tuple(known for known in self._listeners if known != listener)

    def close(self) -> None:
        """Stop the thread and release the sensor within half a second. Calling it again does nothing."""
        self._frames.close()
        self._worker.join(CLOSE_SECONDS)

    def __iter__(self) -> Iterator[LiveFrame]:
        while not self._frames.closed:
            try:
                yield self.read()
            except EndOfRecording:
                return

    def _tell(self, frame: LiveFrame) -> None:
        for listener in self._listeners:
            listener(frame)

    def _fresh(self, frame: LiveFrame) -> bool:
        """Return whether a frame may be handed out. A frame that is too old is counted as dropped."""
        late = self.live and frame.age > self.max_age
        self.dropped += late
        self.superseded += late
        return not late

    # ---- the sensor's thread ---------------------------------------------------------------------------------------
    def _run(self) -> None:
        driver: Driver | None = self._driver
        while not self._frames.closed:
            try:
                driver = driver or self._make_driver()
                driver.open()
                self.fps, self.depth_scale = driver.fps, driver.depth_scale
                self._last = None  # a sensor that is back counts from the start
                self._connect()
                self._pump(driver)
            except Exception as error:  # a vendor's library may raise anything
                if not self._opened or not self.reconnect or isinstance(error, EndOfRecording):
                    self._finish(self._translate(error))
                    return
                if self._connected:
                    self._disconnect(self._translate(error))
            finally:
                _close_quietly(driver)
                driver = None
            with self._changed:
                self._changed.wait_for(lambda: self._frames.closed, RECONNECT_SECONDS)

    def _pump(self, driver: Driver) -> None:
        while not self._frames.closed:
            raw = driver.grab(POLL_SECONDS)
            if raw is not None:
                self._publish(raw)

    def _publish(self, raw: RawFrame) -> None:
        behind = None if self._last is None else self._last - raw.sequence
        if (behind is not None and 0 <= behind <= RESTART_GAP) or not usable(raw):
            self.discarded += 1  # a late frame was already counted as dropped when its number was missing
            return
        lost = max(-behind - 1, 0) if behind is not None and behind < 0 else 0
        self._last = raw.sequence
        flipped = self.mirrored
        frame = mirrored(live_frame(raw)) if flipped else live_frame(raw)
        if self.live:
            self._tell(frame)
        with self._changed:
            self._frames.wait_for_room()
            if self.mirrored and not flipped:  # since it arrived
                frame = mirrored(frame)
            replaced = self._frames.put(frame)
            self.superseded += replaced
            self.dropped += lost + replaced

    def _connect(self) -> None:
        with self._changed:
            self._frames.resume()
            self._connected = self._opened = True
            self._changed.notify_all()

    def _disconnect(self, error: AdaptiveFaceError) -> None:
        """Tell readers that the sensor is disconnected and may come back."""
        with self._changed:
            self._drop_unread()
            self._connected = False
            self._frames.interrupt(error, SensorDisconnectedError(f"{self.name}: disconnected; waiting for it to come back"))

    def _finish(self, error: AdaptiveFaceError) -> None:
        """Tell readers that no further frame will come."""
        with self._changed:
            self._drop_unread()
            self._frames.end(error)
            self._connected, self._error = False, error
            self._changed.notify_all()

    def _drop_unread(self) -> None:
        dropped = self._frames.drop()
        self.superseded += dropped
        self.dropped += dropped

    def _translate(self, error: Exception) -> AdaptiveFaceError:
        kind = SensorDisconnectedError if self._connected else SensorError
        return packaged(error, f"{self.name}: the driver failed", kind)


def _close_quietly(driver: Driver | None) -> None:
    """Close a driver and ignore errors: a library whose sensor is gone often fails again when it is closed."""
    try:
        if driver is not None:
            driver.close()
    except Exception:  # noqa: BLE001
        pass


__all__ = ["Driver", "LiveFrame", "LiveSensor", "RawFrame"]
