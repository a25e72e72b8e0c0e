"""Play vendors' recordings in a separate process, because a damaged file can crash or hang the vendor's library.

The child process (:func:`main`) reads the file with the vendor's driver and writes messages to its standard output. A message
is a line of JSON; for a frame, the bytes of depth (float32 mm) and colour follow. A full pipe makes the child wait.
"""

from __future__ import annotations

import faulthandler
import importlib
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np

from .. import errors
from ..errors import AdaptiveFaceError, SensorError
from ..geometry.camera import Camera
from .driver import CameraOrFile, Driver, RawFrame
from .matroska import is_plain_video
from .worker import POLL_SECONDS

#: Suffix -> module and class of the driver (a :class:`CameraOrFile`) that plays such a file, and the library that reads it.
PLAYERS = {
    ".oni": ("openni2", "OpenNI2Driver", "OpenNI2"),
    ".db3": ("realsense", "RealSenseDriver", "RealSense"),
    ".bag": ("realsense", "RealSenseDriver", "RealSense"),
    ".mkv": ("azure", "AzureDriver", "Azure Kinect"),
}
#: Longest time that a library may take to open a file, or to read a frame, s. Intact files need less than a tenth of it.
PATIENCE_SECONDS = 20.0
#: Longest line that the child writes, bytes, and longest side of an image, px.
LONGEST_LINE, LONGEST_SIDE = 4096, 8192
#: The kinds of messages, and what each one holds.
_MESSAGES = {
    "open": {"fps", "depth_scale", "camera"},
    "frame": {"colour", "sequence", "timestamp"},
    "none": set(),
    "error": {"error", "text"},
}
#: Only this process handles Ctrl-C: the child gets a group of its own, on Windows by this flag.
_NEW_GROUP = 0
if sys.platform == "win32":
    _NEW_GROUP = subprocess.CREATE_NEW_PROCESS_GROUP
_ERRORS = {name: kind for name, kind in vars(errors).items() if isinstance(kind, type)}


def plays(path: Path) -> bool:
    """Return whether one of the ``PLAYERS`` reads a file. An .mkv is played unless it is a plain video."""
    suffix = path.suffix.lower()
    return suffix in PLAYERS and path.is_file() and not (suffix == ".mkv" and is_plain_video(path))


class FilePlayer(Driver):
    """Plays a recording with the driver for its suffix, frame by frame as it is read.

    Parameters
    ----------
    path : Path
        The recording.
    """

    live, reopens = False, False

    def __init__(self, path: Path) -> None:
        self.path, self.name = Path(path), Path(path).stem
        self.fps, self.depth_scale = 30.0, 1000.0  # until it is open
        self._command = [sys.executable, "-m", __name__, str(self.path.absolute())]
        self._child: subprocess.Popen[bytes] | None = None
        self._frames = 0

    def open(self) -> None:
        """Start the child and wait until it has opened the file. The driver's errors are raised in this process."""
        self._child = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=_environment(),
            creationflags=_NEW_GROUP,
            start_new_session=True,
        )
        opened = self._message()
        self.fps, self.depth_scale = opened["fps"], opened["depth_scale"]
        self.camera = Camera(**opened["camera"])

    def grab(self, timeout: float) -> RawFrame | None:
        """Return the next pair of depth and colour, or None while the file delivers none."""
        message = self._message()
        if message["kind"] == "none":
            return None
        height, width = self.camera.height, self.camera.width
        depth = np.frombuffer(self._bytes(4 * height * width), np.float32).reshape(height, width)
        colour = None
        if message["colour"]:
            colour = np.frombuffer(self._bytes(3 * height * width), np.uint8).reshape(height, width, 3)
        self._frames += 1
        return RawFrame(depth, self.camera, colour, message["sequence"], message["timestamp"])

    def close(self) -> None:
        """End the child."""
        child, self._child = self._child, None
        if child is not None:
            child.kill()
            for pipe in filter(None, (child.stdin, child.stdout)):
                pipe.close()
            child.wait()

    @property
    def _pipe(self) -> IO[bytes]:
        """What the child writes."""
        return self._opened(self._opened(self._child).stdout)

    def _message(self) -> dict:
        line = self._pipe.readline(LONGEST_LINE)
        try:
            message = json.loads(line)
            complete = message.keys() >= _MESSAGES[message["kind"]]
        except (ValueError, LookupError, TypeError, AttributeError):
            complete = False
        if not complete or (message["kind"] == "error" and message["error"] not in _ERRORS):
            raise self._crashed()
        if message["kind"] == "error":
            raise _ERRORS[message["error"]](message["text"])
        return message

    def _bytes(self, count: int) -> bytes:
        content = self._pipe.read(count)
        if len(content) < count:
            raise self._crashed()
        return content

    def _crashed(self) -> SensorError:
        after = f"after {self._frames} frames" if self._frames else "when it was opened"
        library = PLAYERS[self.path.suffix.lower()][2]
        return SensorError(f"{self.path}: the {library} library crashed or hung while reading it, {after}; it is damaged")


def _environment() -> dict[str, str]:
    """Return the child's environment, in which it imports this copy of the package, wherever that is installed."""
    home = str(Path(__file__).resolve().parents[2])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (home, os.environ.get("PYTHONPATH"))))}


# ---- the child -----------------------------------------------------------------------------------------------------
def main(path: Path) -> None:
    """Play ``path`` to the standard output. This never returns, because the library may crash again when it is unloaded."""
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what the library prints must not be read as a message
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    module, name, _ = PLAYERS[path.suffix.lower()]
    try:
        make: Callable[..., CameraOrFile] = getattr(importlib.import_module(f".{module}", __package__), name)
        _play(make(path=path), pipe)
    except AdaptiveFaceError as error:
        _say(pipe, kind="error", error=type(error).__name__, text=str(error))
    except OSError:
        pass  # the reader is gone
    except Exception as error:  # a library may raise anything on a damaged file
        text = f"{path}: cannot be read ({error or type(error).__name__})"
        _say(pipe, kind="error", error="SensorError", text=text)
    os._exit(0)


def _end_with_the_parent() -> None:
    """End the process when its standard input ends, which happens when the parent ends."""
    sys.stdin.buffer.read()
    os._exit(1)


def _play(driver: CameraOrFile, pipe: BinaryIO) -> None:
    _in_time(driver.open)
    if max(driver.camera.width, driver.camera.height) > LONGEST_SIDE:
        raise SensorError(f"{driver.path}: pictures of {driver.camera.width} x {driver.camera.height} pixels")
    _say(pipe, kind="open", fps=driver.fps, depth_scale=driver.depth_scale, camera=asdict(driver.camera))
    while True:
        frame = _in_time(driver.grab, POLL_SECONDS)
        if frame is None:
            _say(pipe, kind="none")
            continue
        colour = frame.colour
        _say(pipe, False, kind="frame", colour=colour is not None, sequence=frame.sequence, timestamp=frame.timestamp)
        pipe.write(np.ascontiguousarray(frame.depth, np.float32).data)
        if colour is not None:
            pipe.write(np.ascontiguousarray(colour).data)
        pipe.flush()


def _in_time(call: Callable, *arguments):
    """Return the result of a call. If the call takes too long, this process ends, even if the library never returns."""
    faulthandler.dump_traceback_later(PATIENCE_SECONDS, exit=True)
    try:
        return call(*arguments)
    finally:
        faulthandler.cancel_dump_traceback_later()


def _say(pipe: BinaryIO, flush: bool = True, **message) -> None:
    pipe.write(json.dumps(message).encode() + b"\n")
    if flush:
        pipe.flush()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
