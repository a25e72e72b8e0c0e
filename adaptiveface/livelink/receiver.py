"""Receive the frames of one phone from Live Link Face. The socket is on the loopback address unless another one is given."""

from __future__ import annotations

import contextlib
import socket
import time
from collections.abc import Iterator
from dataclasses import replace

from ..errors import ParameterError, SensorError
from .packet import MAX_BYTES, PORT, LiveLinkFrame, decode

LOOPBACK = "127.0.0.1"
NAME = "livelink"


def is_livelink(text: str) -> bool:
    """Return whether a sensor's name has the form ``livelink[:[HOST:]PORT]``."""
    return text.partition(":")[0] == NAME


def parse_address(text: str) -> tuple[str, int]:
    """Return the host and port of ``livelink[:[HOST:]PORT]``.

    Raises
    ------
    ParameterError
        The port is invalid.
    """
    host, _, port = text.removeprefix(NAME).removeprefix(":").rpartition(":")
    if port and not port.isdecimal() and not host:
        host, port = port, ""
    if port and not (port.isascii() and port.isdecimal() and len(port) <= 5 and 1 <= int(port) <= 65535):
        raise ParameterError(f"'{text}': livelink[:PORT] or livelink:HOST:PORT with a port from 1 to 65535 is expected")
    return host.strip("[]") or LOOPBACK, int(port or PORT)


class LiveLinkReceiver:
    """Receives frames over UDP. This is a context manager, and :meth:`frames` yields the frames.

    Attributes
    ----------
    subject : str
        Name of the phone that is followed. This is the first one that sent a face.
    bad : int
        Number of datagrams that are not from Live Link Face.
    reason : str
        The reason why the last of them could not be read.
    others : set of str
        Names of other phones.
    late : int
        Number of frames that arrived after a newer one.
    """

    def __init__(self, host: str = LOOPBACK, port: int = PORT) -> None:
        self.host, self.port = host, port
        self.subject = ""
        self.bad, self.reason, self.late = 0, "", 0
        self.others: set[str] = set()
        self._device: str | None = None
        self._last: float | None = None  # time of the last frame: as passed on, as sent, and on arrival
        self._said, self._arrived = 0.0, 0.0

    def __enter__(self) -> LiveLinkReceiver:
        family = socket.AF_INET6 if ":" in self.host else socket.AF_INET
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        try:
            self._socket.bind((self.host, self.port))
        except OSError as error:
            self._socket.close()
            raise SensorError(f"{self.host}:{self.port}: cannot listen there ({error.strerror or error})") from None
        self.port = self._socket.getsockname()[1]
        return self

    def __exit__(self, *_) -> None:
        self._socket.close()

    def frames(self, timeout: float) -> Iterator[LiveLinkFrame]:
        """Yield the frames that have arrived, in order.

        Parameters
        ----------
        timeout : float
            Longest time to wait for the first frame, s. If none arrives in time, none is yielded.
        """
        self._socket.settimeout(timeout)
        with contextlib.suppress(TimeoutError, BlockingIOError, ConnectionResetError):
            while True:
                data = self._socket.recv(MAX_BYTES + 1)
                self._socket.settimeout(0.0)
                frame = self._accept(data)
                if frame is not None:
                    yield frame

    def _accept(self, data: bytes) -> LiveLinkFrame | None:
        try:
            frame = decode(data)
        except ValueError as error:
            self.bad, self.reason = self.bad + 1, str(error)
            return None
        if self._device is None and frame.tracked:
            self._device, self.subject = frame.device, frame.subject
        if self._device is not None and frame.device != self._device:
            if len(self.others) < 20:
                self.others.add(frame.subject)
            return None
        return self._timed(frame)

    def _timed(self, frame: LiveLinkFrame) -> LiveLinkFrame | None:
        """Return the frame with a rising time, or None if it is late. If the sender's clock stands still, arrival counts."""
        now = time.monotonic()
        if self._last is None:
            self._last, self._said, self._arrived = frame.time, frame.time, now
            return frame
        if 0 < self._said - frame.time < 1.0:
            self.late += 1
            return None
        stands = frame.time == self._said
        self._said = frame.time
        self._last = self._last + max(now - self._arrived, 1e-4) if stands else frame.time
        self._arrived = now
        return replace(frame, time=self._last) if stands else frame
