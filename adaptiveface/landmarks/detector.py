"""Detect the 40 facial features of the method in colour images with MediaPipe's FaceLandmarker.

Both of its modes look for several faces here, and one face is kept. MediaPipe smooths only when it looks for a single face
(``num_faces=1``), and the smoothing lags behind the motion. On a real TrueDepth recording of a rigid head (poses from depth
ICP, 56 frames around the front), single-image mode is 1.29 px from the truth and smoothed video mode is 1.64 px. The noise
from frame to frame is nearly the same (0.55 and 0.51 px). On 240 frames of a synthetic performer, the errors without their
constant part are 0.68 px with no lag and 0.90 px with a lag of a third of a frame. When video mode looks for several faces,
it returns the same numbers as single-image mode on both, bit for bit, in the same time (7.4 ms per frame).

Two changes did not help. Enlarging the image by 2 or 3 makes no difference (1.29 and 1.28 px), because the network resizes
the face itself. Lower thresholds find a few more faces beyond 65 degrees in profile views, but also false ones.
"""

from __future__ import annotations

import atexit
import os
import sys
import weakref
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import lru_cache
from importlib.resources import as_file, files

import numpy as np

from ..errors import SYSTEM_LIBRARIES_HINT, FeatureDetectionError, MissingExtraError
from ..geometry.expression_names import SCORE_NAMES
from ..geometry.frame import MEDIAPIPE_INDICES, DetectedFace, Features2D, RgbdFrame
from ..geometry.mesh import vertex_normals
from .kept_face import KeptFace, VideoClock
from .model_file import ENVIRONMENT, face_landmarker_file
from .windows import Window, own_window, search_windows

#: Depth behind the nearest surface that counts as the person when the face is searched for in a crop, mm.
_FOREGROUND_MM = 500.0
#: Confidence of a feature seen from the front: the inverse ratio of variances. The weights of the method are for features
#: with 0.5 px of noise. Features detected here are off by 0.9 px (root mean square), mostly alike for a whole expression.
TRUST = 0.3
#: Number of faces to look for in a picture. With one, MediaPipe would smooth.
MAX_FACES = 3

#: Shares (40, 468) of MediaPipe's skin landmarks in each feature. MediaPipe's landmark of the same name is up to 2 mm away
#: from the model's feature, alike on every face. ``data_synth/place_detected_features.py`` makes this file.
_PLACES = "mediapipe_features.npz"

#: Landmarkers of MediaPipe that are still open, and those whose detector is gone. MediaPipe's own finaliser must never find
#: one open: it waits for a thread that the garbage collector may already have ended, and would then wait for ever.
_open: set = set()
_abandoned: deque = deque()


@atexit.register  # registered before MediaPipe's own handler, so it is called after it; that makes closing quiet
def _close_all() -> None:
    _abandoned.extend(_open)
    _close_abandoned()


def _close_abandoned() -> None:
    """Close the landmarkers whose detector is gone. This is done when the next detector is made.

    It must not be done when a detector is collected, because that may happen at any step and while locks are held.
    """
    with suppress(IndexError):  # none is left; several threads may do this at once
        while True:
            _close(_abandoned.popleft())


def _close(landmarker) -> None:
    if landmarker in _open:
        _open.discard(landmarker)
        with suppress(RuntimeError):
            landmarker.close()


