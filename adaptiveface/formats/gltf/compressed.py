"""Decode compressed geometry in glTF with the libraries of Google's Draco and of meshoptimizer (the extra ``avatars``).

Before data are decoded, the sizes that the file declares are compared with those in the headers of the compressed data.
"""

from __future__ import annotations

import struct

import numpy as np

from ...errors import MissingExtraError
from .container import MAX_FILE_BYTES, extensions
from .layout import GltfLayout

DRACO = "KHR_draco_mesh_compression"
#: Khronos adopted the first extension under the second name.
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
_PIP = "python -m pip install 'adaptiveface[avatars]'"
#: Extensions that change nothing of what is read here. Files that require another one are not opened.
_HARMLESS = {
    "KHR_mesh_quantization",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "VRM",
    "KHR_lights_punctual",
    "KHR_animation_pointer",
}
_HARMLESS_STARTS = ("KHR_materials_", "VRMC_", "EXT_materials_", "ADOBE_materials_")


def _library(name: str):
    try:
        return __import__(name)
    except ImportError:
        return None


class Compressed:
    """The compressed parts of a file."""

    def __init__(self, file: GltfLayout) -> None:
        self._file = file
        self._views: dict[int, bytes] = {}

    def obstacle(self) -> str | None:
        """Why the meshes of the file cannot be opened here, with the way out. None if they can be opened."""
        required = self._file.required()
        unknown = {n for n in required if n not in _HARMLESS and not n.startswith(_HARMLESS_STARTS)} - {DRACO, *MESHOPT}
        if unknown:
            return f"needs the extension {', '.join(sorted(unknown))[:200]}; export it again without compression"
        if DRACO in required and _library("DracoPy") is None:
            return f"is compressed with {DRACO}: {_PIP}"
        if required & set(MESHOPT) and _library("meshopt") is None:
            return f"is compressed with {min(required & set(MESHOPT))}: {_PIP}"
        return None

    def check(self) -> None:
        """Raise :class:`MissingExtraError` or :class:`FileFormatError` if the meshes cannot be opened."""
        reason = self.obstacle()
        if reason is not None:
            raise MissingExtraError(f"{self._file.path}: {reason}") if _PIP in reason else self._file.error(reason)
        if DRACO in self._file.required() and not any(
            DRACO in extensions(p) for mesh in self._file.items("meshes") for p in mesh.get("primitives") or ()
        ):
            raise self._file.error(f"requires {DRACO}, but none of its meshes has it")

    # ---- meshoptimizer ----
    def view(self, index: int) -> bytes | None:
        """The decoded bytes of a buffer view. None if it is not compressed, or can also be read uncompressed."""
        view = self._file.item("bufferViews", index)
        entry = next((extensions(view)[name] for name in MESHOPT if name in extensions(view)), None)
        if entry is None or not self._file.required() & set(MESHOPT) and _library("meshopt") is None:
            return None
        if index not in self._views:
            self._views[index] = self._decoded(index, view, entry)
        return self._views[index]

    def _decoded(self, index: int, view: dict, entry: dict) -> bytes:
        file, library = self._file, _library("meshopt")
        if library is None:
            self.check()
        mode, kind = entry.get("mode"), entry.get("filter", "NONE")
        if mode not in ("ATTRIBUTES", "TRIANGLES", "INDICES"):
            raise file.error(f"buffer view {index} is compressed in the unknown mode {str(mode)[:40]}")
        if kind not in ("NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"):
            raise file.error(f"buffer view {index} has the unknown filter {str(kind)[:40]}")
        stride = file.whole(entry, "byteStride", 1, 256)
        count = file.whole(entry, "count", 1, MAX_FILE_BYTES)
        if count * stride != file.whole(view, "byteLength", 1, MAX_FILE_BYTES):
            raise file.error(f"buffer view {index}: {count} elements of {stride} bytes are not its byteLength")
        buffer = file.buffer(entry.get("buffer"))
        start = file.whole(entry, "byteOffset", 0, MAX_FILE_BYTES, 0)
        size = file.whole(entry, "byteLength", 1, MAX_FILE_BYTES)
        if start + size > len(buffer):
            raise file.error(f"buffer view {index} ends at byte {start + size} of {len(buffer)}")
        file.spend(count * stride // 4 + 1, zeros=count * stride > 256 * size)
        data = bytes(buffer[start : start + size])
        try:
            decoded = library.decode_gltf_buffer(data, count, stride, mode, kind)
        except (ValueError, RuntimeError, TypeError) as problem:
            raise file.error(f"buffer view {index} cannot be decompressed ({str(problem)[:80]})") from None
        out = np.ascontiguousarray(decoded)
        if mode != "ATTRIBUTES" and out.dtype.itemsize != stride:
            out = out.astype({2: np.uint16, 4: np.uint32}[stride])
        if out.nbytes != count * stride:
            raise file.error(f"buffer view {index} holds {out.nbytes} bytes, {count * stride} are declared")
        return out.tobytes()

    # ---- Draco ----
    def draco(self, primitive: dict) -> tuple[dict[str, np.ndarray], np.ndarray] | None:
        """The attributes (count, width) by name and the indices of a Draco primitive. None if it is not compressed."""
        file, entry, library = self._file, extensions(primitive).get(DRACO), _library("DracoPy")
        if entry is None or library is None and DRACO not in file.required():
            return None
        if library is None:
            self.check()
        view = file.item("bufferViews", entry["bufferView"])
        buffer, start = file.buffer(view.get("buffer")), file.whole(view, "byteOffset", 0, MAX_FILE_BYTES, 0)
        size = file.whole(view, "byteLength", 1, MAX_FILE_BYTES)
        data = bytes(buffer[start : start + size])
        wanted = {name: file.layout(primitive["attributes"][name]) for name in entry["attributes"]}
        corners = file.layout(primitive["indices"])[3] if "indices" in primitive else 64 * len(data)
        vertices = max((layout[3] for layout in wanted.values()), default=0)
        self._judge(data, vertices, corners)
        file.spend(corners + sum(layout[2] * layout[3] for layout in wanted.values()))
        try:
            mesh = library.decode(data)
        except Exception as problem:  # the library's own errors, of any kind
            raise file.error(f"Draco data that cannot be decompressed ({str(problem)[:80]})") from None
        found = {a["unique_id"]: np.asarray(a["data"]) for a in mesh.attributes}
        attributes = {}
        for name, (accessor, _, width, count) in wanted.items():
            values = found.get(entry["attributes"][name])
            if values is None or values.shape != (count, width):
                raise file.error(f"Draco data do not hold the {count} values of {name[:40]}")
            attributes[name] = file.floats(primitive["attributes"][name], accessor, values)
        return attributes, np.asarray(getattr(mesh, "faces", np.zeros((0, 3)))).astype(np.uint32)

    def _judge(self, data: bytes, vertices: int, corners: int) -> None:
        """Raise :class:`FileFormatError` if the header of Draco data promises more than the accessors declare."""
        if data[:5] != b"DRACO" or len(data) < 20 or data[7] != 1 or data[10] & 0x80:
            raise self._file.error("Draco data without the header of a mesh, or with metadata, which are not read")
        at = 11 + (data[8] == 1)  # method 1 (edge breaker) has one more byte
        if tuple(data[5:7]) < (2, 2):
            first, second = struct.unpack_from("<II", data, at)
        else:
            first, at = _varint(data, at)
            second, at = _varint(data, at)
        faces, points = (first, second) if data[8] == 0 else (second, first)
        if points > vertices or 3 * faces > corners:
            raise self._file.error(f"Draco data promise {points} vertices and {faces} triangles, more than declared")


def _varint(data: bytes, at: int) -> tuple[int, int]:
    """A number with seven bits in each byte, lowest first, and the position behind it."""
    number = shift = 0
    while True:
        number |= (data[at] & 0x7F) << shift
        at, shift = at + 1, shift + 7
        if data[at - 1] < 0x80 or shift > 35:
            return number, at
