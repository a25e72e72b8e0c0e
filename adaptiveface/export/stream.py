"""Stream a performance over UDP while it is tracked: VMC and OSC messages (the extra ``osc``), Live Link Face."""

from __future__ import annotations

import socket
import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import AdaptiveFaceError, MissingExtraError, ParameterError
from ..geometry.frame import RgbdFrame
from ..insides.gaze import GazeTrack
from ..livelink.convention import eyes_of_gaze, with_look
from ..livelink.packet import LiveLinkFrame, encode
from ..model.actor import Actor
from ..parameters import BlendshapeParameters
from ..retargeting.arkit import arkit_weights
from ..retargeting.arkit_resolve import ArkitResolve
from ..retargeting.smoothing import Smoothing
from ..tracking.types import TrackedFrame
from .animation import METRES, view_motion
from .messages import FaceState, Message, VmcAvatar, osc_messages, vmc_messages

LOOPBACK, VMC_PORT, OSC_PORT = "127.0.0.1", 39539, 9000


@dataclass(frozen=True)
class Address:
    """Where messages go."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str, default_port: int) -> Address:
        """Read ``HOST:PORT``, ``HOST``, ``PORT`` or an empty text. Without a host, it is the loopback address.

        Raises :class:`ParameterError` for anything else.
        """
        text = text.strip()
        host, colon, port = text.rpartition(":") if not text.startswith("[") else _bracketed(text)
        if not colon:
            host, port = ("", text) if text.isdecimal() or not text else (text, "")
        if port and not (port.isascii() and port.isdecimal() and 1 <= int(port[:6]) <= 65535 and len(port) < 6):
            raise ParameterError(f"'{text}': HOST:PORT with a port from 1 to 65535 is expected")
        return cls(host or LOOPBACK, int(port) if port else default_port)


def _bracketed(text: str) -> tuple[str, str, str]:
    host, _, port = text[1:].partition("]")
    return host, ":" if port.startswith(":") else "", port[1:]


class Streamer:
    """Sends every tracked frame to receivers: the coefficients that the tracker re-solved from v4, and the head's motion.

    ``actor`` is the tracked rig, of which the first ``count`` expressions are tracked. ``smoothing`` filters the curves.
    With ``halves``, the coefficients are those of ARKit's shapes with their left and right halves, and not those of the tracked
    expressions (:class:`~adaptiveface.retargeting.arkit_resolve.ArkitResolve`, with ``parameters`` or the defaults). The
    :class:`Sender` decides where the frames go, and in which form.
    """

    def __init__(
        self,
        actor: Actor,
        count: int | None = None,
        vmc: Address | None = None,
        osc: Address | None = None,
        smoothing: Smoothing | None = None,
        livelink: Address | None = None,
        avatar: VmcAvatar | None = None,
        parameters: BlendshapeParameters | None = None,
        halves: bool = False,
    ) -> None:
        self._weights = arkit_weights(actor.expression_names[:count])
        self._halves = ArkitResolve(actor, parameters or BlendshapeParameters()) if halves else None
        self.unknown = () if halves else self._weights.unknown
        self._smoothing = smoothing
        self._state: Any = None
        self._before: float | None = None
        self._start: np.ndarray | None = None
        self._solved: np.ndarray | None = None
        self._sender = Sender(vmc, osc, livelink, avatar)
        self._gaze = GazeTrack(actor, keep=False)

    @property
    def sent(self) -> int:
        """Frames sent so far."""
        return self._sender.sent

    def send(self, frame: TrackedFrame, source_frame: RgbdFrame | None = None) -> None:
        """Send one frame. For a lost face, only the loss is sent. The eyes follow the irises in ``source_frame``.

        Raises :class:`AdaptiveFaceError` (no route).
        """
        state = FaceState(float(frame.timestamp), False)
        if frame.tracked:
            pose = view_motion(frame.head_pose[None])[0]
            self._start = pose[:3, 3].copy() if self._start is None else self._start
            place = METRES * (pose[:3, 3] - self._start)
            curves, eyes = self._looking(self._curves(frame), frame, source_frame)
            state = FaceState(float(frame.timestamp), True, curves, pose[:3, :3], place, eyes)
        self._sender.send(state)

    def _looking(self, curves: np.ndarray, frame: TrackedFrame, source: RgbdFrame | None):
        """Curves (52,) whose gaze follows the irises, and the angles (6,) of the eyes, or None before any iris was seen."""
        gaze = self._gaze.see(frame, source)
        if not self._gaze.begun:
            return curves, None
        eyes = eyes_of_gaze(gaze)
        return with_look(curves, eyes), eyes

    def _curves(self, frame: TrackedFrame) -> np.ndarray:
        if self._halves is not None:
            curves = self._solved = self._halves(frame.v4, self._solved)
        else:
            curves = self._weights.curves(frame.coefficients[None])[0]
        if self._smoothing is not None:
            dt = 1 / 30 if self._before is None else frame.timestamp - self._before
            curves, self._state = self._smoothing.step(curves, dt, self._state)
            self._before = frame.timestamp
        return np.clip(curves, 0, 1)


class Sender:
    """Sends faces over UDP: VMC and OSC messages (:mod:`adaptiveface.export.messages`), Live Link Face's datagrams."""

    def __init__(
        self,
        vmc: Address | None = None,
        osc: Address | None = None,
        livelink: Address | None = None,
        avatar: VmcAvatar | None = None,
    ) -> None:
        self._avatar = avatar
        self._vmc, self._osc = _client(vmc), _client(osc)
        self._livelink = None if livelink is None else _Datagrams(livelink)
        self.sent = 0

    def send(self, state: FaceState) -> None:
        """Send one face to all receivers. Raises :class:`AdaptiveFaceError` if one cannot be reached."""
        try:
            if self._vmc is not None:
                _send(self._vmc, vmc_messages(state, self._avatar))
            if self._osc is not None:
                _send(self._osc, osc_messages(state))
            if self._livelink is not None:
                frame = LiveLinkFrame(state.time, state.tracked, state.curves, state.head_angles, state.eye_angles)
                self._livelink.send(encode(frame))
        except OSError as error:
            raise AdaptiveFaceError(f"cannot send the stream: {error}") from None
        self.sent += 1


