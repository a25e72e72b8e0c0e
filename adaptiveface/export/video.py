"""Side-by-side video of the input, the tracked mesh and characters; no display needed."""

from __future__ import annotations

import errno
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

import cv2
import numpy as np

from ..camera import Camera
from ..errors import AdaptiveFaceError, FrameError
from ..files import replacing
from ..mesh import rotation_vector_matrix
from ..rendering import picture
from ..result import Result
from ..retargeting.character import Character
from ..retargeting.portrait import portrait
from ..sensors.capture_device import quiet
from .animation import CAMERA_TO_VIEW, AnimatedMesh
from .encoder import encode_h264, ffmpeg_program

PANEL = 480
#: Codecs of OpenCV's writer in the order of preference: VP9 plays in browsers, MPEG-4 everywhere else.
_FOURCC = ("vp09", "mp4v")

#: One panel: frame number -> (PANEL, PANEL, 3) uint8 RGB.
Panel = Callable[[int], np.ndarray]


def character_panel(mesh: AnimatedMesh) -> Panel:
    """The animated character with the head's rotation; it stays in the middle."""
    character = Character(mesh.name, mesh.neutral, mesh.triangles, (), np.zeros((0, *mesh.neutral.shape)), mesh.colours)

    def draw(frame: int) -> np.ndarray:
        """The character as it is turned in this frame."""
        rotation = CAMERA_TO_VIEW @ mesh.rigid[frame, :3, :3]
        return portrait(character, mesh.shape(frame), PANEL, rotation, rays=1)

    return draw


def turntable_panel(mesh: AnimatedMesh, degrees_per_frame: float = 2.0) -> Panel:
    """The animated character seen from a camera that circles it."""
    character = Character(mesh.name, mesh.neutral, mesh.triangles, (), np.zeros((0, *mesh.neutral.shape)), mesh.colours)

    def draw(frame: int) -> np.ndarray:
        """The character as the camera sees it from where it is in this frame."""
        turn = rotation_vector_matrix(np.array([0.0, np.radians(degrees_per_frame * frame), 0.0]))
        return portrait(character, mesh.shape(frame), PANEL, CAMERA_TO_VIEW @ turn, rays=1)

    return draw


def tracked_panel(result: Result) -> Panel:
    """The tracked mesh v4, seen by a camera that frames the whole performance."""
    middle = np.median(result.vertices[:, result.frontal].mean(axis=1), axis=0)
    spread = float(np.abs(result.vertices[:, result.frontal] - middle).max())
    focal = 0.46 * PANEL * middle[2] / max(spread, 1.0)
    centre = (PANEL - 1) / 2
    camera = Camera(PANEL, PANEL, focal, focal, centre, centre)
    shift = np.array([middle[0], middle[1], 0.0])
    return lambda frame: picture(camera, result.vertices[frame] - shift, result.triangles)


def input_panel(source, result: Result) -> Panel:
    """The colour picture of the source (its depth where there is no colour), cropped to the face."""
    camera = source.camera
    middle = np.median(result.vertices[:, result.frontal].mean(axis=1), axis=0)
    spread = float(np.abs(result.vertices[:, result.frontal] - middle).max())
    u, v = camera.project(middle)
    half = 1.15 * camera.fx * spread / middle[2]
    matrix = PANEL / (2 * half) * np.array([[1.0, 0.0, half - u], [0.0, 1.0, half - v]])

    def draw(frame: int) -> np.ndarray:
        """The cropped picture; black where the source has none."""
        try:
            shot = source.read(frame)
        except (FrameError, IndexError):
            return np.zeros((PANEL, PANEL, 3), np.uint8)
        image = shot.colour
        if image is None:
            near = np.clip((middle[2] + spread - shot.depth) / (2 * spread), 0, 1) * (shot.depth > 0)
            image = np.repeat((255 * near)[:, :, None].astype(np.uint8), 3, axis=2)
        return cv2.warpAffine(image, matrix, (PANEL, PANEL), flags=cv2.INTER_LINEAR)

    return draw


def side_by_side(panels: Sequence[Panel], labels: Sequence[str], frames: Iterable[int]) -> Iterable[np.ndarray]:
    """Frames (PANEL, n PANEL, 3) uint8 RGB with a label on every panel, for frame numbers."""
    for frame in frames:
        images = []
        for panel, label in zip(panels, labels, strict=True):
            image = np.ascontiguousarray(panel(frame))
            for colour, width in (((255, 255, 255), 3), ((40, 40, 40), 1)):
                cv2.putText(image, label, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, width, cv2.LINE_AA)
            images.append(image)
        yield np.hstack(images)


def write_video(path: str | Path, frames: Iterable[np.ndarray], fps: float) -> None:
    """Write RGB frames of one even size as ``.mp4`` or ``.gif``, whole or not at all.

    MP4 is H.264 where ``imageio-ffmpeg`` is installed (extra ``video``), else what OpenCV can write. Raises
    :class:`AdaptiveFaceError` when there is no frame or no encoder, when the encoder fails, or when the disk is full.
    """
    path = Path(path)
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise AdaptiveFaceError(f"{path}: no frames, no video")
    write = _write_gif if path.suffix.lower() == ".gif" else _write_mp4
    with replacing(path) as temporary:
        write(temporary, path, itertools.chain([first], frames), fps)


def _write_gif(temporary: Path, path: Path, frames: Iterable[np.ndarray], fps: float) -> None:
    from PIL import Image

    step = max(1, round(fps / 15))  # GIF counts hundredths of a second; 15 frames a second keep it small
    kept = itertools.islice(frames, 0, None, step)
    images = [Image.fromarray(cv2.resize(f, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)) for f in kept]
    images[0].save(temporary, save_all=True, append_images=images[1:], duration=round(1000 * step / fps), loop=0)


def _write_mp4(temporary: Path, path: Path, frames: Iterator[np.ndarray], fps: float) -> None:
    first = next(frames)
    given = 0

    def counted() -> Iterator[np.ndarray]:
        nonlocal given
        for frame in itertools.chain([first], frames):
            given += 1
            yield frame

    size = (first.shape[1], first.shape[0])
    program = ffmpeg_program()
    try:
        if program is not None:
            encode_h264(program, temporary, counted(), size, fps)
        else:
            _write_opencv(temporary, counted(), size, fps)
    except AdaptiveFaceError as error:
        raise AdaptiveFaceError(f"{path}: {error}") from error
    written = _frames_in(temporary)
    if written < given:  # OpenCV's encoder does not say that the disk is full
        raise OSError(errno.EIO, f"{written} of {given} frames arrived in the file; is the disk full?")


def _write_opencv(temporary: Path, frames: Iterable[np.ndarray], size: tuple[int, int], fps: float) -> None:
    for fourcc in _FOURCC:
        writer = cv2.VideoWriter(str(temporary), cv2.VideoWriter_fourcc(*fourcc), fps, size)
        if writer.isOpened():
            break
    else:
        raise AdaptiveFaceError("OpenCV has no encoder for it: python -m pip install 'adaptiveface[video]'")
    try:
        for frame in frames:
            writer.write(frame[:, :, ::-1])
    finally:
        writer.release()


def _frames_in(path: Path) -> int:
    """How many pictures a finished film says that it holds; 0 where it cannot be played."""
    with quiet():
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if capture.isOpened() and capture.grab() else 0
        capture.release()
    return count
