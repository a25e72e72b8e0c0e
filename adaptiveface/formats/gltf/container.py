"""Read the container of glTF 2.0 files (.gltf, .glb, .vrm): JSON, chunks and buffers. The files need not be trusted.

Every number is checked before memory is allocated. Buffers come from the file itself or from files beside it, never from
outside its folder.
"""

from __future__ import annotations

import base64
import binascii
import os
import struct
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO
from urllib.parse import unquote

from ...errors import AdaptiveFaceError, FileFormatError
from ...files import parse_json, read_bytes

#: Largest size of the file together with all files beside it that it names.
MAX_FILE_BYTES = 256 << 20
MAX_JSON_BYTES = 64 << 20
MAX_ITEMS = 100_000
MAX_CHUNKS = 16

Buffer = bytes | bytearray | memoryview


class GltfContainer:
    """A parsed file. Every method raises :class:`FileFormatError` naming the file.

    Attributes
    ----------
    path : Path
        The file.
    document : dict
        Its JSON object.
    chunks : list of (bytes, memoryview)
        Kind and content of the chunks of a .glb after the JSON. A .gltf has none.
    size : int
        Size of the file, bytes.
    """

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self.chunks: list[tuple[bytes, memoryview]] = []
        self._buffers: dict[int, memoryview] = {}
        self._lists: dict[str, list[dict]] = {}
        with self.errors():
            data = memoryview(read_bytes(self.path, MAX_FILE_BYTES))
            self.size = self._taken = len(data)
            self.document = self._parse(data)
            if not isinstance(self.document, dict):
                raise self.error("its JSON is not an object")

    def error(self, message: str) -> FileFormatError:
        """An error that names the file."""
        return FileFormatError(f"{self.path}: {message}")

    @contextmanager
    def errors(self):
        """A context that turns every exception that malformed JSON causes into one clear :class:`FileFormatError`."""
        try:
            yield
        except AdaptiveFaceError:
            raise
        except RecursionError:
            raise self.error("its JSON is nested too deeply") from None
        except MemoryError:
            raise self.error("it needs more memory than this machine has") from None
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, StopIteration, struct.error) as problem:
            text = " ".join(str(problem)[:120].split()) or type(problem).__name__
            raise self.error(f"malformed glTF ({type(problem).__name__}: {text})") from None
        except OSError as problem:
            raise self.error(f"cannot be read ({problem.strerror})") from None

    # ---- the file ----
    def _parse(self, data: memoryview) -> dict:
        if data[:4] != b"glTF":
            return self._json(data)
        if len(data) < 20:
            raise self.error("truncated: not even a header")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise self.error(f"glTF version {version}; only version 2 is read")
        if length > len(data):
            raise self.error(f"truncated: {len(data)} of {length} bytes")
        at = 12
        while at + 8 <= length and len(self.chunks) < MAX_CHUNKS:
            size, kind = struct.unpack_from("<I4s", data, at)
            if size > length - at - 8:
                raise self.error(f"a chunk declares {size} bytes, but has {length - at - 8}")
            self.chunks.append((kind, data[at + 8 : at + 8 + size]))
            at += 8 + size
        if not self.chunks or self.chunks[0][0] != b"JSON":
            raise self.error("the first chunk is not JSON")
        return self._json(self.chunks.pop(0)[1])

    def _json(self, data: memoryview) -> dict:
        if len(data) > MAX_JSON_BYTES:
            raise self.error(f"more than {MAX_JSON_BYTES >> 20} MiB of JSON")

        def no_number(text: str):
            raise ValueError(f"{text} is not a number")

        return parse_json(bytes(data), str(self.path), parse_constant=no_number)

    def items(self, name: str) -> list[dict]:
        """A top-level array of objects; [] if the file has none."""
        if name in self._lists:
            return self._lists[name]
        items = self.document.get(name) or []
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise self.error(f"'{name}' is not a list of objects")
        if len(items) > MAX_ITEMS:
            raise self.error(f"{len(items)} {name}; at most {MAX_ITEMS} are read")
        self._lists[name] = items
        return items

    def item(self, name: str, index) -> dict:
        """One entry of a top-level array."""
        items = self.items(name)
        if type(index) is not int or not 0 <= index < len(items):
            raise self.error(f"{str(index)[:40]} points outside the {len(items)} {name}")
        return items[index]

    def whole(self, entry: dict, key: str, low: int, high: int, default: int | None = None) -> int:
        """``entry[key]``, which must be a whole number from ``low`` to ``high``; ``default`` if it is absent."""
        value = entry.get(key, default)
        if type(value) is float and value.is_integer():
            value = int(value)
        if type(value) is not int or not low <= value <= high:
            raise self.error(f"'{key}' = {str(value)[:40]}: a whole number from {low} to {high} is expected")
        return value

    def required(self) -> set[str]:
        """Names of the extensions that a reader of the file must support."""
        return {str(name) for name in self.document.get("extensionsRequired") or ()}

    # ---- buffers ----
    @property
    def binary(self) -> memoryview | None:
        """The buffer in a .glb file itself; None if it has none."""
        return next((body for kind, body in self.chunks if kind == b"BIN\0"), None)

    def buffer(self, index) -> memoryview:
        """The bytes of a buffer. There are at least as many as it declares."""
        entry = self.item("buffers", index)
        if index not in self._buffers:
            size = self.whole(entry, "byteLength", 1, MAX_FILE_BYTES)
            data = (self.binary if index == 0 else None) if "uri" not in entry else self.resource(entry["uri"])[0]
            if data is None:
                raise self.error(f"buffer {index} has neither data nor a URI")
            if len(data) < size:
                raise self.error(f"buffer {index} declares {size} bytes, but has {len(data)}")
            self._buffers[index] = memoryview(data)
        return self._buffers[index]

    def resource(self, uri) -> tuple[bytes, str]:
        """The bytes to which a URI of the file refers, and their MIME type, or "" if it is unknown."""
        if not isinstance(uri, str):
            raise self.error("a buffer's URI is not text")
        if uri.startswith("data:"):
            head, comma, body = uri.partition(",")
            if not comma or not head.endswith(";base64"):
                raise self.error("a data URI that is not base64")
            try:
                return base64.b64decode(body, validate=True), head[5:-7].partition(";")[0]
            except binascii.Error:
                raise self.error("a data URI that is not base64") from None
        content = read_bytes(self.beside(uri), MAX_FILE_BYTES - self._taken)
        self._taken += len(content)
        return content, ""

    def beside(self, uri: str) -> Path:
        """The file that a relative URI names. It must not leave the file's folder."""
        name = unquote(uri)
        folder = self.path.resolve().parent
        strange = ":" in name or "\\" in name or "\0" in name or name.startswith("/")
        target = folder if strange else (folder / name).resolve()
        if strange or not target.is_relative_to(folder):
            raise self.error(f"the URI '{uri[:80]}' leaves the file's folder; only files beside it are read")
        return target


