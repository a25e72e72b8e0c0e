"""Guide a person through the neutral scan, and keep the best frames (paper, section 3, "input").

The person looks straight ahead, and turns left, right, up and down, for about two seconds each. The scan takes the frames of a
live sensor with their 2D features. It has neither a thread nor a view, and takes less than 3 ms per frame.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from ..errors import TrackingError
from ..geometry.frame import Features2D, RgbdFrame
from ..geometry.mesh import surface_points, transform_points, vertex_normals
from ..model.actor import Actor
from ..model.face_model import FaceModel, embedded_face_model
from ..neutral.capture import capture_actor
from ..neutral.face_quality import Expression, expression, eye_distance, head_angles, seen_by_depth, sharpness
from ..neutral.fuse import Progress
from ..parameters import Parameters
from ..tracking.detection import pose_from_features

#: The steps, and what they ask the person to do; left and right are the person's own.
STEPS = {
    "straight": "look straight at the camera, with a relaxed face",
    "left": "turn your head slowly to your left",
    "right": "turn your head slowly to your right",
    "up": "lift your chin slowly",
    "down": "lower your chin slowly",
}
#: Angles that count as fully turned and fully nodded, degrees. Half of them suffices to avoid a warning.
TURN, NOD, ENOUGH = 20.0, 10.0, 0.5
#: Smallest numbers of good frames for the first step, and for the whole scan.
STRAIGHT_FRAMES, MIN_FRAMES = 10, 10
#: Beyond this turn, the expression is not judged, degrees.
PROFILE = 40.0
#: Nearest and farthest distance of the face from the camera, mm.
NEAR, FAR = 220.0, 1000.0
#: A face whose eyes are closer together in the picture is too small, px.
MIN_EYE_PIXELS = 45.0
#: Fastest motion of the head, eye distances per second; smallest sharpness, relative to its median.
FAST, BLURRED = 4.0, 0.45
#: A vertex that so many frames saw is covered. Depth within this distance of the expected one belongs to the face, mm.
VIEWS, REACH = 6, 25.0


@dataclass(frozen=True)
class Guidance:
    """What to tell the person.

    Attributes
    ----------
    text : str
        What to do.
    step : str
        A key of ``STEPS``, or "done".
    progress : float
        Share of the scan that is done, 0 to 1.
    coverage : dict
        Share of the target that is reached, by step.
    warnings : tuple of str
        Why this frame cannot be used, or what the finished scan lacks.
    done : bool
        Whether the scan is finished.
    """

    text: str
    step: str
    progress: float
    coverage: dict[str, float]
    warnings: tuple[str, ...]
    done: bool


@dataclass(frozen=True)
class _Kept:
    """A frame that was kept. Its ``cost`` grows with expression and blur. A ``clean`` frame caused no warning."""

    frame: RgbdFrame
    cost: float
    clean: bool
    cell: tuple[int, int]


@dataclass(frozen=True)
class _Face:
    """A face that can be used: its pose (4, 4), head to camera, its expression, and its blur from 0 to 1."""

    pose: np.ndarray
    expression: Expression
    blur: float


class GuidedCapture:
    """A scan in progress. :meth:`add` takes one frame after another until the scan is ``done``. :meth:`build` makes the actor.

    Parameters
    ----------
    seconds : float
        Length of the scan by the frames' timestamps, s, unless every step is done earlier. The scan takes twice as long if the
        face never looks neutral.
    most : int
        Largest number of frames that are kept.
    model : FaceModel, optional
        The face model. The default is the embedded model.

    Attributes
    ----------
    pose : (4, 4) or None
        Transform from the head frame to the camera frame in the last frame, mm. It is None if no face was found.
    frames_seen : int
        Number of frames so far.
    """

    def __init__(self, seconds: float = 10.0, most: int = 60, model: FaceModel | None = None) -> None:
        self.model, self.seconds, self.most = model or embedded_face_model(), seconds, most
        frontal = self.model.frontal
        self._points = surface_points(self.model.mean, self.model.feature_triangles, self.model.feature_weights)
        self._vertices = self.model.mean[frontal]
        self._normals = vertex_normals(self.model.mean, self.model.triangles)[frontal]
        self._seen = np.zeros(len(self._vertices), int)
        self._kept: list[_Kept] = []
        self._sharp: deque[float] = deque(maxlen=20)
        self._level: list[float] = []  # pitch of the first frames that look straight
        self._farthest = {name: [0.0, 0.0, 0.0] for name in STEPS if name != "straight"}
        self._last: tuple[float, np.ndarray] | None = None
        self._clock: float | None = None
        self._elapsed, self._step, self._step_began, self._finished = 0.0, "straight", 0.0, False
        self.pose: np.ndarray | None = None
        self.frames_seen = 0

    # ---- what a view shows -----------------------------------------------------------------------------------------
    @property
    def frames(self) -> list[RgbdFrame]:
        """The frames to build the head from, in order. If there are enough clean frames, they are the only ones."""
        clean = [kept.frame for kept in self._kept if kept.clean]
        chosen = clean if len(clean) >= MIN_FRAMES else [kept.frame for kept in self._kept]
        return sorted(chosen, key=lambda frame: frame.index)

    @property
    def vertex_coverage(self) -> np.ndarray:
        """How well depth has seen every vertex of the model's frontal region, (V,) from 0 to 1. It is 0 elsewhere."""
        out = np.zeros(len(self.model.mean))
        out[self.model.frontal] = np.minimum(self._seen / VIEWS, 1.0)
        return out

    @property
    def coverage(self) -> dict[str, float]:
        """The share of the target that every step has reached, from 0 to 1, by step."""
        out = {"straight": min(len(self._level) / STRAIGHT_FRAMES, 1.0)}
        for name, best in self._farthest.items():
            out[name] = float(np.clip(best[0] / (TURN if name in ("left", "right") else NOD), 0.0, 1.0))
        return out

    @property
    def done(self) -> bool:
        """Whether no further frame is needed."""
        return self._finished

    # ---- one frame -------------------------------------------------------------------------------------------------
    def add(self, frame: RgbdFrame) -> Guidance:
        """Judge a frame, and keep it if it is good. A scan that is done keeps no more frames.

        Parameters
        ----------
        frame : RgbdFrame
            The frame with its 2D features.

        Returns
        -------
        Guidance
            What to tell the person.
        """
        if self._finished:
            return self._guidance(())
        self.frames_seen += 1
        warnings, face = self._judge(frame)
        moved = self._advance(frame)
        if face is not None:
            self._elapsed += moved
            self._keep(frame, face, not warnings)
        self._next_step()
        self._finished = self._complete()
        return self._guidance(warnings)

    def finish(self) -> Guidance:
        """Stop the scan with the frames so far. Raises :class:`TrackingError` if none shows a face."""
        if not self._kept:
            raise TrackingError(
                f"none of the {self.frames_seen} frames so far shows a face with depth; nothing to build a head from"
            )
        self._finished = True
        return self._guidance(())

    def build(self, parameters: Parameters | None = None, progress: Progress | None = None) -> Actor:
        """Build the actor from the frames that were kept. This takes some seconds.

        The arguments and the errors are those of :func:`~adaptiveface.neutral.capture.capture_actor`.
        """
        return capture_actor(self.frames, self.model, parameters or Parameters(), progress)

    # ---- judging ---------------------------------------------------------------------------------------------------
    def _judge(self, frame: RgbdFrame) -> tuple[tuple[str, ...], _Face | None]:
        """Return the warnings about a frame, and its face if that can be used."""
        self.pose = None
        if not frame.depth.any():
            return ("no depth: the sensor measures nothing",), None
        pose, features = pose_from_features(frame, self._points), frame.features
        if pose is None or features is None:
            return ("no face: look at the camera, well lit",), None
        self.pose, distance = pose, float(np.linalg.norm(pose[:3, 3]))
        neutral = frame.camera.project(transform_points(pose, self._points))
        unit = eye_distance(neutral)
        turned = abs(head_angles(pose)[0]) > PROFILE  # where the detector guesses the far half of the face
        warnings = []
        if distance < NEAR:
            warnings.append(f"too near ({distance / 10:.0f} cm): move back")
        elif distance > FAR or (unit < MIN_EYE_PIXELS and not turned):
            warnings.append(f"too far ({distance / 10:.0f} cm): come closer")
        face = Expression(0, 0, 0, 0) if turned else expression(features, neutral)
        blur = self._blur(frame)
        warnings += [face.warning] if face.warning else []
        if blur >= 1 or self._speed(features, frame.timestamp, unit) > FAST:
            warnings.append("blurred: move more slowly")
            blur = max(blur, 1.0)
        return tuple(warnings), _Face(pose, face, blur)

    def _blur(self, frame: RgbdFrame) -> float:
        """Return the blur, from 0 (as sharp as usual) to 1 (the limit) and above. It is 0 without colour."""
        sharp = sharpness(frame)
        if not np.isfinite(sharp):
            return 0.0
        self._sharp.append(sharp)
        return float(np.clip((1 - sharp / max(np.median(self._sharp), 1e-9)) / (1 - BLURRED), 0.0, 2.0))

    def _speed(self, features: Features2D, timestamp: float, unit: float) -> float:
        """Return the median motion of the features since the last frame, eye distances per second. It is 0 after a gap."""
        now = np.where(features.valid[:, None], features.pixels, np.nan)
        last = self._last
        self._last = (timestamp, now)
        if last is None or not 1e-3 < timestamp - last[0] < 0.2:
            return 0.0
        moved = np.linalg.norm(now - last[1], axis=1)
        moved = moved[np.isfinite(moved)]
        return float(np.median(moved) / unit / (timestamp - last[0])) if len(moved) else 0.0

    def _advance(self, frame: RgbdFrame) -> float:
        """Return the seconds since the previous frame, but at most half a second, because device clocks jump."""
        last, self._clock = self._clock, frame.timestamp
        return 0.0 if last is None else float(np.clip(frame.timestamp - last, 0.0, 0.5))

    # ---- keeping ---------------------------------------------------------------------------------------------------
    def _keep(self, frame: RgbdFrame, face: _Face, clean: bool) -> None:
        yaw, pitch = head_angles(face.pose)
        if clean and len(self._level) < STRAIGHT_FRAMES and abs(yaw) < 15 and abs(pitch) < 30:
            self._level.append(pitch)
        level = float(np.median(self._level)) if self._level else pitch
        cell = (round(yaw / 6), round((pitch - level) / 5))
        self._kept.append(_Kept(frame, face.expression.worst + face.blur, clean, cell))
        if len(self._kept) > self.most:
            self._drop_one()
        self._count_views(frame, face.pose)
        if clean:
            self._record(yaw, pitch - level)

    def _record(self, yaw: float, pitch: float) -> None:
        for name, angle in (("left", yaw), ("right", -yaw), ("up", pitch), ("down", -pitch)):
            best = self._farthest[name]  # the third largest counts, so that single outliers do not matter
            self._farthest[name] = sorted([*best, angle])[-3:]

    def _count_views(self, frame: RgbdFrame, pose: np.ndarray) -> None:
        points = transform_points(pose, self._vertices)
        normals = self._normals @ pose[:3, :3].T
        self._seen += seen_by_depth(frame.depth, frame.camera, points, normals, REACH)

    def _drop_one(self) -> None:
        """Drop the worst frame of the direction that has the most frames. Frames with a warning are dropped first."""
        cells: dict[tuple[int, int], int] = {}
        for kept in self._kept:
            cells[kept.cell] = cells.get(kept.cell, 0) + 1
        unclean = any(not kept.clean for kept in self._kept)
        worst = max(
            range(len(self._kept)),
            key=lambda i: (unclean and not self._kept[i].clean, cells[self._kept[i].cell], self._kept[i].cost),
        )
        del self._kept[worst]

    # ---- steps -----------------------------------------------------------------------------------------------------
    def _next_step(self) -> None:
        """If the step is reached or its time is over, go to the next step that is not reached."""
        coverage, names = self.coverage, list(STEPS)
        waited = self._elapsed - self._step_began
        if coverage[self._step] < 1 and (waited < self.seconds / len(STEPS) or not self._level):
            return
        turn = names.index(self._step) + 1
        following = [name for name in names[turn:] + names[:turn] if coverage[name] < 1]
        self._step, self._step_began = (following or [self._step])[0], self._elapsed

    def _complete(self) -> bool:
        clean = sum(kept.clean for kept in self._kept)
        if clean >= MIN_FRAMES and (self._elapsed >= self.seconds or min(self.coverage.values()) >= 1):
            return True
        return len(self._kept) >= MIN_FRAMES and self._elapsed >= 2 * self.seconds

    def _guidance(self, warnings: tuple[str, ...]) -> Guidance:
        coverage = self.coverage
        if self._finished:
            return Guidance(f"done: {len(self.frames)} frames", "done", 1.0, coverage, self._shortcomings(coverage), True)
        progress = max(self._elapsed / self.seconds, float(np.mean(list(coverage.values()))))
        return Guidance(STEPS[self._step], self._step, min(progress, 0.99), coverage, warnings, False)

    def _shortcomings(self, coverage: dict[str, float]) -> tuple[str, ...]:
        out = []
        missing = [name for name, share in coverage.items() if share < ENOUGH and name != "straight"]
        if missing:
            out.append(f"the head hardly turned {', '.join(missing)}: what shows only from there comes from the average head")
        if sum(kept.clean for kept in self._kept) < MIN_FRAMES:
            out.append("hardly a frame was without a warning: the head may hold an expression or lack detail")
        return tuple(out)


__all__ = ["STEPS", "GuidedCapture", "Guidance"]
