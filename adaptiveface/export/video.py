"""Write a video of the input, the tracked mesh and characters, side by side. It needs no display."""

from __future__ import annotations

import errno
import itertools
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from pathlib import Path

import cv2
import numpy as np
from tqdm import tqdm

from ..errors import AdaptiveFaceError, FrameError
from ..files import release, replacing
from ..geometry.camera import Camera
from ..geometry.mesh import rotation_vector_matrix, transform_points
from ..geometry.painting import lit, paint
from ..geometry.source import Abilities
from ..insides import Insides
from ..result import Result
from ..retargeting.character import Character
from ..retargeting.portrait import SKIN, painted_portrait
from ..runtime.timing import film_frames, gif_frames
from ..sensors.capture_device import quiet
from .animation import CAMERA_TO_VIEW, AnimatedMesh
from .encoder import encode_h264, ffmpeg_program

PANEL = 480
#: How many frames a panel is drawn ahead.
AHEAD = 6
#: Codecs of OpenCV's writer in the order of preference: VP9 plays in browsers, MPEG-4 everywhere else.
_FOURCC = ("vp09", "mp4v")

#: One panel: frame number -> (PANEL, PANEL, 3) uint8 RGB.
Panel = Callable[[int], np.ndarray]
#: How long each frame of a GIF is shown, ms.
Delays = Sequence[int] | np.ndarray


def character_panel(mesh: AnimatedMesh) -> Panel:
    """The animated character with the head's rotation, in the middle of the panel."""
    character = _still(mesh)
    return lambda frame: painted_portrait(character, mesh.shape(frame), PANEL, CAMERA_TO_VIEW @ mesh.head_pose[frame, :3, :3])


def turntable_panel(mesh: AnimatedMesh, degrees_per_frame: float = 2.0) -> Panel:
    """The animated character seen from a camera that circles it."""
    character = _still(mesh)

    def draw(frame: int) -> np.ndarray:
        """The character, seen from the camera's position in this frame."""
        turn = rotation_vector_matrix(np.array([0.0, np.radians(degrees_per_frame * frame), 0.0]))
        return painted_portrait(character, mesh.shape(frame), PANEL, CAMERA_TO_VIEW @ turn)

    return draw


def _still(mesh: AnimatedMesh) -> Character:
    return Character(mesh.name, mesh.neutral, mesh.triangles, (), np.zeros((0, *mesh.neutral.shape)), mesh.colours)


def tracked_panel(result: Result, insides: Insides | None = None) -> Panel:
    """The tracked mesh v4 and its inside parts, seen by a camera that frames the whole performance."""
    middle, spread = _framing(result)
    focal = 0.46 * PANEL * middle[2] / max(spread, 1.0)
    centre = (PANEL - 1) / 2
    camera = Camera(PANEL, PANEL, focal, focal, centre, centre)
    shift = np.array([middle[0], middle[1], 0.0])
    triangles, albedo = np.ascontiguousarray(result.triangles, np.int64), np.array(SKIN, float)
    if insides is not None:
        albedo = np.concatenate([np.tile(albedo, (result.vertices.shape[1], 1)), insides.colours])
        triangles = np.concatenate([triangles, insides.triangles + result.vertices.shape[1]])

    def draw(frame: int) -> np.ndarray:
        """The mesh of this frame."""
        points = result.vertices[frame] - shift
        if insides is not None:
            pose = result.head_pose[frame].astype(float)
            gaze = None if result.gaze is None else result.gaze[frame].astype(float)
            skin = result[frame].head_vertices
            points = np.concatenate([points, transform_points(pose, insides.at(skin, gaze)) - shift])
        release(result.vertices)
        return paint(camera, points, triangles, lit(points, triangles, albedo), cull=True)

    return draw


def input_panel(source, result: Result) -> Panel:
    """The colour picture of the source, or its depth if it has no colour, cropped to the face."""
    camera = source.camera
    middle, spread = _framing(result)
    u, v = camera.project(middle)
    half = 1.15 * camera.fx * spread / middle[2]
    matrix = PANEL / (2 * half) * np.array([[1.0, 0.0, half - u], [0.0, 1.0, half - v]])
    read_colour = Abilities.of(source).read_colour  # the depth would not be shown

    def draw(frame: int) -> np.ndarray:
        """The cropped picture, which is black if the source has none."""
        try:
            image = read_colour(frame)
            if image is None:
                shot = source.read(frame)
                image = _nearness(shot.depth, middle[2] + spread, 2 * spread) if shot.colour is None else shot.colour
        except (FrameError, IndexError):
            return np.zeros((PANEL, PANEL, 3), np.uint8)
        return cv2.warpAffine(image, matrix, (PANEL, PANEL), flags=cv2.INTER_LINEAR)

    return draw


def _nearness(depth: np.ndarray, farthest: float, extent: float) -> np.ndarray:
    """A grey picture (H, W, 3) uint8 that is brighter where ``depth`` (H, W) is nearer, and black without a measurement."""
    near = np.clip((farthest - depth) / extent, 0, 1) * (depth > 0)
    return np.repeat((255 * near)[:, :, None].astype(np.uint8), 3, axis=2)


