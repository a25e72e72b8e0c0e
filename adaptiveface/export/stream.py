"""Streaming a performance while it is tracked: VMC and plain OSC messages over UDP, the extra ``osc``."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from ..actor import Actor
from ..errors import AdaptiveFaceError, MissingExtraError, ParameterError
from ..retargeting.arkit import ARKIT_NAMES, arkit_weights
from ..retargeting.resolve import SparseResolve
from ..retargeting.smoothing import Smoothing
from ..tracking.types import TrackedFrame
from .animation import METRES, view_motion
from .gltf import quaternions

LOOPBACK, VMC_PORT, OSC_PORT = "127.0.0.1", 39539, 9000


@dataclass(frozen=True)
class Address:
    """Where messages go."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str, default_port: int) -> Address:
        """``HOST:PORT``, ``HOST``, ``PORT`` or nothing; the loopback address unless a host is named."""
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
    """Sends every tracked frame to VMC and OSC receivers: the coefficients re-solved from v4, and the head's motion.

    actor: the tracked rig, of which the first ``count`` expressions are tracked; ``smoothing`` filters the curves.

    VMC (https://protocol.vmc.info): ``/VMC/Ext/OK``, ``/VMC/Ext/T``, ``/VMC/Ext/Bone/Pos Head``, one
    ``/VMC/Ext/Blend/Val`` for each ARKit shape ("perfect sync" names, capital first letter), ``/VMC/Ext/Blend/Apply``;
    Unity's axes. OSC: ``/adaptiveface/tracked`` 0 or 1, ``/adaptiveface/head`` (metres and quaternion x y z w in the
    view frame: x right, y up, z to the viewer), ``/adaptiveface/blendshape`` name and value.
    """

    def __init__(
        self, actor: Actor, count: int | None = None, vmc: Address | None = None, osc: Address | None = None,
        smoothing: Smoothing | None = None,
    ) -> None:
        names = actor.expression_names[:count]
        self._weights, self._resolve = arkit_weights(names), SparseResolve(actor, names)
        self.unknown = self._weights.unknown
        self._smoothing, self._state, self._before = smoothing, None, None
        self._start: np.ndarray | None = None
        self._vmc, self._osc = _client(vmc), _client(osc)
        self.sent = 0

    def send(self, frame: TrackedFrame, _source_frame=None) -> None:
        """Send one frame; a lost face sends only that it is lost. Raises :class:`AdaptiveFaceError` (no route)."""
        messages_vmc: list[tuple[str, list]] = [("/VMC/Ext/OK", [int(frame.tracked)])]
        messages_osc: list[tuple[str, list]] = [("/adaptiveface/tracked", [int(frame.tracked)])]
        if frame.tracked:
            curves = self._curves(frame)
            pose = view_motion(frame.rigid[None])[0]
            self._start = pose[:3, 3].copy() if self._start is None else self._start
            place = METRES * (pose[:3, 3] - self._start)
            x, y, z, w = (float(v) for v in quaternions(pose[None, :3, :3])[0])
            px, py, pz = (float(v) for v in place)
            messages_vmc.append(("/VMC/Ext/T", [float(frame.timestamp)]))
            # Unity's axes are left-handed: x is mirrored, and with it the turns about y and z.
            messages_vmc.append(("/VMC/Ext/Bone/Pos", ["Head", -px, py, pz, x, -y, -z, w]))
            messages_osc.append(("/adaptiveface/head", [px, py, pz, x, y, z, w]))
            for name, value in zip(ARKIT_NAMES, curves, strict=True):
                messages_vmc.append(("/VMC/Ext/Blend/Val", [name[0].upper() + name[1:], float(value)]))
                messages_osc.append(("/adaptiveface/blendshape", [name, float(value)]))
            messages_vmc.append(("/VMC/Ext/Blend/Apply", []))
        try:
            _send(self._vmc, messages_vmc)
            _send(self._osc, messages_osc)
        except OSError as error:
            raise AdaptiveFaceError(f"cannot send the stream: {error}") from None
        self.sent += 1

    def _curves(self, frame: TrackedFrame) -> np.ndarray:
        coefficients = self._resolve(frame.v4, frame.coefficients)
        curves = self._weights.curves(coefficients[None])[0]
        if self._smoothing is not None:
            dt = 1 / 30 if self._before is None else frame.timestamp - self._before
            curves, self._state = self._smoothing.step(curves, dt, self._state)
            self._before = frame.timestamp
        return np.clip(curves, 0, 1)


def check_streaming() -> None:
    """Raise :class:`MissingExtraError` where python-osc is not installed."""
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


#: Messages of one datagram: below the 1,472 bytes that cross a network whole.
_PER_BUNDLE = 20


def _send(client, messages: list[tuple[str, list]]) -> None:
    if client is None:
        return
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
    """Holds a recording back to the speed at which it was taken; live sources are never held back."""

    def __init__(self) -> None:
        self._began: tuple[float, float] | None = None

    def wait(self, timestamp: float) -> None:
        """Sleep until ``timestamp`` (s) is due; late frames go out at once."""
        now = time.monotonic()
        if self._began is None:
            self._began = now, timestamp
        due = self._began[0] + timestamp - self._began[1]
        if 0 < due - now < 10:
            time.sleep(due - now)
