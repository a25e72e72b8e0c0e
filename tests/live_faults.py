"""A driver that plays a list of steps: frames, waits, and exceptions. The faults of live sensors, for the tests."""

from __future__ import annotations

import dataclasses

import numpy as np

from adaptiveface.errors import EndOfRecording
from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.frame import Features2D, RgbdFrame
from adaptiveface.sensors.driver import Driver, RawFrame
from adaptiveface.sensors.playback import raw_frame

CAMERA = Camera(32, 24, 30.0, 30.0, 15.5, 11.5)
STALL = None


class ScriptedDriver(Driver):
    """Delivers ``steps`` in order: a RawFrame, ``STALL`` (no frame within the timeout), or an exception to raise.

    A new driver on the same list goes on where the last one stopped, as a sensor does that was plugged in again.
    """

    name, fps, depth_scale, has_features = "scripted", 30.0, 10_000.0, True

    def __init__(self, steps: list, live: bool = False, log: list | None = None) -> None:
        self.steps, self.live, self.log = steps, live, [] if log is None else log

    def open(self) -> None:
        self.log.append("open")

    def grab(self, timeout: float) -> RawFrame | None:
        if not self.steps:
            raise EndOfRecording("scripted: the end")
        step = self.steps.pop(0)
        if isinstance(step, Exception):
            raise step
        return step

    def close(self) -> None:
        self.log.append("close")


def small_frame(sequence: int, depth: float = 500.0) -> RawFrame:
    """A frame of 32 x 24 pixels with constant depth."""
    return RawFrame(np.full((24, 32), depth), CAMERA, None, sequence, sequence / 30.0)


def raw(frame: RgbdFrame, sequence: int) -> RawFrame:
    """``frame`` as a driver delivers it at 30 frames a second."""
    return raw_frame(frame, sequence, sequence / 30.0)


def without_depth(frame: RgbdFrame, value: float) -> RgbdFrame:
    """No measurement anywhere, as zeros or as NaN; the colour camera and its features still work."""
    return dataclasses.replace(frame, depth=np.full_like(frame.depth, value))


def empty_room(frame: RgbdFrame) -> RgbdFrame:
    """The face has left: a wall at 1.5 m, no features."""
    unseen = Features2D(np.full((40, 2), np.nan), np.zeros(40))
    return dataclasses.replace(frame, depth=np.full_like(frame.depth, 1500.0), features=unseen)


def half_size(frame: RgbdFrame) -> RgbdFrame:
    """Every second pixel, with the calibration that belongs to them."""
    c = frame.camera
    camera = Camera(c.width // 2, c.height // 2, c.fx / 2, c.fy / 2, c.cx / 2, c.cy / 2)
    features = Features2D(frame.features.pixels / 2, frame.features.confidence)
    return dataclasses.replace(frame, depth=frame.depth[::2, ::2], camera=camera, features=features)


def hand_over_mouth(frame: RgbdFrame, rng: np.random.Generator) -> RgbdFrame:
    """A flat hand 15 to 80 mm in front of the lips, tilted and shifted a little.

    The lips' features are not seen, or guessed some pixels off with little confidence.
    """
    pixels, confidence = frame.features.pixels.copy(), frame.features.confidence.copy()
    (u0, v0), (u1, v1) = np.nanmin(pixels[20:], axis=0), np.nanmax(pixels[20:], axis=0)
    depth = frame.depth.copy()
    du, dv = rng.integers(-12, 13, 2)
    rows = slice(int(v0) - 25 + int(dv), int(v1) + 25 + int(dv))
    columns = slice(int(u0) - 25 + int(du), int(u1) + 25 + int(du))
    mouth = depth[rows, columns]
    tilt = rng.uniform(-0.2, 0.2) * (np.arange(mouth.shape[1]) - mouth.shape[1] / 2)
    depth[rows, columns] = np.median(mouth[mouth > 0]) - rng.uniform(15.0, 80.0) + tilt
    if rng.random() < 0.5:
        pixels[20:], confidence[20:] = np.nan, 0.0
    else:
        pixels[20:] += rng.normal(0.0, 4.0, 2)
        confidence[20:] = np.where(confidence[20:] > 0, 0.1, 0.0)
    return dataclasses.replace(frame, depth=depth, features=Features2D(pixels, confidence))


def second_face(frame: RgbdFrame, aside: int, nearer: float) -> RgbdFrame:
    """The same face once more, ``aside`` pixels to the side and ``nearer`` mm nearer; never in front of the first."""
    other = np.roll(frame.depth, aside, axis=1)
    if aside > 0:
        other[:, :aside] = 0
    else:
        other[:, aside:] = 0
    other[other > 0] -= nearer
    return dataclasses.replace(frame, depth=np.where(frame.depth > 0, frame.depth, other))
