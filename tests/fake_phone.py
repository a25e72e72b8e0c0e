"""A stand-in for usbmuxd and an iPhone that streams with Record3D; prints its port, streams to whoever connects.

Runs as a process of its own: ``python fake_phone.py FRAMES``. After FRAMES frames it hangs up, as an unplugged phone.
``python fake_phone.py TAKE.npz`` streams the ``depth`` (n, h, w) m of that file instead, with its ``k`` (4,).
"""

from __future__ import annotations

import io
import plistlib
import socket
import struct
import sys
import threading
import time

import lzfse
import numpy as np
from PIL import Image

W, H, K = 48, 64, (60.0, 61.0, 23.0, 31.0)


def depth_of(number: int) -> np.ndarray:
    """(H, W) float32 m; its corner is NaN, its second pixel says which frame it is."""
    depth = np.random.default_rng(number).uniform(0.3, 0.6, (H, W)).astype("<f4")
    depth[0, :2] = np.nan, 1.0 + number / 100
    return depth


def message(number: int) -> bytes:
    return packed(depth_of(number), Image.new("RGB", (2 * W, 2 * H), (200, number % 200, 50)), [2 * k for k in K])


def packed(depth: np.ndarray, picture: Image.Image, k) -> bytes:
    """One frame of the stream: ``depth`` (h, w) float32 m; ``k`` fx, fy, cx, cy of the picture."""
    jpeg = io.BytesIO()
    picture.save(jpeg, "JPEG", quality=95)
    colour, content = jpeg.getvalue(), lzfse.compress(depth.astype("<f4").tobytes())
    body = struct.pack("<11I", *picture.size, *depth.shape[::-1], 0, 0, len(colour), len(content), 0, 0, 0)
    body += struct.pack("<11f", *k, 0, 0, 0, 1, 0, 0, 0) + colour + content
    return struct.pack(">IIII", 1, 101, 0, len(body)) + body


def messages(argument: str) -> list[bytes]:
    if argument.isdecimal():
        return [message(number) for number in range(int(argument))]
    with np.load(argument) as take:
        depths, k = take["depth"], take["k"]
    grey = Image.new("RGB", depths.shape[:0:-1], (120, 120, 120))
    return [packed(depth, grey, k) for depth in depths]


def receive(connection: socket.socket, count: int) -> bytes:
    content = b""
    while len(content) < count:
        part = connection.recv(count - len(content))
        if not part:
            raise EOFError
        content += part
    return content


def answer(connection: socket.socket, tag: int, content: dict) -> None:
    body = plistlib.dumps(content)
    connection.sendall(struct.pack("<IIII", 16 + len(body), 1, 8, tag) + body)


def serve(connection: socket.socket, frames: list[bytes]) -> None:
    phone = {"ConnectionType": "USB", "DeviceID": 1, "LocationID": 0, "ProductID": 4776, "SerialNumber": "FAKE-1"}
    try:
        while True:
            length, _, _, tag = struct.unpack("<IIII", receive(connection, 16))
            kind = plistlib.loads(receive(connection, length - 16))["MessageType"]
            if kind == "ListDevices":
                attached = {"DeviceID": 1, "MessageType": "Attached", "Properties": phone}
                answer(connection, tag, {"DeviceList": [attached]})
                continue
            answer(connection, tag, {"MessageType": "Result", "Number": 0})
            if kind == "Connect":
                time.sleep(0.2)
                for frame in frames:
                    connection.sendall(frame)
                    time.sleep(0.04)
                return
    except (EOFError, OSError):
        pass
    finally:
        connection.close()


if __name__ == "__main__":
    stream = messages(sys.argv[1])
    listener = socket.create_server(("127.0.0.1", 0))
    print(listener.getsockname()[1], flush=True)
    while True:
        threading.Thread(target=serve, args=(listener.accept()[0], stream), daemon=True).start()
