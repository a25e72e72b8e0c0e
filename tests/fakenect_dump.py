"""Kinect v1 without a Kinect: writes a dump for libfreenect's fakenect, and plays one (as a script, in its own process).

fakenect ends the process on whatever it does not like, hence the process of its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from glob import glob
from pathlib import Path

import numpy as np

TICKS_PER_FRAME = 2_000_000


def library() -> str | None:
    """Path of fakenect, or None where it is not installed."""
    return next(iter(sorted(glob("/usr/lib/*/fakenect/libfreenect.so.0.5") + glob("/usr/lib/fakenect/libfreenect.so*"))), None)


def write(folder: Path, frames, first_ticks: int = 1000) -> None:
    """``frames``: (number, disparity (480, 640) uint16 or None, picture (480, 640, 3) uint8 or None) in their order."""
    folder.mkdir()
    lines = []
    for number, disparity, picture in frames:
        for kind, header, image, later in (("d", "P5 640 480 65535", disparity, 0), ("r", "P6 640 480 255", picture, 0.005)):
            if image is None:
                continue
            ticks = (first_ticks + number * TICKS_PER_FRAME + int(later * 60e6)) % 2**32
            name = f"{kind}-{1000 + number / 30 + later:f}-{ticks}.{'pgm' if kind == 'd' else 'ppm'}"
            (folder / name).write_bytes(header.encode() + b"\n" + np.ascontiguousarray(image).tobytes())
            lines.append(name)
    (folder / "INDEX.txt").write_text("\n".join(lines) + "\n")


def play(folder: Path, focal: float | None = None, aligned: bool = True, live: bool = False) -> dict:
    """What the driver delivers from a dump: depth, colour (if any), sequence, timestamp, focal length, how it ended.

    ``focal``: of the depth camera instead of the nominal one; ``aligned``: the dump's pictures are; ``live``: through
    a LiveSensor, which hands over the newest frames, else every frame from the driver itself.
    """
    out = folder / "played.npz"
    environment = {**os.environ, "FREENECT_LIBRARY": library(), "FAKENECT_PATH": str(folder)}
    arguments = [sys.executable, __file__, str(out), json.dumps([focal, aligned, live])]
    run = subprocess.run(arguments, env=environment, capture_output=True, text=True, timeout=60)
    assert run.returncode == 0, run.stdout[-1000:] + run.stderr[-2000:]
    with np.load(out) as played:
        return {**played, "said": json.loads(run.stdout.strip().splitlines()[-1])}


def _child(out: str, options: str) -> None:
    from adaptiveface.errors import SensorDisconnectedError
    from adaptiveface.geometry.camera import Camera
    from adaptiveface.sensors import list_sensors
    from adaptiveface.sensors.kinect1 import Kinect1Driver

    focal, aligned, live = json.loads(options)

    class Driver(Kinect1Driver):
        """The dump was rendered by an ideal camera."""

        if focal:
            depth_camera = Camera(640, 480, focal, focal, 319.5, 239.5)
        withholds_unaligned = not aligned

    listed = [info.name for info in list_sensors() if info.name.startswith("kinect1") and info.ready]
    frames, end = [], ""
    try:
        for frame in _newest(Driver) if live else _every(Driver()):
            frames.append(frame)
    except SensorDisconnectedError as error:
        end = str(error)
    colour = {} if frames[0].colour is None else {"colour": np.stack([f.colour for f in frames])}
    np.savez(
        out,
        depth=np.stack([f.depth for f in frames]),
        sequence=[f.sequence for f in frames],
        timestamp=[f.timestamp for f in frames],
        focal=frames[0].camera.fx,
        **colour,
    )
    sys.stdout.write("\n" + json.dumps({"listed": listed, "end": end}) + "\n")
    sys.stdout.flush()


def _every(driver):
    try:
        driver.open()
        while True:
            frame = driver.grab(0.1)
            if frame is not None:
                yield frame
    finally:
        driver.close()
        driver.close()


def _newest(make_driver):
    from adaptiveface.sensors.live import LiveSensor

    with LiveSensor(make_driver, max_age=60, reconnect=False) as sensor:
        while True:
            yield sensor.read(5)


if __name__ == "__main__":
    _child(*sys.argv[1:])