class FeatureDetector:
    """Finds the 40 features of :data:`adaptiveface.geometry.frame.FEATURE_IDS` in colour images and follows one face.

    Parameters
    ----------
    model_path : path-like, optional
        The model file, by default the one of :func:`face_landmarker_file`.
    video : bool
        Whether to use MediaPipe's video mode, for a live stream.

    Raises
    ------
    MissingExtraError
        MediaPipe is not installed.
    FeatureDetectionError
        MediaPipe or its model cannot be loaded.
    """

    def __init__(self, model_path: str | os.PathLike | None = None, *, video: bool = False) -> None:
        mediapipe, vision, base_options = _import_mediapipe()
        _close_abandoned()
        self._loaded: list = []
        weakref.finalize(self, _abandoned.extend, self._loaded).atexit = False
        self._path = os.fspath(model_path or face_landmarker_file())
        self._vision, self._base_options = vision, base_options
        self._image = lambda pixels: mediapipe.Image(image_format=mediapipe.ImageFormat.SRGB, data=np.ascontiguousarray(pixels))
        self._landmarker = self._load(vision.RunningMode.IMAGE)
        self._video = self._load(vision.RunningMode.VIDEO) if video else None
        self._video_size: tuple[int, ...] = ()
        self._clock, self._kept = VideoClock(), KeptFace()
        self._window: Window | None = None  # the kept face's own window, if the face is small
        self._turn = 0
        edges = vision.FaceLandmarksConnections.FACE_LANDMARKS_TESSELATION  # listed triangle by triangle
        self._triangles = np.array([edge.start for edge in edges], np.int32).reshape(-1, 3)

    def _load(self, mode):
        """Create a MediaPipe landmarker in one of its running modes and start its threads."""
        options = self._vision.FaceLandmarkerOptions(
            base_options=self._base_options(model_asset_path=self._path),
            running_mode=mode,
            num_faces=MAX_FACES,
            output_face_blendshapes=True,
        )
        try:
            with _native_stderr_closed():
                landmarker = self._vision.FaceLandmarker.create_from_options(options)
                _open.add(landmarker)
                self._loaded.append(landmarker)
                if mode == self._vision.RunningMode.IMAGE:
                    landmarker.detect(self._image(np.zeros((64, 64, 3), np.uint8)))
        except OSError as error:
            raise _unloadable(error) from error
        except (RuntimeError, ValueError) as error:
            raise FeatureDetectionError(
                f"{self._path}: MediaPipe cannot use this model ({error}); is {ENVIRONMENT} right?"
            ) from error
        return landmarker

    def close(self) -> None:
        """Release MediaPipe's threads and memory. It is safe to call this twice."""
        for landmarker in self._loaded:
            _close(landmarker)

    def detect(self, frame: RgbdFrame) -> Features2D | None:
        """Find the features of the followed face in the next frame.

        If there are several faces, :class:`KeptFace` chooses. A face below about a twelfth of the image's width is too small
        for the detector. If no face is found in the whole image, the foreground of the depth image is therefore searched
        next, and then overlapping windows. A small face is followed in its own window. A stream is searched in one window
        per frame, so that it does not fall behind.

        Returns
        -------
        Features2D or None
            Features in pixels of the frame with their :func:`confidence`. None without a colour image or a face.
        """
        colour = frame.colour
        if colour is None:
            return None
        face = self._follow(frame, colour)
        if face is None:
            video = self._video
            faces = self.detect_faces(colour) if video is None else self._detect_stream(video, colour, frame.timestamp)
            faces = faces or self._in_foreground(colour, frame.depth)
            if faces:  # found, and followed, without a window
                return self._features(_choose(self._kept, faces, frame))
            face = _choose(self._kept, self._in_windows(colour, self._next()), frame)
        if face is not None:
            self._window = own_window(face.mesh, *colour.shape[:2])
        return self._features(face)

    def look(self, frame: RgbdFrame) -> Features2D | None:
        """Detect features as :meth:`detect` does, in a single picture, without using or changing the followed face."""
        colour = frame.colour
        if colour is None:
            return None
        faces = self.detect_faces(colour) or self._in_foreground(colour, frame.depth) or self._in_windows(colour, None)
        return self._features(_choose(KeptFace(), faces, frame))

    def forget(self) -> None:
        """Forget the followed face, so that the next picture may show another one."""
        self._kept, self._window = KeptFace(), None

    def _follow(self, frame: RgbdFrame, colour: np.ndarray) -> DetectedFace | None:
        """Find the kept face in its own window. If it is not there, drop the window and return None."""
        window, self._window = self._window, None
        if window is None or max(window[2] - colour.shape[1], window[3] - colour.shape[0]) > 0:
            return None
        faces = self._in_window(colour, window)
        return _choose(self._kept, faces, frame) if faces else None

    def _next(self) -> int | None:
        """Return the number of the window to search in a stream. It is None for single images, where all are searched."""
        self._turn += 1
        return self._turn if self._video else None

    def _in_windows(self, colour: np.ndarray, turn: int | None) -> list[DetectedFace]:
        windows = search_windows(*colour.shape[:2])
        for window in windows if turn is None else [windows[turn % len(windows)]]:
            faces = self._in_window(colour, window)
            if faces:
                return faces
        return []

    def _in_window(self, colour: np.ndarray, window: Window) -> list[DetectedFace]:
        u, v, right, bottom = window
        found = self.detect_faces(colour[v:bottom, u:right])
        return [replace(face, mesh=face.mesh + [u, v, 0]) for face in found]

    def _in_foreground(self, colour: np.ndarray, depth: np.ndarray) -> list[DetectedFace]:
        u, v, right, bottom = window = foreground_box(depth)
        return self._in_window(colour, window) if 0 < (right - u) * (bottom - v) < 0.6 * depth.size else []

    def _features(self, face: DetectedFace | None) -> Features2D | None:
        if face is None:
            return None
        return Features2D(feature_pixels(face.mesh), confidence(face.mesh, self._triangles), face)

    def detect_faces(self, colour: np.ndarray) -> list[DetectedFace]:
        """Find every face in an image.

        Parameters
        ----------
        colour : (H, W, 3) uint8 array
            An RGB image.

        Returns
        -------
        list of DetectedFace
            Landmarks in pixels, with their depth on the same scale, and scores.

        Notes
        -----
        MediaPipe's coordinate times the image's width counts from the centre of the first pixel, as ours do. This was
        measured: in images enlarged 4 times, the landmarks move by the 3/8 pixel that this convention implies.
        """
        return _in_pixels(self._landmarker.detect(self._image(colour)), colour.shape)

    def _detect_stream(self, video, colour: np.ndarray, timestamp: float) -> list[DetectedFace]:
        """Find faces as :meth:`detect_faces` does, in a stream's frame of ``timestamp`` seconds."""
        if self._video_size not in ((), colour.shape):  # MediaPipe stores the places of faces as shares of the image
            _close(video)
            self._loaded.remove(video)
            self._video = video = self._load(self._vision.RunningMode.VIDEO)
            self._clock = VideoClock()
        self._video_size = colour.shape
        found = video.detect_for_video(self._image(colour), self._clock.tick(timestamp))
        return _in_pixels(found, colour.shape)


