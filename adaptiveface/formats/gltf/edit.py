"""Add to a user's glTF file. Everything that was in it stays as it is, byte for byte.

Entries are added to the JSON, and bytes to the end of the binary chunk. Compressed meshes and textures are not opened.
"""

from __future__ import annotations

import base64
import hashlib
import json
from pathlib import Path

import numpy as np

from ...errors import FileFormatError
from ...files import replacing
from .container import GltfContainer, write_chunks

_FLOAT = 5126
_WHOLE = "application/octet-stream"
_PICTURES = {b"\x89PNG": "image/png", b"\xff\xd8\xff": "image/jpeg", b"RIFF": "image/webp", b"\xabKTX": "image/ktx2"}


class GltfEdit:
    """A copy of a file, which can be added to and written.

    Parameters
    ----------
    file : GltfContainer
        The file to copy.
    out : path-like
        The file to write: as text if its suffix is ``.gltf``, otherwise as binary.

    Attributes
    ----------
    document : dict
        The JSON object of the copy. Callers may change it.
    notes : list of str
        Lines about pictures that the file names and that are missing.
    """

    def __init__(self, file: GltfContainer, out: Path) -> None:
        self.file, self.out = file, Path(out)
        self.document = json.loads(json.dumps(file.document))
        self.notes: list[str] = []
        self._text = self.out.suffix.lower() == ".gltf"
        self._added = bytearray()
        self._known: dict[tuple, int] = {}
        same_folder = self.out.resolve().parent == file.path.resolve().parent
        self._outside = same_folder and self._text == (file.path.suffix.lower() == ".gltf")
        self._buffer, self._before = self._place()
        if not self._outside:
            self._take_in("buffers")
            self._take_in("images")

    # ---- what is added ----
    def accessor(self, array: np.ndarray, bounds: bool = False) -> int:
        """Add an accessor with the float32 values of ``array`` (n,) or (n, width), and return its number.

        Equal arrays share an accessor. With ``bounds``, the entry has the smallest and the largest values.
        """
        array = np.ascontiguousarray(array, np.float32)
        key = (array.shape, bounds, hashlib.sha256(array.data).digest())
        if key not in self._known:
            kind = "SCALAR" if array.ndim == 1 else f"VEC{array.shape[1]}"
            entry = {
                "bufferView": self._view(array.tobytes()),
                "componentType": _FLOAT,
                "count": len(array),
                "type": kind,
            }
            if bounds:
                low, high = np.atleast_1d(array.min(axis=0)), np.atleast_1d(array.max(axis=0))
                entry |= {"min": [float(v) for v in low], "max": [float(v) for v in high]}
            self._known[key] = self._append("accessors", entry)
        return self._known[key]

    def _view(self, data: bytes) -> int:
        self._added += b"\0" * (-len(self._added) % 4)
        view = {"buffer": self._buffer, "byteOffset": self._start() + len(self._added), "byteLength": len(data)}
        self._added += data
        return self._append("bufferViews", view)

    def add_animation(self, name: str, times: np.ndarray, tracks: list[tuple[int, str, np.ndarray]]) -> None:
        """Add an animation.

        Parameters
        ----------
        name : str
            Its name.
        times : (F,)
            Times of the keys, s.
        tracks : list of (int, str, (F, width))
            Node, path ("rotation", "translation", "weights") and values.
        """
        clock = self.accessor(times, bounds=True)
        samplers: list[dict] = []
        channels: list[dict] = []
        numbers: dict[int, int] = {}
        for node, path, values in tracks:
            output = self.accessor(values.ravel() if path == "weights" else values)
            if output not in numbers:
                numbers[output] = len(samplers)
                samplers.append({"input": clock, "output": output, "interpolation": "LINEAR"})
            channels.append({"sampler": numbers[output], "target": {"node": node, "path": path}})
        self._append("animations", {"name": name, "channels": channels, "samplers": samplers})

    def _append(self, name: str, entry: dict) -> int:
        if not isinstance(self.document.get(name), list):
            self.document[name] = []
        self.document[name].append(entry)
        return len(self.document[name]) - 1

    # ---- buffers ----
    def _place(self) -> tuple[int, bytes | memoryview]:
        """The number of the buffer that receives new data, and its present content."""
        first = (self.file.items("buffers") or [{"byteLength": 0}])[0]
        if not self.document.get("buffers"):
            return self._append("buffers", {"byteLength": 0}), b""
        if "uri" not in first and self.file.binary is not None:
            return 0, self.file.binary
        if "uri" in first and not self._text:  # a buffer beside a .gltf becomes the binary chunk
            del self.document["buffers"][0]["uri"]
            return 0, self.file.buffer(0)
        return self._append("buffers", {"byteLength": 0}), b""

    def _start(self) -> int:
        return len(self._before) + -len(self._before) % 4

    def _take_in(self, name: str) -> None:
        """Copy files that lie beside the input into the output."""
        for entry in self.document.get(name) or ():
            uri = entry.get("uri")
            if not isinstance(uri, str) or uri.startswith("data:"):
                continue
            try:
                data = self.file.resource(uri)[0]
            except FileFormatError as problem:
                if name == "buffers":
                    raise
                self.notes.append(f"{problem} (a picture, whose entry is left unchanged)")
                continue
            kind = next((mime for magic, mime in _PICTURES.items() if data.startswith(magic)), _WHOLE)
            if name == "images" and not self._text and kind != _WHOLE:
                del entry["uri"]
                entry |= {"bufferView": self._view(data), "mimeType": entry.get("mimeType", kind)}
            else:
                entry["uri"] = _data_uri(data, kind if name == "images" else _WHOLE)

    # ---- the file ----
    def save(self) -> None:
        """Write the file, whole or not at all. Raises :class:`FileFormatError` if it would exceed 4 GiB."""
        whole = [self._before, b"\0" * (-len(self._before) % 4), bytes(self._added)]
        entry = self.document["buffers"][self._buffer]
        entry["byteLength"] = max(sum(map(len, whole)), 1)
        if self._text or self._buffer != 0:
            entry["uri"] = _data_uri(b"".join(whole), _WHOLE)
            whole = [] if self._text or self.file.binary is None else [self.file.binary]
        with replacing(self.out) as temporary, open(temporary, "wb") as stream:
            if self._text:
                stream.write(json.dumps(self.document, ensure_ascii=False, allow_nan=False).encode())
            else:
                self._write_binary(stream, whole)

    def _write_binary(self, stream, whole: list) -> None:
        text = json.dumps(self.document, ensure_ascii=False, allow_nan=False, separators=(",", ":")).encode()
        chunks: list[tuple[bytes, list]] = [(b"JSON", [text])]
        if whole:
            chunks.append((b"BIN\0", whole))
        chunks += [(kind, [body]) for kind, body in self.file.chunks if kind != b"BIN\0"]
        write_chunks(stream, self.out, chunks)


def _data_uri(data: bytes, kind: str) -> str:
    return f"data:{kind};base64,{base64.b64encode(data).decode()}"
