"""Writes OpenNI2 recordings (.oni, format 1.0.1.0, uncompressed) in pure Python, so that tests need no camera.

The file is a header and then records: a magic number, type, node, size of the fields, size of the payload, and the
position of the record that this one replaces; then fields and payload. Everything is little-endian.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

_MAGIC = 0x0052494E
_INT, _GENERAL, _REMOVED, _DATA_BEGIN, _STATE_READY, _DATA, _END, _ADDED, _SEEK_TABLE = (
    0x03,
    0x06,
    0x07,
    0x08,
    0x09,
    0x0A,
    0x0B,
    0x0D,
    0x0E,
)
#: name -> node name, node type, pixel format of OpenNI 1, bytes per pixel
_NODES = {"depth": (b"Depth\0", 2, 4, 2), "colour": (b"Image\0", 3, 1, 3)}
DEPTH_1_MM, DEPTH_100_UM, RGB888, YUV422 = 100, 101, 200, 201


class OniWriter:
    """A recording of ``streams`` ("depth", "colour") -> (width, height); a context manager.

    ``fov``: horizontal and vertical, rad; ``formats``: pixel format per stream; ``mirror``: what the file says of it.
    """

    def __init__(
        self, path: Path, streams: dict, fov: tuple[float, float], fps: int = 30, formats=None, mirror: int = 0
    ) -> None:
        self._file, self._nodes, self._last_time = open(path, "wb"), {}, 0
        self._fps, self._fov, self._mirror = fps, fov, mirror
        self._header(0, 0)
        for number, (name, size) in enumerate(streams.items(), 1):
            node = {"id": number, "at": self._file.tell(), "last": 0, "frames": [], "size": size}
            self._nodes[name] = node
            self._added(name, 0xFFFFFFFF, 0, 0)
            self._properties(name, (formats or {}).get(name, DEPTH_1_MM if name == "depth" else RGB888))
        for node in self._nodes.values():
            self._record(_STATE_READY, node["id"])
            self._record(_DATA_BEGIN, node["id"], struct.pack("<IQ", 0xFFFFFFFF, 0xFFFFFFFFFFFFFFFF))

    def write(self, name: str, image: np.ndarray, microseconds: int) -> None:
        """Append a frame; frames count from 1, because the player skips number 0 at time 0."""
        node = self._nodes[name]
        assert image.shape[1::-1] == node["size"]
        fields = struct.pack("<QI", microseconds, len(node["frames"]) + 1)
        node["last"] = self._record(_DATA, node["id"], fields, np.ascontiguousarray(image).tobytes(), node["last"])
        node["frames"].append((microseconds, 0, node["last"]))
        self._last_time = max(self._last_time, microseconds)

    def close(self) -> None:
        """Write the seek tables and complete the header."""
        for node in self._nodes.values():
            self._record(_REMOVED, node["id"], replaces=node["at"])
            entries = [(0, 0, 0), *node["frames"]]
            node["seek"] = self._record(
                _SEEK_TABLE, node["id"], payload=b"".join(struct.pack("<QIQ", *entry) for entry in entries)
            )
        self._record(_END, 0)
        for name, node in self._nodes.items():
            self._file.seek(node["at"])
            last_time = node["frames"][-1][0] if node["frames"] else 0
            self._added(name, len(node["frames"]), last_time, node["seek"])
        self._file.seek(0)
        self._header(self._last_time, len(self._nodes))
        self._file.close()

    def __enter__(self) -> OniWriter:
        return self

    def __exit__(self, *_) -> None:
        self.close()

    def _header(self, last_time: int, nodes: int) -> None:
        self._file.write(struct.pack("<4sBBHIQI", b"NI10", 1, 0, 1, 0, last_time, nodes))

    def _record(self, kind: int, node: int, fields: bytes = b"", payload: bytes = b"", replaces: int = 0) -> int:
        position = self._file.tell()
        head = struct.pack("<IIIIIQ", _MAGIC, kind, node, 28 + len(fields), len(payload), replaces)
        self._file.write(head + fields + payload)
        return position

    def _added(self, name: str, frames: int, last_time: int, seek_table: int) -> None:
        text, kind, *_ = _NODES[name]
        fields = struct.pack("<I", len(text)) + text + struct.pack("<I4sIQQQ", kind, b"NONE", frames, 0, last_time, seek_table)
        self._record(_ADDED, self._nodes[name]["id"], fields)

    def _properties(self, name: str, pixel_format: int) -> None:
        (width, height), (_, _, old_format, bytes_per_pixel) = self._nodes[name]["size"], _NODES[name]
        mode = struct.pack("<III", width, height, self._fps)
        properties = {
            "oniRequiredFrameSize": width * height * bytes_per_pixel,
            "xnIsGenerating": 1,
            **({"xnDeviceMaxDepth": 10_000} if name == "depth" else {}),
            "xnSupportedMapOutputModesCount": 1,
            "xnSupportedMapOutputModes": mode,
            "xnMapOutputMode": mode,
            "xnSupportedPixelFormats": struct.pack("<I", 1 << (old_format - 1)),
            "xnPixelFormat": old_format,
            "oniPixelFormat": pixel_format,
            "xnFOV": struct.pack("<dd", *self._fov),
            "Mirror": 1,
            "xnMirror": self._mirror,
            "Cropping": 1,
            "xnCropping": struct.pack("<IHHHH", 0, 0, 0, 0, 0),  # without it the player delivers no frame at all
        }
        for key, value in properties.items():
            kind, content = (_INT, struct.pack("<Q", value)) if isinstance(value, int) else (_GENERAL, value)
            text = key.encode() + b"\0"
            fields = struct.pack("<I", len(text)) + text + struct.pack("<I", len(content)) + content
            self._record(kind, self._nodes[name]["id"], fields)
