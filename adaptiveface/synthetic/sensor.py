"""The synthetic RGB-D sensor: a performer in front of a depth camera, with exact ground truth.

Seeds 0 to 99 are for development and tuning; report results on seeds of 1000 and above only.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ..errors import ParameterError
from ..geometry.camera import Camera
from ..geometry.frame import FEATURE_REGIONS, Features2D, RgbdFrame
from ..geometry.mesh import rotation_vector_matrix, surface_points, transform_points
from ..geometry.rendering import Hits, covering_window, ray_cast
from ..geometry.source import NumberedFrames
from ..model.face_model import FaceModel
from ..renamed import renamed
from .look import Look
from .noise import DEPTH_SCALES, add_noise
from .paint import Painter
from .performer import Performer
from .scene import Scene
from .script import HeadMotion, performance
from .take import Take

#: A feature that lies this far behind the visible surface cannot be seen, mm. The limit is larger for lips, which roll inwards.
OCCLUSION = np.where(FEATURE_REGIONS == "lips", 10.0, 5.0)


@renamed
@dataclass(frozen=True)
class GroundTruth:
    """The exact values behind one frame, for V vertices and E expression units.

    Attributes
    ----------
    vertices : (V, 3) array
        Vertices in the camera frame, mm. They lie exactly on the rendered skin.
    head_pose : (4, 4) array
        Transform from the head frame to the camera frame.
    activations : (E,) array
        Activation of every expression unit.
    features : (40, 2) array
        Exact places of the features, px.
    performance : int
        -1 in the neutral scan, 0 in the first performance, 1 in its first repeat, and so on.
    """

    vertices: np.ndarray
    head_pose: np.ndarray
    activations: np.ndarray
    features: np.ndarray
    performance: int


class SyntheticSensor(NumberedFrames):
    """A repeatable recording of a :class:`Performer`.

    It begins with ``neutral_frames`` of the neutral face while the head turns. The same ``frames`` of expressions follow
    ``repeats`` times, and each repeat has its own head motion and noise. A frame depends only on the seed and its index.
    Frames can therefore be read in any order and any number of times.

    Parameters
    ----------
    seed : int
        Seed of the performer, the script and the noise.
    noise : str
        Kind of depth noise: "structured-light", "truedepth" or "none".
    neutral_frames, frames, repeats : int
        Lengths of the parts, in frames, and number of performances, as described above.
    width, height : int
        Size of the images, px.
    model : FaceModel, optional
        The face model from which the performer is drawn.
    take : Take, optional
        A real take that is performed once instead of the script. It then determines ``frames`` and ``repeats``.
    feature_noise : float
        Standard deviation of the 2D features, pixels per coordinate.
    colour : bool
        Whether frames have a colour image. Reading is faster without one.
    look : Look, optional
        The skin, light and camera of the pictures. The default is the simple skin in steady light.
    focal : float
        Focal length in pixels for an image that is 640 pixels wide.
    distance : float
        Distance of the head from the camera, mm.
    performer : Performer, optional
        A performer to use instead of the one that is drawn with ``seed`` and ``model``.

    Attributes
    ----------
    camera : Camera
    name : str
    fps : float
    depth_scale : float
        Units per metre to which the depth is rounded.
    performer : Performer
    script : (frames, E) array
        Activation of every expression unit.

    Raises
    ------
    ParameterError
        ``noise`` is unknown, or a number is negative.
    """

    fps = 30.0

    def __init__(
        self,
        seed: int = 0,
        noise: str = "structured-light",
        neutral_frames: int = 40,
        frames: int = 300,
        repeats: int = 2,
        width: int = 640,
        height: int = 480,
        feature_noise: float = 0.5,
        *,
        colour: bool = True,
        focal: float = 525.0,
        distance: float = 600.0,
        model: FaceModel | None = None,
        performer: Performer | None = None,
        take: Take | None = None,
        look: Look | None = None,
    ) -> None:
        if noise not in DEPTH_SCALES:
            raise ParameterError(f"noise = {noise!r}: one of {', '.join(DEPTH_SCALES)} is expected")
        if neutral_frames < 0 or frames < 0 or repeats < 0 or feature_noise < 0:
            raise ParameterError("neutral_frames, frames, repeats and feature_noise must not be negative")
        self.seed, self.noise, self.feature_noise, self.colour = seed, noise, feature_noise, colour
        self.neutral_frames, self.frames, self.repeats = neutral_frames, frames, repeats
        self.name = f"synthetic performer {seed}, {noise} noise" + (f", take {take.name}" if take else "")
        self.look = look or Look()
        if str(self.look):
            self.name += f", {self.look}".replace(":", ", ").replace("=", " ")
        self.depth_scale = DEPTH_SCALES[noise]
        f = focal * width / 640
        self.camera = Camera(width, height, f, f, (width - 1) / 2, (height - 1) / 2)
        self.performer = Performer(seed, model) if performer is None else performer
        turns = None
        if take is None:
            self.script = performance(seed, self.performer.expression_names, frames)
        else:
            self.script, self.repeats = take.activations(self.performer.expression_names, self.fps), 1
            self.frames = len(self.script)
            turns = take.head_turns(self.fps) if take.turns else None
        self._motion = HeadMotion(seed, neutral_frames, self.fps, distance, turns=turns)
        self._scene = Scene(self.performer, self._motion.pose(0))
        self._painter = Painter(self._scene, seed, self.camera, self.look, self.fps) if colour else None
        self._feature_drift = _drift(np.random.default_rng([seed, 0xD21F]))
        # The ground truth of a frame is mostly asked for right after the frame.
        self._skin = lru_cache(maxsize=4)(self._deform)

    def __len__(self) -> int:
        return self.neutral_frames + self.frames * self.repeats

    def ground_truth(self, index: int) -> GroundTruth:
        """Return the exact values behind one frame.

        Parameters
        ----------
        index : int
            Number of the frame in the recording.

        Returns
        -------
        GroundTruth

        Raises
        ------
        IndexError
            The recording has no such frame.
        """
        activations, part = self._activations(index)
        rigid = self._motion.pose(index)
        vertices = transform_points(rigid, self._skin(index)[: len(self.performer.neutral)])
        features = self.camera.project(self._features(vertices))
        return GroundTruth(vertices, rigid, activations, features, part)

    def read(self, index: int) -> RgbdFrame:
        """Render one frame.

        Parameters
        ----------
        index : int
            Number of the frame in the recording.

        Returns
        -------
        RgbdFrame
            The frame with depth and features. It has a colour image unless the sensor was made with ``colour=False``.

        Raises
        ------
        IndexError
            The recording has no such frame.
        """
        truth = self.ground_truth(index)
        vertices = self._vertices(index)
        window = covering_window(self.camera, vertices, margin=2)
        hits = ray_cast(self.camera, vertices, self._scene.triangles, window, cull=True)
        u0, v0, u1, v1 = window
        depth = np.zeros((self.camera.height, self.camera.width), np.float32)
        rng = np.random.default_rng([self.seed, index, 1])
        depth[v0:v1, u0:u1] = add_noise(self.noise, hits.depth, self.camera, rng)
        colour = None
        if self._painter is not None:
            rng, motion = np.random.default_rng([self.seed, index, 2]), self._motion_of(index, vertices)
            rotation = truth.head_pose[:3, :3]
            colour = self._painter.paint(hits, vertices, self.camera, rng, index, motion, rotation)
        features = self._observe(truth, hits, index)
        return RgbdFrame(depth, self.camera, colour, index, index / self.fps, features)

    def _vertices(self, index: int) -> np.ndarray:
        """Return the (n, 3) vertices of the whole scene in the camera frame, mm."""
        gaze = self._gaze(self._activations(index)[0])
        return self._scene.vertices(self._skin(index), self._motion.pose(index), gaze)

    def _motion_of(self, index: int, vertices: np.ndarray) -> np.ndarray:
        """Return the (n, 3) motion of the scene since the last frame, mm. It is zero if the camera does not blur motion."""
        part = self._activations(index)[1]
        if self.look.camera == "plain" or index == 0 or self._activations(index - 1)[1] != part:
            return np.zeros_like(vertices)
        return vertices - self._vertices(index - 1)

    def _activations(self, index: int) -> tuple[np.ndarray, int]:
        if not 0 <= index < len(self):
            raise IndexError(f"frame {index} of {len(self)}")
        if index < self.neutral_frames:
            return np.zeros(len(self.performer.expression_names)), -1
        part, frame = divmod(index - self.neutral_frames, self.frames)
        return self.script[frame], part

    def _deform(self, index: int) -> np.ndarray:
        return self.performer.surface(self._activations(index)[0])

    def _features(self, vertices: np.ndarray) -> np.ndarray:
        model = self.performer.model
        return surface_points(vertices, model.feature_triangles, model.feature_weights)

    def _gaze(self, activations: np.ndarray) -> np.ndarray:
        """Return the (2, 3, 3) rotations of the eyeballs, the subject's left one first.

        An eyeball turns by 25 degrees at full activation.
        """
        level = dict(zip(self.performer.expression_names, activations, strict=True))
        out = []
        for side, away in (("Left", 1.0), ("Right", -1.0)):
            sideways = away * (level.get(f"eyeLookOut{side}", 0) - level.get(f"eyeLookIn{side}", 0))
            down = level.get(f"eyeLookDown{side}", 0) - level.get(f"eyeLookUp{side}", 0)
            out.append(rotation_vector_matrix(np.radians(25.0) * np.array([down, sideways, 0.0])))
        return np.array(out)

    def _observe(self, truth: GroundTruth, hits: Hits, index: int) -> Features2D:
        """Observe the features with errors.

        White noise makes up 80 % of the error's variance, and a slow drift makes up the rest. Hidden features are NaN.
        Features that are partly hidden have a lower confidence.
        """
        white = np.random.default_rng([self.seed, index, 3]).standard_normal((40, 2))
        error = np.sqrt(0.8) * white + np.sqrt(0.2) * self._feature_drift(index)
        pixels = truth.features + self.feature_noise * error
        u0, v0, u1, v1 = hits.window
        at = np.round(truth.features).astype(int) - [u0, v0]
        inside = (at >= 0).all(axis=1) & (at[:, 0] < u1 - u0) & (at[:, 1] < v1 - v0)
        at = np.where(inside[:, None], at, 0)
        in_front = hits.depth[at[:, 1], at[:, 0]]
        behind = self._features(truth.vertices)[:, 2] - in_front
        hidden = ~inside | ((in_front > 0) & (behind > OCCLUSION))
        confidence = np.where(hidden, 0.0, np.clip(1.0 - np.maximum(behind - 3.0, 0) / OCCLUSION, 0.2, 1.0))
        return Features2D(np.where(hidden[:, None], np.nan, pixels), confidence)


def _drift(rng: np.random.Generator):
    """Return a function of the frame number that gives a slowly varying (40, 2) error of unit variance."""
    period, phase = rng.uniform(25, 90, (3, 40, 2)), rng.uniform(0, 2 * np.pi, (3, 40, 2))
    return lambda frame: np.sqrt(2 / 3) * np.sin(2 * np.pi * frame / period + phase).sum(axis=0)