def _framing(result: Result) -> tuple[np.ndarray, float]:
    """The middle (3,) of the face in the camera frame, mm, and how far the face reaches from there, mm."""
    frontal = np.flatnonzero(result.frontal)
    some = result.vertices[:: max(1, len(result) // 300)][:, frontal]
    middle = np.median(some.mean(axis=1), axis=0)
    return middle, float(np.abs(some - middle).max())


def side_by_side(panels: Sequence[Panel], labels: Sequence[str], frames: Iterable[int]) -> Generator[np.ndarray]:
    """Yield pictures (PANEL, n PANEL, 3) uint8 RGB of given frame numbers, with a label on every panel.

    A separate thread draws each panel, in order and a few frames ahead. A frame that is repeated is drawn once.
    """
    with ExitStack() as stack:
        threads = [stack.enter_context(ThreadPoolExecutor(1, "panel")) for _ in panels]
        waiting: deque[tuple[list, int]] = deque()
        try:
            for frame, group in itertools.groupby(frames):
                drawn = [
                    thread.submit(_labelled, panel, label, frame)
                    for thread, panel, label in zip(threads, panels, labels, strict=True)
                ]
                waiting.append((drawn, sum(1 for _ in group)))
                if len(waiting) > AHEAD:
                    yield from _joined(*waiting.popleft())
            while waiting:
                yield from _joined(*waiting.popleft())
        finally:
            for thread in threads:
                thread.shutdown(wait=False, cancel_futures=True)


def _labelled(panel: Panel, label: str, frame: int) -> np.ndarray:
    image = np.ascontiguousarray(panel(frame))
    for colour, width in (((255, 255, 255), 3), ((40, 40, 40), 1)):
        cv2.putText(image, label, (10, 24), cv2.FONT_HERSHEY_SIMPLEX, 0.6, colour, width, cv2.LINE_AA)
    return image


def _joined(drawn: list, times: int) -> Iterator[np.ndarray]:
    yield from itertools.repeat(np.hstack([panel.result() for panel in drawn]), times)


def write_film(path: str | Path, panels: Sequence[Panel], labels: Sequence[str], timestamps: np.ndarray, step: int = 1) -> None:
    """Film every ``step``-th frame of a take, with the panels side by side.

    The film is as long as the take. In gaps of the take, ``.mp4`` repeats frames, and ``.gif`` shows them longer. Raises what
    :func:`write_video` raises.

    Parameters
    ----------
    path : path-like
        The ``.mp4`` or ``.gif`` file.
    panels, labels : sequence
        The panels and the text on each.
    timestamps : (F,)
        Increasing times of the frames, s.
    step : int
        Only every ``step``-th frame is shown.
    """
    times = np.asarray(timestamps, float)[::step]
    if Path(path).suffix.lower() == ".gif":
        shown, delays = gif_frames(times)
        rate = 1000.0 * len(shown) / delays.sum()
    else:
        (rate, shown), delays = film_frames(times), None
    with tqdm(total=len(shown), desc=Path(path).name, unit="frame", disable=None) as bar:
        write_video(path, _counted(side_by_side(panels, labels, step * shown), bar), rate, delays)


def _counted(frames: Generator[np.ndarray], bar: tqdm) -> Iterator[np.ndarray]:
    with closing(frames):
        for frame in frames:
            bar.update()
            yield frame


def write_video(path: str | Path, frames: Iterable[np.ndarray], fps: float, delays: Delays | None = None) -> None:
    """Write a film, whole or not at all.

    MP4 is H.264 if ``imageio-ffmpeg`` (the extra ``video``) is installed. Otherwise, it has one of OpenCV's codecs.

    Parameters
    ----------
    path : path-like
        The ``.mp4`` or ``.gif`` file.
    frames : iterable of (H, W, 3) uint8
        RGB pictures of the same even size.
    fps : float
        Frames per second.
    delays : (F,), optional
        How long a GIF shows each frame, ms. Without them, a GIF shows at most 15 of the ``fps`` frames per second.

    Raises
    ------
    AdaptiveFaceError
        There is no frame or no encoder, the encoder fails, or the disk is full.
    """
    path = Path(path)
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise AdaptiveFaceError(f"{path}: no frames, no video")
    frames = itertools.chain([first], frames)
    with replacing(path) as temporary:
        if path.suffix.lower() == ".gif":
            _write_gif(temporary, frames, fps, delays)
        else:
            _write_mp4(temporary, path, frames, fps)


def _write_gif(temporary: Path, frames: Iterable[np.ndarray], fps: float, delays: Delays | None) -> None:
    from PIL import Image

    images = [Image.fromarray(cv2.resize(f, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)) for f in frames]
    if delays is None:
        shown, delays = gif_frames(np.arange(len(images)) / fps)
        images = [images[k] for k in shown]
    durations = [int(delay) for delay in delays]
    images[0].save(temporary, save_all=True, append_images=images[1:], duration=durations, loop=0)


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
        writer = cv2.VideoWriter(str(temporary), cv2.VideoWriter.fourcc(*fourcc), fps, size)
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
    """The number of pictures in a finished film; 0 if it cannot be played."""
    with quiet():
        capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        count = int(capture.get(cv2.CAP_PROP_FRAME_COUNT)) if capture.isOpened() and capture.grab() else 0
        capture.release()
    return count