class _Datagrams:
    """A UDP socket with a destination."""

    def __init__(self, to: Address) -> None:
        self._to = to.host, to.port
        self._socket = socket.socket(socket.AF_INET6 if ":" in to.host else socket.AF_INET, socket.SOCK_DGRAM)

    def send(self, content: bytes) -> None:
        """Send one datagram. Raises OSError."""
        self._socket.sendto(content, self._to)


def check_streaming() -> None:
    """Raise :class:`MissingExtraError` if python-osc is not installed."""
    try:
        import pythonosc  # noqa: F401
    except ImportError:
        raise MissingExtraError("streaming needs python-osc: python -m pip install 'adaptiveface[osc]'") from None


def _client(address: Address | None):
    if address is None:
        return None
    check_streaming()
    from pythonosc.udp_client import SimpleUDPClient

    try:
        return SimpleUDPClient(address.host, address.port)
    except OSError as error:
        raise AdaptiveFaceError(f"{address.host}:{address.port}: {error}") from None


#: Messages in one datagram, which then stays below the 1,472 bytes that networks carry unfragmented.
_PER_BUNDLE = 20


def _send(client, messages: list[Message]) -> None:
    from pythonosc.osc_bundle_builder import IMMEDIATELY, OscBundleBuilder
    from pythonosc.osc_message_builder import OscMessageBuilder

    for start in range(0, len(messages), _PER_BUNDLE):
        bundle = OscBundleBuilder(IMMEDIATELY)
        for name, values in messages[start : start + _PER_BUNDLE]:
            message = OscMessageBuilder(address=name)
            for value in values:
                message.add_arg(value)
            bundle.add_content(message.build())
        client.send(bundle.build())


class Pace:
    """Plays a recording at the speed at which it was taken. It never delays live sources."""

    def __init__(self) -> None:
        self._began: tuple[float, float] | None = None

    def wait(self, timestamp: float) -> None:
        """Sleep until ``timestamp`` (s) is due. Late frames are sent at once."""
        now = time.monotonic()
        if self._began is None:
            self._began = now, timestamp
        due = self._began[0] + timestamp - self._began[1]
        if 0 < due - now < 10:
            time.sleep(due - now)
