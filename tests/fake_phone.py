"""A stand-in for usbmuxd and an iPhone that streams with Record3D; prints its port, streams to whoever connects.

Runs as a process of its own: ``python fake_phone.py FRAMES``. After FRAMES frames it hangs up, as an unplugged phone.
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
    picture = io.BytesIO()
    Image.new("RGB", (2 * W, 2 * H), (200, number % 200, 50)).save(picture, "JPEG", quality=95)
    colour, depth = picture.getvalue(), lzfse.compress(depth_of(number).tobytes())
    body = struct.pack("<11I", 2 * W, 2 * H, W, H, 0, 0, len(colour), len(depth), 0, 0, 0)
    body += struct.pack("<11f", *(2 * k for k in K), 0, 0, 0, 1, 0, 0, 0) + colour + depth
    return struct.pack(">IIII", 1, 101, 0, len(body)) + body


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


def serve(connection: socket.socket, frames: int) -> None:
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
                for number in range(frames):
                    connection.sendall(message(number))
                    time.sleep(0.04)
                return
    except (EOFError, OSError):
        pass
    finally:
        connection.close()


if __name__ == "__main__":
    listener = socket.create_server(("127.0.0.1", 0))
    print(listener.getsockname()[1], flush=True)
    while True:
        threading.Thread(target=serve, args=(listener.accept()[0], int(sys.argv[1])), daemon=True).start()