def _choose(kept: KeptFace, faces: list[DetectedFace], frame: RgbdFrame) -> DetectedFace | None:
    mesh = kept.choose([face.mesh for face in faces], frame)
    return next((face for face in faces if face.mesh is mesh), None)


@lru_cache(maxsize=1)
def _places() -> np.ndarray:
    with as_file(files("adaptiveface") / "assets" / _PLACES) as path, np.load(path, allow_pickle=False) as data:
        return data["weights"].astype(float)


def feature_pixels(mesh: np.ndarray) -> np.ndarray:
    """Find the features on a face mesh. Each feature is a weighted mean of neighbouring landmarks.

    Parameters
    ----------
    mesh : (478, 3) array
        MediaPipe's landmarks, px.

    Returns
    -------
    (40, 2) array
        Places of the features, px.
    """
    places = _places()
    return places @ mesh[: places.shape[1], :2]


def _in_pixels(found, shape: tuple[int, ...]) -> list[DetectedFace]:
    scale = [shape[1], shape[0], shape[1]]
    meshes = [np.array([(point.x, point.y, point.z) for point in face]) * scale for face in found.face_landmarks]
    return [DetectedFace(mesh, _scores(face)) for mesh, face in zip(meshes, found.face_blendshapes, strict=True)]


def _scores(categories) -> np.ndarray:
    """Return the (51,) scores in the order of ``SCORE_NAMES``. A score that the model file does not give is 0."""
    found = {category.category_name: category.score for category in categories}
    return np.array([found.get(name, 0.0) for name in SCORE_NAMES])


def confidence(mesh: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Compute how far each feature can be trusted when the head is turned away.

    The detector guesses the far side of the face. On a rigid head, its error grows from 1.1 px where the skin faces the
    camera to 3.9 px where the skin faces away. The error of all features grows from 1.0 px to 6 px as the whole face turns
    to the profile. The confidence follows the inverse variance of both errors.

    Parameters
    ----------
    mesh : (478, 3) array
        MediaPipe's landmarks, px.
    triangles : (T, 3) array
        Triangles of its skin.

    Returns
    -------
    (40,) array
        Confidence of each feature, in [0, TRUST].
    """
    facing = -vertex_normals(mesh[: triangles.max() + 1], triangles)[MEDIAPIPE_INDICES, 2]
    own = np.clip((facing + 0.3) / 1.1, 0.0, 1.0)
    whole = np.clip((facing.mean() - 0.2) / 0.55, 0.0, 1.0)
    return TRUST * (own * whole) ** 2


def foreground_box(depth: np.ndarray) -> tuple[int, int, int, int]:
    """u_min, v_min, u_end, v_end of all that is within half a metre behind the nearest surface of ``depth`` (H, W), mm."""
    measured = depth > 0
    if not measured.any():
        return 0, 0, 0, 0
    near = measured & (depth < np.percentile(depth[measured], 2) + _FOREGROUND_MM)
    columns, rows = np.flatnonzero(near.any(axis=0)), np.flatnonzero(near.any(axis=1))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


@contextmanager
def _native_stderr_closed() -> Iterator[None]:
    """Silence the start-up notices of MediaPipe's libraries, which no setting turns off and which would bury our messages."""
    sys.stderr.flush()
    saved, sink = os.dup(2), os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(sink, 2)
        yield
    finally:
        os.dup2(saved, 2)
        os.close(saved)
        os.close(sink)


def _import_mediapipe():
    try:
        import mediapipe
        from mediapipe.tasks.python import BaseOptions, vision
    except ModuleNotFoundError as error:
        raise MissingExtraError(
            'detecting facial features needs MediaPipe: pip install "adaptiveface[landmarks]" '
            "(recordings with a features.csv work without it)"
        ) from error
    except (ImportError, OSError) as error:
        raise _unloadable(error) from error
    return mediapipe, vision, BaseOptions


def _unloadable(error: Exception) -> FeatureDetectionError:
    return FeatureDetectionError(f"MediaPipe is installed but cannot be loaded ({error}); {SYSTEM_LIBRARIES_HINT}")
