"""The 40 facial features of the method, detected by MediaPipe's FaceLandmarker on the colour image.

Measured on a real TrueDepth recording of a rigid head (poses from depth ICP, 56 frames around the front): single-image
mode lies 1.29 px from the truth, video mode 1.64 px because its smoothing lags behind the motion, at nearly the same
noise from frame to frame (0.55 and 0.51 px). MediaPipe smooths only where it looks for one face (``num_faces=1``). Where
it looks for several, video mode returns the very numbers of single-image mode (that recording and 240 frames of a
synthetic performer, bit for bit; the latter: 0.68 px without the constant part, no lag, against 0.90 px and a lag of a
third of a frame) in the same time, 7.4 ms a frame. So both modes here look for several faces, and one is kept.

Enlarging the image by 2 or 3 changed nothing (1.29, 1.28 px): the network resizes the face itself. Nor did lower
thresholds help in profile views: the few faces found beyond 65 degrees came with false ones.
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

#: Behind the nearest surface, this much depth (mm) is taken to be the person when the face is sought in a crop.
_FOREGROUND_MM = 500.0
#: Confidence of a feature seen from the front. The weights of the method are for features with 0.5 px of noise; those
#: detected here are 0.9 px (root mean square) off, mostly alike for a whole expression. The inverse ratio of variances.
TRUST = 0.3
#: Faces looked for in a picture; one would switch MediaPipe's smoothing on.
MAX_FACES = 3

#: Shares (40, 468) of MediaPipe's skin landmarks in each feature: its landmark of the same name lies up to 2 mm from the
#: model's feature, alike on every face. Made by ``data_synth/place_detected_features.py``.
_PLACES = "mediapipe_features.npz"

#: Landmarkers of MediaPipe that are not closed yet, and those whose detector is gone. MediaPipe's own finaliser waits for a
#: thread that the garbage collector may have ended already, then for ever: it must never find one open.
_open: set = set()
_abandoned: deque = deque()


@atexit.register  # earlier than the import of MediaPipe, hence run after its own handler, which makes closing quiet
def _close_all() -> None:
    _abandoned.extend(_open)
    _close_abandoned()


def _close_abandoned() -> None:
    """Not when a detector is collected, which may happen at any step, with locks held: when the next one is made."""
    with suppress(IndexError):  # none is left; several threads may be at it
        while True:
            _close(_abandoned.popleft())


def _close(landmarker) -> None:
    if landmarker in _open:
        _open.discard(landmarker)
        with suppress(RuntimeError):
            landmarker.close()


class FeatureDetector:
    """Finds the 40 features of :data:`adaptiveface.geometry.frame.FEATURE_IDS` in colour images, of one face that it keeps.

    ``video``: MediaPipe's video mode, for a live stream; otherwise single images. ``model_path`` names the model file,
    by default the one of :func:`face_landmarker_file`. Raises :class:`MissingExtraError` without mediapipe,
    :class:`FeatureDetectionError` when it or its model cannot be loaded.
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
        self._window: Window | None = None  # the kept face's own, where it is small
        self._turn = 0
        edges = vision.FaceLandmarksConnections.FACE_LANDMARKS_TESSELATION  # listed triangle by triangle
        self._triangles = np.array([edge.start for edge in edges], np.int32).reshape(-1, 3)

    def _load(self, mode):
        """A landmarker of MediaPipe in one of its running modes, with its threads started."""
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
        """Release MediaPipe's threads and memory; safe to call twice."""
        for landmarker in self._loaded:
            _close(landmarker)

    def detect(self, frame: RgbdFrame) -> Features2D | None:
        """Features in pixels of the frame with their :func:`confidence`; None without a colour image or without a face.

        Of several faces the one kept so far (see :class:`KeptFace`). Where the whole image shows no face, the
        foreground of the depth image or, without it, overlapping windows are searched again: a face below about a twelfth
        of the image's width is too small for the detector. It is then followed in a window of its own. A stream is
        searched window by window from frame to frame, so that it does not fall behind.
        """
        if frame.colour is None:
            return None
        face = self._follow(frame)
        if face is None:
            faces = self._detect_stream(frame) if self._video else self.detect_faces(frame.colour)
            faces = faces or self._in_foreground(frame)
            if faces:  # found as ever, and followed as ever
                return self._features(_choose(self._kept, faces, frame))
            face = _choose(self._kept, self._in_windows(frame, self._next()), frame)
        if face is not None:
            self._window = own_window(face.mesh, *frame.colour.shape[:2])
        return self._features(face)

    def look(self, frame: RgbdFrame) -> Features2D | None:
        """As :meth:`detect`, for one picture by itself: it neither knows nor remembers any other."""
        if frame.colour is None:
            return None
        faces = self.detect_faces(frame.colour) or self._in_foreground(frame) or self._in_windows(frame, None)
        return self._features(_choose(KeptFace(), faces, frame))

    def forget(self) -> None:
        """Forget the face that was kept: the next picture is free to show another."""
        self._kept, self._window = KeptFace(), None

    def _follow(self, frame: RgbdFrame) -> DetectedFace | None:
        """The kept face in its own window; None, and no window any more, where it is not there."""
        window, self._window = self._window, None
        if window is None or max(window[2] - frame.colour.shape[1], window[3] - frame.colour.shape[0]) > 0:
            return None
        faces = self._in_window(frame, window)
        return _choose(self._kept, faces, frame) if faces else None

    def _next(self) -> int | None:
        """Which window a stream is searched in this time; None: single images are searched in all of them."""
        self._turn += 1
        return self._turn if self._video else None

    def _in_windows(self, frame: RgbdFrame, turn: int | None) -> list[DetectedFace]:
        windows = search_windows(*frame.colour.shape[:2])
        for window in windows if turn is None else [windows[turn % len(windows)]]:
            faces = self._in_window(frame, window)
            if faces:
                return faces
        return []

    def _in_window(self, frame: RgbdFrame, window: Window) -> list[DetectedFace]:
        u, v, right, bottom = window
        found = self.detect_faces(frame.colour[v:bottom, u:right])
        return [replace(face, mesh=face.mesh + [u, v, 0]) for face in found]

    def _in_foreground(self, frame: RgbdFrame) -> list[DetectedFace]:
        u, v, right, bottom = window = foreground_box(frame.depth)
        return self._in_window(frame, window) if 0 < (right - u) * (bottom - v) < 0.6 * frame.depth.size else []

    def _features(self, face: DetectedFace | None) -> Features2D | None:
        if face is None:
            return None
        return Features2D(feature_pixels(face.mesh), confidence(face.mesh, self._triangles), face)

    def detect_faces(self, colour: np.ndarray) -> list[DetectedFace]:
        """Every face in ``colour`` (H, W, 3) uint8 RGB: landmarks in pixels with depth on their scale, and scores.

        MediaPipe's coordinate times the image's width counts from the first pixel's centre, as ours do (measured: in
        images enlarged 4 times they move by the 3/8 pixel that this convention implies).
        """
        return _in_pixels(self._landmarker.detect(self._image(colour)), colour.shape)

    def _detect_stream(self, frame: RgbdFrame) -> list[DetectedFace]:
        """As :meth:`detect_faces`, for the next frame of a stream."""
        if self._video_size not in ((), frame.colour.shape):  # where the faces were is stored as a share of the image
            _close(self._video)
            self._loaded.remove(self._video)
            self._video, self._clock = self._load(self._vision.RunningMode.VIDEO), VideoClock()
        self._video_size = frame.colour.shape
        found = self._video.detect_for_video(self._image(frame.colour), self._clock.tick(frame.timestamp))
        return _in_pixels(found, frame.colour.shape)


