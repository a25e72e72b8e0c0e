"""A live camera on a talking head, and what tests of the live chain wait for."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from functools import lru_cache

import numpy as np
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame

from adaptiveface.parameters import Parameters
from adaptiveface.sensors.driver import Driver, RawFrame

#: A coarse head, made in a second.
QUICK = Parameters().replace(
    fusion__voxel=4.0,
    fusion__passes=1,
    fusion__iterations=5,
    fit__iterations=5,
    shrink_wrap__iterations=1,
    shrink_wrap__detail_iterations=0,
    adaptive_pca__valid_min=0.01,
)


class HeadDriver(Driver):
    """A live camera on a talking head, 30 frames a second: the given frames forth and back, with their features."""

    name, live, has_features, depth_scale, fps = "test head", True, True, 10_000.0, 30.0

    def __init__(self, frames) -> None:
        self._frames, self._next = frames, 0

    def open(self) -> None:
        self._next = 0

    def grab(self, timeout: float) -> RawFrame:
        time.sleep(1 / self.fps)
        turn = self._next % (2 * len(self._frames) - 2)
        frame = self._frames[min(turn, 2 * len(self._frames) - 2 - turn)]
        self._next += 1
        return RawFrame(frame.depth, frame.camera, frame.colour, self._next, self._next / self.fps, frame.features)

    def close(self) -> None:
        pass


class ColourDriver(HeadDriver):
    """The same camera without depth."""

    name, colour_only = "test webcam", True

    def grab(self, timeout: float) -> RawFrame:
        return replace(super().grab(timeout), depth=np.zeros((480, 640), np.float32))


@lru_cache(maxsize=1)
def head_frames() -> tuple:
    """Eight frames of an opening jaw, in colour."""
    actor, out = exact_actor(), []
    for k in range(8):
        shape = posed_shape(actor, coefficients(actor, **{actor.expression_names[0]: 0.02 * k}))
        shape[actor.frontal, 2] += 1.5 * np.sin(actor.neutral[actor.frontal, 1] / 12.0) * k / 8  # in no basis
        frame = render_frame(actor, shape, head_pose((0, 0.02 * k, 0), (0, 0, 500.0)), k, noise=0.3)
        grey = np.clip(frame.depth[..., None] / 4, 0, 255).astype(np.uint8).repeat(3, axis=2)
        out.append(replace(frame, colour=grey))
    return tuple(out)


def threads_of_ours() -> list[str]:
    """Names of the live chain's threads that are still there."""
    words = ("live run", "features", "tracker", "sensor", "recording")
    return [thread.name for thread in threading.enumerate() if thread.name.startswith(words)]


def wait_for(condition, seconds: float = 60.0) -> None:
    """Until ``condition()``; fails after ``seconds``."""
    end = time.perf_counter() + seconds
    while not condition():
        assert time.perf_counter() < end, "it takes too long"
        time.sleep(0.02)
