"""Every writer, ended at random moments by signals, on full disks and on read-only ones: what lies there afterwards.

``python tests/fault_runs.py --kill`` and ``--disk`` print the tables. The old file or the whole new one must be there, and
the exit status may be 0 only for the new one.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import random
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from recordings import SMALL, talking_head
from written import read_glb_animation, read_obj_sequence, read_usd

from adaptiveface.errors import AdaptiveFaceError
from adaptiveface.export import video
from adaptiveface.export.animation import AnimatedMesh
from adaptiveface.export.arkit_csv import read_arkit_csv, write_arkit_csv
from adaptiveface.export.gltf import write_glb
from adaptiveface.export.obj_sequence import write_obj_sequence
from adaptiveface.export.usd import write_usd
from adaptiveface.geometry.frame import FEATURE_IDS, Features2D, RgbdFrame
from adaptiveface.model.actor import Actor
from adaptiveface.model.face_model import embedded_face_model, load_face_model, save_face_model
from adaptiveface.pipeline import track_source
from adaptiveface.report import write_report
from adaptiveface.result import Result
from adaptiveface.retargeting.retarget import Performance
from adaptiveface.runtime.interrupt import orderly_end
from adaptiveface.sensors import Recording, RecordingWriter

SIGNALS = {"INT": signal.SIGINT, "TERM": signal.SIGTERM, "KILL": signal.SIGKILL}
_ENDING = {signal.SIGINT, signal.SIGTERM}
#: Longest that a writer may take, s.
LIMIT = 300.0


@dataclass(frozen=True)
class Writer:
    """``write(path, take)``: take 0 or 1, of which 1 is shorter; ``look(path)``: what the whole file holds, or it raises."""

    name: str
    write: Callable[[Path, int], None]
    look: Callable[[Path], object]


# ---- what is written -----------------------------------------------------------------------------------------------
def mesh(take: int) -> AnimatedMesh:
    rng, frames, vertices, shapes = np.random.default_rng(take), 12 - 4 * take, 1500, 4
    triangles = np.stack([np.arange(vertices - 2), np.arange(1, vertices - 1), np.arange(2, vertices)], axis=1).astype(np.int32)
    return AnimatedMesh(
        "head",
        rng.normal(0, 60, (vertices, 3)),
        triangles,
        tuple(f"shape{k}" for k in range(shapes)),
        rng.normal(0, 2, (shapes, vertices, 3)),
        rng.random((frames, shapes)),
        np.arange(frames) / 30,
        np.tile(np.eye(4), (frames, 1, 1)),
    )


def pictures(take: int) -> Iterator[np.ndarray]:
    rng = np.random.default_rng(take)
    for _ in range(30 - 10 * take):
        yield np.kron(rng.integers(0, 255, (20, 40, 3)), np.ones((8, 8, 1))).astype(np.uint8)


def performance(take: int) -> Performance:
    frames = 300 - 100 * take
    curves = np.random.default_rng(take).random((frames, 52))
    return Performance(curves, np.arange(frames) / 30, np.tile(np.eye(4), (frames, 1, 1)))


def film(path: Path) -> object:
    capture, means = cv2.VideoCapture(str(path)), []
    while True:
        found, picture = capture.read()
        if not found:
            break
        means.append(round(float(picture.mean())))
    if not means:
        raise ValueError("no picture can be decoded")
    return len(means), means[0], means[-1]


def with_opencv(path: Path, take: int) -> None:
    known, video.ffmpeg_program = video.ffmpeg_program, lambda: None
    try:
        video.write_video(path, pictures(take), 30.0)
    finally:
        video.ffmpeg_program = known


def digest(*arrays: np.ndarray) -> str:
    return hashlib.sha256(b"".join(np.ascontiguousarray(array, np.float32).tobytes() for array in arrays)).hexdigest()


def animation(read: Callable[[Path], AnimatedMesh]) -> Callable[[Path], object]:
    def look(path: Path) -> object:
        held = read(path)
        return len(held), digest(held.neutral, held.weights)

    return look


def whole_report(path: Path) -> object:
    text = path.read_text()
    if not text.rstrip().endswith("</html>"):
        raise ValueError("the page is cut off")
    return len(text)


def writers(folder: Path) -> list[Writer]:
    """All of them; ``folder`` for what some of them need."""
    actor = talking_head(folder / "take", 4)
    results = {0: track_source(Recording(folder / "take"), actor)}
    talking_head(folder / "short", 3)
    results[1] = track_source(Recording(folder / "short"), actor)
    model = embedded_face_model()

    def report(path: Path, take: int) -> None:
        made = write_report(results[take], None, actor, path.parent)
        assert made == path

    def rig(path: Path, take: int) -> None:
        Actor(**{**vars(actor), "neutral": actor.neutral + take}).save(path)

    def face_model(path: Path, take: int) -> None:
        save_face_model(path, type(model)(**{**vars(model), "mean": model.mean + take}))

    return [
        Writer("x.mp4", lambda p, take: video.write_video(p, pictures(take), 30.0), film),
        Writer("opencv.mp4", with_opencv, film),
        Writer("x.gif", lambda p, take: video.write_video(p, pictures(take), 15.0), film),
        Writer("obj", lambda p, take: write_obj_sequence(p, mesh(take)), lambda p: digest(read_obj_sequence(p)[0])),
        Writer("x.usdc", lambda p, take: write_usd(p, mesh(take)), animation(read_usd)),
        Writer("x.usda", lambda p, take: write_usd(p, mesh(take)), animation(read_usd)),
        Writer("x.usdz", lambda p, take: write_usd(p, mesh(take)), animation(read_usd)),
        Writer("x.glb", lambda p, take: write_glb(p, mesh(take)), animation(read_glb_animation)),
        Writer("x.csv", lambda p, take: write_arkit_csv(p, performance(take)), lambda p: digest(read_arkit_csv(p).curves)),
        Writer("page/report.html", report, whole_report),
        Writer("actor.npz", rig, lambda p: digest(Actor.load(p).neutral)),
        Writer("result.npz", lambda p, take: results[take].save(p), lambda p: digest(Result.load(p).vertices)),
        Writer("model.npz", face_model, lambda p: digest(load_face_model(p).mean)),
    ]


# ---- one run -------------------------------------------------------------------------------------------------------
def child(write: Callable[[], None], limit: int | None = None) -> int:
    """The process id of a copy of this process that writes and ends with 0, 2 for one of our errors, 3 for any other."""
    # A signal before the copy can handle it would end the copy as if it were this process, with its temporary folders.
    signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    process = os.fork()
    if process:
        signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
        return process
    status = 130
    try:
        try:
            status = _written(write, limit)
        finally:
            os._exit(status)
    finally:  # a signal between the two
        os._exit(status)


def _written(write: Callable[[], None], limit: int | None) -> int:
    try:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        if limit is not None:
            resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
        with orderly_end():
            signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
            write()
        return 0
    except AdaptiveFaceError:
        return 2
    except KeyboardInterrupt:
        return 130
    except BaseException:
        return 3


def ended(process: int) -> int:
    """Its exit status, -N for a signal; it is killed where it hangs."""
    deadline = time.monotonic() + LIMIT
    while time.monotonic() < deadline:
        found, status = os.waitpid(process, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.002)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    raise AssertionError(f"hangs for {LIMIT:g} s")


def judge(writer: Writer, path: Path, known: dict[int, object], status: int, parts: bool) -> str:
    """ "old", "new", or what is wrong; ``parts``: unfinished files may be left, under a name that says so."""
    try:
        held = writer.look(path)
    except Exception as error:
        return f"damaged ({type(error).__name__}: {str(error)[:60]})"
    state = {repr(known[0]): "old", repr(known[1]): "new"}.get(repr(held), "another")
    left = [p.name for p in path.parent.iterdir() if p != path]
    if left and not (parts and all(".part" in name or ".previous" in name for name in left)):
        return f"{state}, and {left} is left"
    if status == 0 and state != "new":
        return f"{state}, but the exit status is 0"
    if status == 3:
        return f"{state}, with a traceback"
    return state


def run(
    writer: Writer, fault: str, place: Path, old: Path, known: dict[int, object], seconds: float, size: int, rng: random.Random
) -> str:
    """Write take 1 over take 0 in ``place`` under a fault."""
    path = place / writer.name
    copy = shutil.copytree if old.is_dir() else shutil.copy2
    path.parent.mkdir(parents=True, exist_ok=True)
    copy(old, path)
    limit = None
    if fault == "disk" and os.geteuid():
        limit = rng.randrange(1, size)
    if fault == "read-only" and not os.geteuid():
        remount(place, "ro")
    elif fault == "read-only":
        path.parent.chmod(0o555)
    try:
        process = child(lambda: writer.write(path, 1), limit)
        if fault in SIGNALS:
            time.sleep(rng.uniform(0, 1.4 * seconds))
            with contextlib.suppress(ProcessLookupError):
                os.kill(process, SIGNALS[fault])
        status = ended(process)
    finally:
        if fault == "read-only" and not os.geteuid():
            remount(place, "rw")
        path.parent.chmod(0o755)
    if fault == "KILL":
        time.sleep(0.3)  # what it had started (ffmpeg) notices
    return judge(writer, path, known, status, parts=fault == "KILL")


def remount(place: Path, mode: str) -> None:
    subprocess.run(["mount", "-o", f"remount,{mode}", str(place)], check=True)


@contextmanager
def disk(folder: Path, kib: int | None) -> Iterator[Path]:
    """A new empty folder: where root runs this and ``kib`` is given, a disk of that size of its own."""
    place = Path(tempfile.mkdtemp(dir=folder))
    mounted = kib is not None and os.geteuid() == 0
    if mounted:
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={kib}k", "tmpfs", str(place)], check=True)
    try:
        yield place
    finally:
        if mounted:
            subprocess.run(["umount", str(place)], check=True)
        shutil.rmtree(place, ignore_errors=True)


def occupied(path: Path) -> int:
    """KiB that a file or folder takes on a disk, in pages of 4."""
    files = [path] if path.is_file() else [*path.iterdir()]
    return sum(4 * -(-file.stat().st_size // 4096) for file in files)


def table(faults: tuple[str, ...], runs: int, only: list[str] | None = None) -> int:
    """Print writer x fault; the number of outcomes that may not be."""
    bad = 0
    print(f"{'':<18}" + "".join(f"{fault:>16}" for fault in faults), flush=True)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for writer in writers(folder):
            if only and writer.name not in only:
                continue
            place = folder / f"of {writer.name.replace('/', ' ')}"
            paths = [place / str(take) / writer.name for take in (0, 1)]
            for take, path in enumerate(paths):
                path.parent.mkdir(parents=True)
                start = time.perf_counter()
                writer.write(path, take)
                seconds = time.perf_counter() - start
            known = {take: writer.look(path) for take, path in enumerate(paths)}
            assert repr(known[0]) != repr(known[1])
            size, cells = occupied(paths[1]), []
            for fault in faults:
                rng, counts = random.Random(f"{writer.name} {fault}"), Counter()
                for _ in range(runs):
                    free = rng.randrange(4, max(size, 8), 4) if fault == "disk" else 2 * size + 64
                    room = occupied(paths[0]) + free
                    with disk(folder, room if fault in ("disk", "read-only") else None) as where:
                        counts[run(writer, fault, where, paths[0], known, seconds, 1024 * size, rng)] += 1
                wrong = {state: count for state, count in counts.items() if state not in ("old", "new")}
                bad += sum(wrong.values())
                cells.append(f"{counts['old']} old, {counts['new']} new" + (f" {wrong}" if wrong else ""))
            print(f"{writer.name:<18}" + "".join(f"{cell:>16}" for cell in cells), flush=True)
    return bad


# ---- recordings, which grow ----------------------------------------------------------------------------------------
def frame(number: int) -> RgbdFrame:
    rng = np.random.default_rng(number)
    depth = np.full((SMALL.height, SMALL.width), 600.0, np.float32)
    colour = np.kron(rng.integers(0, 255, (24, 32, 3)), np.ones((10, 10, 1))).astype(np.uint8)
    seen = Features2D(rng.uniform(10, 200, (len(FEATURE_IDS), 2)), np.ones(len(FEATURE_IDS)))
    return RgbdFrame(depth, SMALL, colour, number, number / 30, seen)


def record(folder: Path, frames: int) -> None:
    """As the recorder does: tables first, then the images."""
    with RecordingWriter(folder, SMALL) as writer:
        for number in range(frames):
            writer.write(frame(number))


def judge_recording(folder: Path) -> str:
    """ "n frames" where every frame that reads has its features and its time, else what is wrong."""
    try:
        held = Recording(folder)
        frames = [*held]
    except AdaptiveFaceError as error:
        return "no frame yet" if not [*folder.glob("depth/*.png")] else f"cannot be read ({error})"
    for shot in frames:
        true = frame(shot.index)
        if shot.features is None or not np.allclose(shot.features.pixels, true.features.pixels, atol=1e-4):
            return f"frame {shot.index} of {len(held)} has no features, or others"
        if abs(shot.timestamp - true.timestamp) > 1e-5:
            return f"frame {shot.index} has the time {shot.timestamp}"
    return "whole" if len(frames) >= len(held) - 1 else f"{len(held) - len(frames)} frames are broken"


def recordings(faults: tuple[str, ...], runs: int) -> int:
    """Print what is left of a recording; the number of outcomes that may not be."""
    bad, cells = 0, []
    with tempfile.TemporaryDirectory() as name:
        for fault in faults:
            rng, counts = random.Random(fault), Counter()
            for _ in range(runs):
                room = rng.randrange(200, 4000) if fault == "disk" else 20_000
                with disk(Path(name), room if fault in ("disk", "read-only") else None) as place:
                    if fault == "read-only" and not os.geteuid():
                        remount(place, "ro")
                    process = child(lambda p=place: record(p / "rec", 200))
                    if fault in SIGNALS:
                        time.sleep(rng.uniform(0, 1.0))
                        with contextlib.suppress(ProcessLookupError):
                            os.kill(process, SIGNALS[fault])
                    ended(process)
                    counts[judge_recording(place / "rec")] += 1
            wrong = {state: count for state, count in counts.items() if state not in ("whole", "no frame yet")}
            bad += sum(wrong.values())
            cells.append(f"{counts['whole']} whole, {counts['no frame yet']} not begun" + (f" {wrong}" if wrong else ""))
    print("recording: " + "; ".join(f"{fault}: {cell}" for fault, cell in zip(faults, cells, strict=True)), flush=True)
    return bad


if __name__ == "__main__":
    sys.exit(table(("INT", "TERM", "KILL", "disk", "read-only"), 3))
