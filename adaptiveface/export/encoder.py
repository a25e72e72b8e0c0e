"""Encode raw pictures with ffmpeg through a pipe. Its exit status is checked, and its messages are reported."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterable
from pathlib import Path
from typing import IO, Any, cast

import numpy as np

from ..errors import AdaptiveFaceError
from ..runtime.interrupt import CtrlC

#: Longest time that ffmpeg may take to finish a film after the last picture, s.
FINISH_SECONDS = 600.0


def ffmpeg_program() -> str | None:
    """Path of the ffmpeg that ``imageio-ffmpeg`` (the extra ``video``) provides. None if it is not installed."""
    try:
        import imageio_ffmpeg

        return imageio_ffmpeg.get_ffmpeg_exe()
    except (ImportError, RuntimeError):
        return None


def encode_h264(program: str, path: Path, frames: Iterable[np.ndarray], size: tuple[int, int], fps: float) -> None:
    """Write pictures as H.264. If this fails or is interrupted by Ctrl-C, ffmpeg is ended before it finishes the film.

    Parameters
    ----------
    program : str
        Path of ffmpeg.
    path : Path
        The file to write.
    frames : iterable of (height, width, 3) uint8
        RGB.
    size : (int, int)
        Width and height, px.
    fps : float
        Frames per second.

    Raises
    ------
    AdaptiveFaceError
        ffmpeg fails. The message has its own reason.
    OSError
        The disk is full.
    """
    read = f"-f rawvideo -pix_fmt rgb24 -s {size[0]}x{size[1]} -r {fps:.9g} -i -"
    write = "-an -c:v libx264 -pix_fmt yuv420p -preset veryfast -crf 20 -movflags +faststart"
    options = f"-y -hide_banner -nostats -loglevel error {read} {write}".split()
    command = [program, *options, os.fspath(path.absolute())]
    apart: dict[str, Any] = {"start_new_session": True}
    if sys.platform == "win32":
        apart = {"creationflags": subprocess.CREATE_NEW_PROCESS_GROUP}
    with tempfile.TemporaryFile() as said:
        with CtrlC() as ctrl_c:  # otherwise, an interrupt here would leave it running
            child = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said, **apart)
        try:
            ctrl_c.check()
            _feed(cast("IO[bytes]", child.stdin), frames)  # a pipe, as Popen was told
            status = child.wait(FINISH_SECONDS)
        except BaseException:
            child.kill()
            raise
        finally:
            child.wait()
        said.seek(0)
        text = said.read(1 << 16).decode(errors="replace")
    if "No space left on device" in text:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if status:
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        why = lines[-1][:200] if lines else "it said nothing"
        raise AdaptiveFaceError(f"ffmpeg ended with status {status}: {why}")


def _feed(pipe: IO[bytes], frames: Iterable[np.ndarray]) -> None:
    try:
        for frame in frames:
            pipe.write(np.ascontiguousarray(frame).data)
        pipe.close()
    except BrokenPipeError:  # ffmpeg has ended, and its messages tell the reason
        pass