def _choose(kept: KeptFace, faces: list[DetectedFace], frame: RgbdFrame) -> DetectedFace | None:
    mesh = kept.choose([face.mesh for face in faces], frame)
    return next((face for face in faces if face.mesh is mesh), None)


@lru_cache(maxsize=1)
def _places() -> np.ndarray:
    with as_file(files("adaptiveface") / "assets" / _PLACES) as path, np.load(path, allow_pickle=False) as data:
        return data["weights"].astype(float)


def feature_pixels(mesh: np.ndarray) -> np.ndarray:
    """(40, 2) px: the model's features on MediaPipe's ``mesh`` (478, 3) px, each by its landmark and the ones next to it."""
    places = _places()
    return places @ mesh[: places.shape[1], :2]


def _in_pixels(found, shape: tuple[int, ...]) -> list[DetectedFace]:
    scale = [shape[1], shape[0], shape[1]]
    meshes = [np.array([(point.x, point.y, point.z) for point in face]) * scale for face in found.face_landmarks]
    return [DetectedFace(mesh, _scores(face)) for mesh, face in zip(meshes, found.face_blendshapes, strict=True)]


def _scores(categories) -> np.ndarray:
    """(51,) scores in the order of ``SCORE_NAMES``; 0 for one that the model file does not give."""
    found = {category.category_name: category.score for category in categories}
    return np.array([found.get(name, 0.0) for name in SCORE_NAMES])


def confidence(mesh: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """(40,) in [0, TRUST]: how far each feature of ``mesh`` (478, 3), pixels, can be trusted when the head is turned away.

    The detector guesses the far side. On a rigid head its error grows from 1.1 px where the skin faces the camera to
    3.9 px where it faces away, and on all features alike from 1.0 px to 6 px as the whole face turns to the profile;
    the confidence follows the inverse variance of both, and ends at ``TRUST``.
    """
    facing = -vertex_normals(mesh[: triangles.max() + 1], triangles)[MEDIAPIPE_INDICES, 2]
    own = np.clip((facing + 0.3) / 1.1, 0.0, 1.0)
    whole = np.clip((facing.mean() - 0.2) / 0.55, 0.0, 1.0)
    return TRUST * (own * whole) ** 2


def foreground_box(depth: np.ndarray) -> tuple[int, int, int, int]:
    """u_min, v_min, u_end, v_end of what lies within half a metre behind the nearest surface of ``depth`` (H, W) mm."""
    measured = depth > 0
    if not measured.any():
        return 0, 0, 0, 0
    near = measured & (depth < np.percentile(depth[measured], 2) + _FOREGROUND_MM)
    columns, rows = np.flatnonzero(near.any(axis=0)), np.flatnonzero(near.any(axis=1))
    return int(columns[0]), int(rows[0]), int(columns[-1]) + 1, int(rows[-1]) + 1


@contextmanager
def _native_stderr_closed() -> Iterator[None]:
    """MediaPipe's libraries print start-up notices that no setting turns off and that would bury our own messages."""
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