def extras(entry: dict) -> dict:
    """The ``extras`` of a glTF object; {} if they are absent or no object."""
    value = entry.get("extras")
    return value if isinstance(value, dict) else {}


def extensions(entry: dict) -> dict:
    """The ``extensions`` of a glTF object; {} if they are absent or no object."""
    value = entry.get("extensions")
    return value if isinstance(value, dict) else {}


def looks_back(file: GltfContainer) -> bool:
    """Whether the face looks along -z, as VRM 0.x requires."""
    return "VRM" in extensions(file.document) and "VRMC_vrm" not in extensions(file.document)


def write_chunks(stream: BinaryIO, path: str | os.PathLike, chunks: Sequence[tuple[bytes, Sequence[Buffer]]]) -> None:
    """Write the content of a ``.glb``.

    Parameters
    ----------
    stream : binary file
        Where to write.
    path : path-like
        Name of the file, for messages.
    chunks : sequence of (kind, parts)
        Kind and content of each chunk, JSON first. Every chunk is padded to a multiple of four bytes.

    Raises
    ------
    FileFormatError
        The file would have 4 GiB or more, which its header cannot say.
    """
    sizes = [sum(map(len, parts)) for _, parts in chunks]
    total = 12 + sum(8 + size + -size % 4 for size in sizes)
    if total >= 1 << 32:
        raise FileFormatError(f"{os.fspath(path)}: {total >> 20} MiB do not fit into a .glb file; export fewer frames")
    stream.write(struct.pack("<4sII", b"glTF", 2, total))
    for (kind, parts), size in zip(chunks, sizes, strict=True):
        stream.write(struct.pack("<I4s", size + -size % 4, kind))
        for part in (*parts, (b" " if kind == b"JSON" else b"\0") * (-size % 4)):
            stream.write(part)
