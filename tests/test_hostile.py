"""Files and streams that mean harm are refused in bounded time and memory; fault_hostile.py holds them all."""

from __future__ import annotations

import sys
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import fault_hostile
import pytest

from adaptiveface.errors import FileFormatError, SensorError, abbreviated
from adaptiveface.files import Archive, parse_json
from adaptiveface.sensors.mjpeg import MAX_PICTURE_BYTES, open_mjpeg

#: One of each kind, those that take long to make left out.
CHOSEN = (
    "timestamps.csv is a pipe",
    "timestamps.csv links to /dev/zero",
    "timestamps.csv of 10^7 rows",
    "a timestamp of 1e300",
    "features.csv of 20 GiB, sparse",
    "intrinsic.json [[],[],...",
    "a width of 1e308",
    "a width of 400 digits",
    "depth images are pipes",
    "depth images link to /dev/zero",
    ".r3d: metadata [[],[],...",
    ".r3d: metadata of a GiB of zeros",
    ".r3d: 10^6 members",
    ".npz promises a GiB",
    ".npz with a lie in its list",
    ".npz of 10^6 members",
    ".npz is a pipe",
    "character.npz of 10^6 vertices and 1000 shapes",
    "OBJ of 10^7 faces",
    "OBJ with a face of 10^7 corners",
    ".glb: JSON [[],[],...",
    ".glb is 3 GiB, sparse",
    ".glb: its buffer is a pipe",
    "take of 10^7 columns",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("hostile")
    fault_hostile.prepare(place)
    return place


@pytest.mark.skipif(sys.platform != "linux", reason="pipes, devices and the peak of memory as Linux has them")
@pytest.mark.parametrize("name", CHOSEN)
def test_a_hostile_input_is_refused_with_one_line_in_bounded_memory(name, folder):
    found = fault_hostile.measure(name, folder)
    assert found.status == 2 and found.message.count("\n") == 1 and "Traceback" not in found.message
    assert found.mebibytes <= fault_hostile.MEBIBYTES
    assert found.seconds <= 10  # 2 s on a machine with nothing else to do: the table in docs/files.md
    assert len(found.message.replace(str(folder), "")) < 240


def served(parts: list[bytes], kind: str = "multipart/x-mixed-replace; boundary=frame", login: list | None = None):
    class Handler(BaseHTTPRequestHandler):
        def do_GET(self):  # noqa: N802 - the library's name
            if login is not None:
                login.append(self.headers.get("Authorization"))
            self.send_response(200)
            self.send_header("Content-Type", kind)
            self.end_headers()
            try:
                for part in parts:
                    self.wfile.write(part)
            except OSError:
                pass

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"127.0.0.1:{server.server_address[1]}/v"


def test_pictures_come_with_and_without_their_length_and_damaged_ones_are_passed_over():
    small = fault_hostile.jpeg(64, 48)
    parts = [
        fault_hostile.part(small, len(small)),
        fault_hostile.part(small),
        fault_hostile.part(b"no picture"),
        fault_hostile.part(small, len(small)),
        b"--frame--\r\n",
    ]
    logins: list = []
    stream = open_mjpeg(f"http://me:p%40ss@{served(parts, login=logins)}", "camera", 5)
    found = [stream.read() for _ in range(5)]
    stream.close()
    assert [ok for ok, _ in found] == [True, True, False, True, False] and found[0][1].shape == (48, 64, 3)
    assert logins == ["Basic bWU6cEBzcw=="]


@pytest.mark.parametrize(
    "parts, words",
    [
        ([fault_hostile.part(b"\xff\xd8", 10**12)], "at most 16 MiB"),
        ([fault_hostile.part(b"\xff\xd8"), bytes(MAX_PICTURE_BYTES + 100_000)], "at most 16 MiB"),
        ([b"a" * 10_000], "marked off"),
        ([b"--frame\r\n" + b"X: y\r\n" * 100], "lines of headers"),
    ],
)
def test_streams_without_an_end_are_refused(parts, words):
    stream = open_mjpeg(f"http://{served(parts)}", "camera", 5)
    with pytest.raises(SensorError, match=words):
        for _ in range(3):
            stream.read()


def test_a_header_decides_before_anything_is_decoded():
    small = bytearray(fault_hostile.jpeg(64, 48))
    at = small.find(b"\xff\xc0") + 5
    small[at : at + 4] = (16_000).to_bytes(2, "big") * 2
    stream = open_mjpeg(f"http://{served([fault_hostile.part(bytes(small), len(small))])}", "camera", 5)
    with pytest.raises(SensorError, match="256000000 pixels"):
        stream.read()
    with pytest.raises(SensorError, match="single pictures"):
        open_mjpeg(f"http://{served([bytes(small)], 'image/jpeg')}", "camera", 5)
    assert open_mjpeg(f"http://{served([b'film'], 'video/mp4')}", "camera", 5) is None


def test_what_an_archive_holds_is_weighed_together(tmp_path):
    zeros = [(f"a{k}", 48 << 20) for k in range(3)]
    with Archive(fault_hostile.zipped(tmp_path / "a.zip", *zeros), 1 << 30) as archive:
        archive.member("a0")
        archive.member("a0")  # the same one once more
        with pytest.raises(FileFormatError, match="far more than its size explains"):
            archive.member("a1")
    with pytest.raises(FileFormatError, match="at most 1 are read|of 3 values"):
        parse_json(b"[1, 2, 3]", "it", 1)


def test_long_values_are_abbreviated():
    assert abbreviated(1e308) == "1e+308" and abbreviated(10**5000) == "a huge number"
    assert len(abbreviated("9" * 1000)) == 60 and abbreviated([1, 2]) == "[1, 2]"
