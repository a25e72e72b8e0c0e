"""Files and streams that mean harm: what each command makes of them, how long it takes and how much memory.

Every input goes through the command line in a process of its own, which has imported everything first: only what the input
causes is counted. ``python tests/fault_runs.py --hostile`` prints the table.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import resource
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np

#: A hostile input is refused within this time and memory, s and MiB.
SECONDS, MEBIBYTES = 2.0, 300
#: Longest that one may take before it counts as hanging, s.
LIMIT = 300.0
MANY = 10_000_000


@dataclass(frozen=True)
class Measured:
    """What came of an input: exit status (None: it hung), s, MiB, and what was said."""

    status: int | None
    seconds: float
    mebibytes: float
    message: str

    @property
    def good(self) -> bool:
        """Refused with one line, within time and memory."""
        bounded = self.seconds <= SECONDS and self.mebibytes <= MEBIBYTES
        return self.status == 2 and bounded and self.message.count("\n") == 1 and "Traceback" not in self.message


Make = Callable[[Path], list[str]]


# ---- recordings ----------------------------------------------------------------------------------------------------
def recording(spoil: Callable[[Path], None]) -> Make:
    """``capture`` of a recording that was spoiled."""

    def make(folder: Path) -> list[str]:
        shutil.copytree(folder.parent / "take", folder / "take")
        spoil(folder / "take")
        return ["capture", str(folder / "take"), "--out", str(folder / "actor.npz")]

    return make


def fifo(name: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / name
        path.unlink(missing_ok=True)
        os.mkfifo(path)

    return spoil


def endless(name: str) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / name
        path.unlink(missing_ok=True)
        path.symlink_to("/dev/zero")

    return spoil


def text(name: str, content: str | bytes | Callable[[], bytes]) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        data = content() if callable(content) else content
        (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)

    return spoil


def sparse(name: str, size: int) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        with open(folder / name, "wb") as stream:
            stream.truncate(size)

    return spoil


def intrinsics(**values) -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        path = folder / "intrinsic.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | values).replace('"HUGE"', "9" * 400))

    return spoil


def images(name: str, make: Callable[[], bytes]) -> Callable[[Path], None]:
    """The same spoiled image for every frame."""

    def spoil(folder: Path) -> None:
        content = make()
        for path in (folder / name).iterdir():
            path.unlink()
            path.write_bytes(content)

    return spoil


def every(name: str, spoil: Callable[[str], Callable[[Path], None]]) -> Callable[[Path], None]:
    def spoil_all(folder: Path) -> None:
        for path in [*(folder / name).iterdir()]:
            spoil(f"{name}/{path.name}")(folder)

    return spoil_all


def png(width: int, height: int, depth: int = 16, colour: int = 0) -> bytes:
    """A whole PNG of zeros of any size: a few hundred kilobytes."""
    row = 1 + width * (depth // 8) * (3 if colour == 2 else 1)
    packer, body = zlib.compressobj(9), bytearray()
    zeros = bytes(row)
    for _ in range(height):
        body += packer.compress(zeros)
    body += packer.flush()

    def chunk(kind: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, depth, colour, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", bytes(body)) + chunk(b"IEND", b"")


def jpeg(width: int, height: int) -> bytes:
    from PIL import Image

    buffer = io.BytesIO()
    Image.new("RGB", (width, height), (90, 120, 150)).save(buffer, "JPEG", quality=5)
    return buffer.getvalue()


def rows(line: str, header: str, ending: str = "\n") -> Callable[[], bytes]:
    return lambda: (header + ending + (line + ending) * MANY).encode()


# ---- archives ------------------------------------------------------------------------------------------------------
def zipped(path: Path, *members: tuple[str, bytes | int], compression: int = zipfile.ZIP_DEFLATED) -> Path:
    """An archive of members; a number stands for so many zeros."""
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name, content in members:
            with archive.open(name, "w", force_zip64=True) as stream:
                if isinstance(content, bytes):
                    stream.write(content)
                    continue
                for _ in range(content >> 20):
                    stream.write(bytes(1 << 20))
    return path


def npy(shape: tuple[int, ...], kind: str = "<f4", data: bytes = b"") -> bytes:
    """The header of an array of any shape, and as much data as is given."""
    text_ = f"{{'descr': {kind!r}, 'fortran_order': False, 'shape': {shape!r}, }}".encode()
    text_ += b" " * (-(len(text_) + 11) % 64) + b"\n"
    return b"\x93NUMPY\1\0" + struct.pack("<H", len(text_)) + text_ + data


def actor(*members: tuple[str, bytes | int], compression: int = zipfile.ZIP_DEFLATED) -> Make:
    def make(folder: Path) -> list[str]:
        given = zipped(folder / "given.npz", *members, compression=compression)
        return ["track", str(folder.parent / "take"), "--actor", str(given), "--out", str(folder / "r.npz")]

    return make


def actor_file(spoil: Callable[[Path], None]) -> Make:
    def make(folder: Path) -> list[str]:
        spoil(folder)
        return ["track", str(folder.parent / "take"), "--actor", str(folder / "given.npz"), "--out", str(folder / "r.npz")]

    return make


def result(spoil: Callable[[Path], None]) -> Make:
    def make(folder: Path) -> list[str]:
        spoil(folder)
        return ["export", str(folder / "given.npz"), "--format", "glb", "--out", str(folder / "x.glb")]

    return make


def many_members(path: Path, names: Callable[[int], str], count: int) -> None:
    """An archive whose list of members is all there is: every entry points at the same empty one."""
    local = struct.pack("<4sHHHHHIIIHH", b"PK\3\4", 20, 0, 0, 0, 0, 0, 0, 0, 1, 0) + b"a"
    entries = bytearray()
    for number in range(count):
        name = names(number).encode()
        entries += struct.pack("<4s2H20xH16x", b"PK\1\2", 20, 20, len(name)) + name
    end = struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, count & 0xFFFF, count & 0xFFFF, len(entries), len(local), 0)
    path.write_bytes(local + entries + end)


def lying_size(folder: Path) -> None:
    """An uncompressed member that the list of members makes a GiB long."""
    path = zipped(folder / "given.npz", ("neutral.npy", npy((90_000_000, 3))), compression=zipfile.ZIP_STORED)
    data = bytearray(path.read_bytes())
    at = data.rfind(b"PK\1\2")
    data[at + 20 : at + 28] = struct.pack("<II", 1_080_000_128, 1_080_000_128)
    path.write_bytes(data)


def r3d(metadata: object, *members: tuple[str, bytes | int]) -> Make:
    def make(folder: Path) -> list[str]:
        content = metadata if isinstance(metadata, (bytes, int)) else json.dumps(metadata).encode()
        zipped(folder / "given.r3d", ("metadata", content), *members)
        return ["capture", str(folder / "given.r3d"), "--out", str(folder / "actor.npz")]

    return make


def r3d_file(spoil: Callable[[Path], None]) -> Make:
    def make(folder: Path) -> list[str]:
        spoil(folder)
        return ["capture", str(folder / "given.r3d"), "--out", str(folder / "actor.npz")]

    return make


R3D = {"w": 480, "h": 640, "dw": 480, "dh": 640, "K": [500, 0, 0, 0, 500, 0, 240, 320, 1], "fps": 30}


# ---- characters ----------------------------------------------------------------------------------------------------
def character(name: str, spoil: Callable[[Path], None]) -> Make:
    """``export`` of a good result with a spoiled character."""

    def make(folder: Path) -> list[str]:
        spoil(folder)
        out = ["--format", "glb", "--out", str(folder / "x.glb")]
        return ["export", str(folder.parent / "result.npz"), "--character", str(folder / name), *out]

    return make


def obj(neutral: Callable[[], bytes]) -> Make:
    def spoil(folder: Path) -> None:
        (folder / "head").mkdir()
        (folder / "head" / "neutral.obj").write_bytes(neutral())
        (folder / "head" / "jawOpen.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\n")

    return character("head", spoil)


VERTICES = b"v 0 0 0\nv 100 0 0\nv 0 150 0\n"


def glb(document: object, binary: bytes = b"") -> Callable[[Path], None]:
    def spoil(folder: Path) -> None:
        body = document if isinstance(document, bytes) else json.dumps(document).encode()
        body += b" " * (-len(body) % 4)
        chunks = struct.pack("<I4s", len(body), b"JSON") + body
        if binary:
            chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
        (folder / "c.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)

    return spoil


def gltf(accessors: list[dict], views: list[dict] | None = None, buffers: list[dict] | None = None, targets: int = 1) -> dict:
    """A document of one mesh whose first accessor is the positions, the others its targets."""
    shapes = [{"POSITION": k % len(accessors)} for k in range(targets)]
    primitive = {"attributes": {"POSITION": 0}, "targets": shapes}
    names = {"targetNames": [f"jawOpen{k or ''}" for k in range(targets)]}
    return {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "accessors": accessors,
        "meshes": [{"primitives": [primitive], "extras": names}],
        "bufferViews": views or [],
        "buffers": buffers or [],
    }


def beside(uri: str) -> dict:
    accessor = [{"componentType": 5126, "type": "VEC3", "count": 300, "bufferView": 0}]
    return gltf(accessor, [{"buffer": 0, "byteLength": 3600}], [{"byteLength": 3600, "uri": uri}])


def beside_pipe(folder: Path) -> None:
    os.mkfifo(folder / "b.bin")
    glb(beside("b.bin"))(folder)


def beside_endless(folder: Path) -> None:
    (folder / "b.bin").symlink_to("/dev/zero")
    glb(beside("b.bin"))(folder)


def take_csv(content: str | bytes | Callable[[], bytes]) -> Make:
    def make(folder: Path) -> list[str]:
        text("take.csv", content)(folder)
        return ["export", str(folder / "take.csv"), "--character", "hag", "--out", str(folder / "x.glb")]

    return make


# ---- videos and network cameras ------------------------------------------------------------------------------------
def video(spoil: Callable[[Path], None], name: str) -> Make:
    def make(folder: Path) -> list[str]:
        spoil(folder)
        return ["capture", str(folder / name), "--out", str(folder / "actor.npz")]

    return make


def large_film(folder: Path) -> None:
    """An AVI of one frame: a JPEG of 16,000 x 16,000 pixels."""
    import imageio_ffmpeg

    (folder / "p.jpg").write_bytes(jpeg(16_000, 16_000))
    program, given = imageio_ffmpeg.get_ffmpeg_exe(), str(folder / "p.jpg")
    options = ["-loglevel", "error", "-framerate", "25", "-f", "image2", "-i", given, "-c", "copy"]
    subprocess.run([program, *options, str(folder / "v.avi")], check=True)


def camera(send: Callable[[Callable[[bytes], None]], None], kind: str = "multipart/x-mixed-replace; boundary=frame") -> Make:
    """``live`` on a network camera that sends what it likes, on this machine, until the command ends."""

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):  # noqa: N802 - the library's name
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.end_headers()
            with contextlib.suppress(OSError):
                send(self.wfile.write)

        def log_message(self, *_):
            pass

    def make(folder: Path) -> list[str]:
        server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        with contextlib.suppress(StopIteration):
            send(stop)  # what is sent is made before the clock starts
        return ["live", f"webcam:http://127.0.0.1:{server.server_address[1]}/v", "--headless", "--seconds", "5"]

    return make


def stop(_: bytes) -> None:
    raise StopIteration


def part(content: bytes, length: int | None = None) -> bytes:
    head = b"--frame\r\nContent-Type: image/jpeg\r\n"
    return head + (b"" if length is None else b"Content-Length: %d\r\n" % length) + b"\r\n" + content + b"\r\n"


def repeat(*contents: Callable[[], bytes] | bytes, times: int = 10_000) -> Callable[[Callable[[bytes], None]], None]:
    made = lru_cache(lambda: [content() if callable(content) else content for content in contents])

    def send(write: Callable[[bytes], None]) -> None:
        data = made()
        for number in range(times):
            write(data[min(number, len(data) - 1)])

    return send


HEADER_OF_TAKE = "Timecode,BlendShapeCount,EyeBlinkLeft"
CASES: dict[str, Make] = {
    "timestamps.csv is a pipe": recording(fifo("timestamps.csv")),
    "timestamps.csv links to /dev/zero": recording(endless("timestamps.csv")),
    "timestamps.csv of 10^7 rows": recording(text("timestamps.csv", rows("0,0.0", "frame,timestamp"))),
    "timestamps.csv of 10^7 rows, old line ends": recording(text("timestamps.csv", rows("0,0.0", "frame,timestamp", "\r"))),
    "timestamps.csv of one endless line": recording(text("timestamps.csv", "frame,timestamp\n" + "0" * 40_000_000)),
    "a timestamp of 1e300": recording(text("timestamps.csv", "frame,timestamp\n0,1e300\n1,2e300\n")),
    "a timestamp of 400 digits": recording(text("timestamps.csv", "frame,timestamp\n0," + "9" * 400 + "\n")),
    "features.csv is a pipe": recording(fifo("features.csv")),
    "features.csv links to /dev/zero": recording(endless("features.csv")),
    "features.csv of 10^7 rows": recording(text("features.csv", rows("0,48,1,1,1", "frame,feature,u,v,confidence"))),
    "features.csv of 20 GiB, sparse": recording(sparse("features.csv", 20 << 30)),
    "intrinsics.csv is a pipe": recording(fifo("intrinsics.csv")),
    "intrinsics.csv of 10^7 rows": recording(text("intrinsics.csv", rows("0,9,9,9,9", "frame,fx,fy,cx,cy"))),
    "intrinsic.json is a pipe": recording(fifo("intrinsic.json")),
    "intrinsic.json links to /dev/zero": recording(endless("intrinsic.json")),
    "intrinsic.json of 4 GiB, sparse": recording(sparse("intrinsic.json", 4 << 30)),
    "intrinsic.json nested 100,000 deep": recording(text("intrinsic.json", "[" * 100_000)),
    "intrinsic.json [[],[],...": recording(text("intrinsic.json", "[" + "[]," * 300_000 + "[]]")),
    "a width of 1e308": recording(intrinsics(width=1e308)),
    "a width of 400 digits": recording(intrinsics(width="HUGE")),
    "a focal length of 1e308": recording(intrinsics(intrinsic_matrix=[1e308, 0, 0, 0, 1e308, 0, 1e308, 0, 1])),
    "depth PNGs of 16,000 x 16,000": recording(images("depth", lambda: png(16_000, 16_000))),
    "depth PNGs as the calibration says": recording(
        lambda folder: (images("depth", lambda: png(16_000, 16_000))(folder), intrinsics(width=16_000, height=16_000)(folder))
    ),
    "depth images are pipes": recording(every("depth", fifo)),
    "depth images link to /dev/zero": recording(every("depth", endless)),
    "depth images of 10 GiB, sparse": recording(every("depth", lambda name: sparse(name, 10 << 30))),
    "a frame number of nine digits": recording(lambda folder: (folder / "depth" / "999999999.png").write_bytes(b"")),
    ".r3d: metadata [[],[],...": r3d(b'{"K":[' + b"[]," * 20_000_000 + b"[]]}"),
    ".r3d: metadata of a GiB of zeros": r3d(1 << 30),
    ".r3d: metadata nested 10^6 deep": r3d(b"[" * 1_000_000),
    ".r3d: 10^6 members": r3d_file(lambda f: many_members(f / "given.r3d", "rgbd/{}.depth".format, 1_000_000)),
    ".r3d: a depth image of a GiB of zeros": r3d(R3D, ("rgbd/0.depth", 1 << 30)),
    ".r3d: sides of 10^9": r3d(R3D | {"dw": 10**9, "w": 10**9}, ("rgbd/0.depth", b"")),
    ".r3d is 30 GiB, sparse": r3d_file(sparse("given.r3d", 30 << 30)),
    ".npz promises a GiB": actor(("neutral.npy", npy((90_000_000, 3)))),
    ".npz promises 10^18 bytes": actor(("neutral.npy", npy((10**17, 3)))),
    ".npz of a GiB of zeros": actor(("neutral.npy", npy((89_478_485, 3)) + bytes(60)), ("blendshapes.npy", 1 << 30)),
    ".npz whose zeros fit its header": actor_file(
        lambda f: np.savez_compressed(f / "given.npz", neutral=np.zeros((90_000_000, 3), np.float32))
    ),
    ".npz with a lie in its list": actor_file(lying_size),
    ".npz of 10^6 members": actor_file(lambda f: many_members(f / "given.npz", "a{}".format, 1_000_000)),
    ".npz whose shape is nested": actor(("neutral.npy", npy((1,)).replace(b"(1,)", b"(" * 60))),
    ".npz of Python objects": actor(("neutral.npy", npy((1, 3), "|O"))),
    ".npz is a pipe": actor_file(fifo("given.npz")),
    ".npz links to /dev/zero": actor_file(endless("given.npz")),
    ".npz is 10 GiB, sparse": actor_file(sparse("given.npz", 10 << 30)),
    "result.npz promises 8 GiB": result(lambda f: zipped(f / "given.npz", ("vertices.npy", npy((100_000, 7000, 3))))),
    "result.npz of zeros for 8 GiB": result(
        lambda f: zipped(f / "given.npz", ("vertices.npy", npy((13_000, 7000, 3)) + bytes(1 << 20)), ("x.npy", 1 << 30))
    ),
    "character.npz of 10^6 vertices and 1000 shapes": character(
        "c.npz",
        lambda f: np.savez_compressed(
            f / "c.npz",
            neutral=np.zeros((1_000_000, 3), np.float32),
            triangles=np.zeros((1, 3), np.uint32),
            moving=np.zeros(1, np.uint32),
            expressions=np.zeros((1000, 1, 3), np.int16),
            expression_names=np.array([f"e{k}" for k in range(1000)]),
        ),
    ),
    "OBJ of 10^7 faces": obj(lambda: VERTICES + b"f 1 2 3\n" * MANY),
    "OBJ of 10^7 vertices": obj(lambda: b"v 0 0 0\n" * MANY),
    "OBJ of 10^7 empty lines": obj(lambda: VERTICES + b"\n" * MANY),
    "OBJ with a face of 10^7 corners": obj(lambda: VERTICES + b"f" + b" 1" * MANY),
    "OBJ is a pipe": character("head", lambda f: ((f / "head").mkdir(), os.mkfifo(f / "head" / "neutral.obj"))),
    ".glb: JSON [[],[],...": character("c.glb", glb(b'{"a":[' + b"[]," * 20_000_000 + b"[]]}")),
    ".glb: JSON nested 10^6 deep": character("c.glb", glb(b"[" * 1_000_000)),
    ".glb is 3 GiB, sparse": character("c.glb", sparse("c.glb", 3 << 30)),
    ".glb: 10^8 values without data": character(
        "c.glb",
        glb(
            gltf(
                [
                    {
                        "componentType": 5126,
                        "type": "VEC3",
                        "count": 90_000_000,
                        "sparse": {"count": 1, "indices": {}, "values": {}},
                    }
                ]
            )
        ),
    ),
    ".glb: one view for 10,000 shapes": character(
        "c.glb",
        glb(
            gltf(
                [{"componentType": 5126, "type": "VEC3", "count": 300_000, "bufferView": 0}],
                [{"buffer": 0, "byteLength": 3_600_000}],
                [{"byteLength": 3_600_000}],
                targets=10_000,
            ),
            np.arange(900_000, dtype=np.float32).tobytes(),
        ),
    ),
    ".glb: its buffer is a pipe": character("c.glb", beside_pipe),
    ".glb: its buffer links to /dev/zero": character("c.glb", beside_endless),
    "take of 10^7 rows": take_csv(rows("00:00:00:00,61,0", HEADER_OF_TAKE)),
    "take of 10^7 columns": take_csv(lambda: b"Timecode," + b"a," * MANY + b"\n"),
    "take of empty lines": take_csv(lambda: HEADER_OF_TAKE.encode() + b"\n" * MANY),
    "film of 16,000 x 16,000": video(large_film, "v.avi"),
    "film is a pipe": video(fifo("v.mp4"), "v.mp4"),
    "camera: JPEGs of 16,000 x 16,000": camera(repeat(lambda: part(jpeg(16_000, 16_000)))),
    "camera: endless JPEG": camera(repeat(part(b"\xff\xd8"), bytes(1 << 20))),
    "camera: endless JPEG with a length": camera(repeat(part(b"\xff\xd8", 1 << 40), bytes(1 << 20))),
    "camera: endless headers": camera(repeat(b"--frame\r\n", b"X: y\r\n" * 1000)),
    "camera: endless first line": camera(repeat(b"a" * (1 << 20))),
    "camera: a single JPEG of 16,000 x 16,000": camera(repeat(lambda: jpeg(16_000, 16_000), times=1), "image/jpeg"),
    "camera: a film of 16,000 x 16,000": camera(repeat(lambda: jpeg(16_000, 16_000), times=3), "video/x-motion-jpeg2000"),
}


# ---- measuring -----------------------------------------------------------------------------------------------------
def prepare(folder: Path) -> None:
    """The good inputs that hostile ones are made of: ``take`` and ``result.npz``."""
    from recordings import talking_head

    from adaptiveface.model.actor import Actor
    from adaptiveface.pipeline import track_source
    from adaptiveface.sensors import Recording

    talking_head(folder / "take", 3).save(folder / "actor.npz")
    track_source(Recording(folder / "take"), Actor.load(folder / "actor.npz")).save(folder / "result.npz")


def measure(name: str, folder: Path) -> Measured:
    """Make the input ``name`` in ``folder``, which :func:`prepare` has filled, and give it to its command."""
    place = folder / "case"
    place.mkdir()
    try:
        arguments = CASES[name](place)
        command = [sys.executable, __file__, *arguments]
        try:
            run = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, start_new_session=True)
        except subprocess.TimeoutExpired:
            return Measured(None, LIMIT, 0.0, "hangs\n")
        try:
            status, seconds, mebibytes = json.loads(run.stdout.splitlines()[-1])
        except (ValueError, IndexError):
            return Measured(run.returncode, 0.0, 0.0, run.stderr[-500:])
        return Measured(status, seconds, mebibytes, run.stderr)
    finally:
        shutil.rmtree(place)


def table() -> int:
    """Print every input with its time, memory and message; the number of those that are not refused as they should."""
    bad = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prepare(folder)
        for case in CASES:
            found = measure(case, folder)
            bad += not found.good
            said = " ".join(found.message.replace(f"{folder}/case/", "").split()).removeprefix("adaptiveface: error: ")
            mark = "" if found.good else "BAD "
            print(f"{mark}{case:<50}{found.seconds:6.2f} s{found.mebibytes:5.0f} MiB  {said[:110]}", flush=True)
    print(f"{len(CASES) - bad} of {len(CASES)} refused within {SECONDS:g} s and {MEBIBYTES} MiB")
    return bad


def peak_kib() -> int:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM:"))


def main() -> None:
    """The child: import everything, then run the command line and say what it took, its own children's memory included."""
    import cv2  # noqa: F401
    from PIL import Image  # noqa: F401

    import adaptiveface.export.command
    import adaptiveface.export.gltf
    import adaptiveface.export.take
    import adaptiveface.importers
    import adaptiveface.live.command
    import adaptiveface.pipeline
    import adaptiveface.retargeting.character
    import adaptiveface.retargeting.gltf_character
    import adaptiveface.retargeting.loading
    import adaptiveface.retargeting.obj_folder
    import adaptiveface.sensors.record3d
    import adaptiveface.sensors.webcam
    from adaptiveface.cli import main as command

    adaptiveface.retargeting.loading.load_character("hag")
    Path("/proc/self/clear_refs").write_text("5")  # the peak so far is forgotten
    before, start = peak_kib(), time.perf_counter()
    with contextlib.redirect_stdout(io.StringIO()):
        try:
            status = command(sys.argv[1:])
        except SystemExit as stop:
            status = stop.code
    seconds = time.perf_counter() - start
    children = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss  # at least this process's own size when it forked
    peak = max(peak_kib(), children) - before
    print(json.dumps([status, seconds, peak / 1024]), flush=True)
    os._exit(0)


if __name__ == "__main__":
    main()
