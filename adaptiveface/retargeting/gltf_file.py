"""Reading glTF 2.0 (.gltf, .glb, .vrm) that may come from anywhere: every number is judged before memory is taken.

Only what a face needs is read: buffers, accessors (sparse ones too), meshes, morph targets, nodes, animations. Buffers
come from the file itself or from files beside it, never from outside its folder.
"""

from __future__ import annotations

import base64
import binascii
import json
import struct
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import unquote

import numpy as np

from ..errors import FileFormatError

MAX_FILE_BYTES = 1 << 30
MAX_JSON_BYTES = 64 << 20
MAX_VALUES = 100_000_000
#: Values that are zero without any data in the file: this many, and so many more for every byte of it.
FREE_ZEROS, ZEROS_PER_BYTE = 10_000_000, 64
MAX_ITEMS = 100_000
_TYPES = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_COMPONENTS = {5120: np.int8, 5121: np.uint8, 5122: np.int16, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}
#: Extensions that change nothing of what is read here; a file that requires another one is refused.
_HARMLESS = {"KHR_mesh_quantization", "KHR_materials_unlit", "KHR_texture_transform", "VRM", "VRMC_vrm",
             "VRMC_materials_mtoon", "VRMC_springBone", "VRMC_node_constraint", "KHR_materials_emissive_strength",
             "EXT_texture_webp", "KHR_texture_basisu", "KHR_materials_specular", "KHR_materials_ior"}  # fmt: skip


class GltfFile:
    """A parsed file; ``document`` is its JSON object. Every method raises :class:`FileFormatError` naming the file."""

    def __init__(self, path: Path) -> None:
        self.path = Path(path)
        self._read_values = self._zeros = 0
        self._buffers: dict[int, bytes] = {}
        with self.errors():
            self.document, self._binary = self._parse(self._bytes(self.path, MAX_FILE_BYTES))
            if not isinstance(self.document, dict):
                raise self.error("its JSON is not an object")
            required = set(self.document.get("extensionsRequired", ())) - _HARMLESS
            if required:
                names = ", ".join(sorted(map(str, required)))[:200]
                raise self.error(f"needs the extension {names}; export it without (compression off)")

    def error(self, message: str) -> FileFormatError:
        """An error that names the file."""
        return FileFormatError(f"{self.path}: {message}")

    @contextmanager
    def errors(self):
        """Whatever malformed JSON makes Python raise becomes one clear error."""
        try:
            yield
        except FileFormatError:
            raise
        except RecursionError:
            raise self.error("its JSON is nested too deeply") from None
        except MemoryError:
            raise self.error("needs more memory than there is") from None
        except (LookupError, TypeError, ValueError, AttributeError, ArithmeticError, StopIteration,
                struct.error) as problem:  # fmt: skip
            text = str(problem)[:120] or type(problem).__name__
            raise self.error(f"malformed glTF ({type(problem).__name__}: {text})") from None
        except OSError as problem:
            raise self.error(f"cannot be read ({problem.strerror})") from None

    # ---- the file ----
    def _bytes(self, path: Path, limit: int) -> bytes:
        if not path.is_file():
            raise FileFormatError(f"{path}: no such file")
        if path.stat().st_size > limit:
            raise FileFormatError(f"{path}: larger than {limit >> 20} MiB")
        return path.read_bytes()

    def _parse(self, data: bytes) -> tuple[dict, bytes | None]:
        if data[:4] != b"glTF":
            return self._json(data), None
        if len(data) < 20:
            raise self.error("truncated: not even a header")
        version, length = struct.unpack_from("<II", data, 4)
        if version != 2:
            raise self.error(f"glTF version {version}; only 2 is read")
        if length > len(data):
            raise self.error(f"truncated: {len(data)} of {length} bytes")
        chunks, at = [], 12
        while at + 8 <= length and len(chunks) < 16:
            size, kind = struct.unpack_from("<I4s", data, at)
            if size > length - at - 8:
                raise self.error(f"a chunk declares {size} bytes, {length - at - 8} are there")
            chunks.append((kind, data[at + 8 : at + 8 + size]))
            at += 8 + size
        if not chunks or chunks[0][0] != b"JSON":
            raise self.error("the first chunk is not JSON")
        return self._json(chunks[0][1]), next((body for kind, body in chunks[1:] if kind == b"BIN\0"), None)

    def _json(self, data: bytes) -> dict:
        if len(data) > MAX_JSON_BYTES:
            raise self.error(f"more than {MAX_JSON_BYTES >> 20} MiB of JSON")

        def no_number(text: str):
            raise ValueError(f"{text} is not a number")

        return json.loads(data.decode("utf-8-sig"), parse_constant=no_number)

    def items(self, name: str) -> list[dict]:
        """A top-level array of objects, [] where absent."""
        items = self.document.get(name, [])
        if not isinstance(items, list) or not all(isinstance(item, dict) for item in items):
            raise self.error(f"'{name}' is not a list of objects")
        if len(items) > MAX_ITEMS:
            raise self.error(f"{len(items)} {name}; at most {MAX_ITEMS} are read")
        return items

    def item(self, name: str, index) -> dict:
        """One entry of a top-level array."""
        items = self.items(name)
        if type(index) is not int or not 0 <= index < len(items):
            raise self.error(f"{str(index)[:40]} points outside the {len(items)} {name}")
        return items[index]

    def _whole(self, entry: dict, key: str, low: int, high: int, default: int | None = None) -> int:
        value = entry.get(key, default)
        if type(value) is float and value.is_integer():
            value = int(value)
        if type(value) is not int or not low <= value <= high:
            raise self.error(f"'{key}' = {str(value)[:40]}: a whole number from {low} to {high} is expected")
        return value

    # ---- buffers and accessors ----
    def _buffer(self, index) -> bytes:
        entry = self.item("buffers", index)
        if index not in self._buffers:
            size = self._whole(entry, "byteLength", 1, MAX_FILE_BYTES)
            data = self._binary if "uri" not in entry else self._from_uri(entry["uri"])
            if data is None:
                raise self.error(f"buffer {index} has neither data nor a URI")
            if len(data) < size:
                raise self.error(f"buffer {index} declares {size} bytes, {len(data)} are there")
            self._buffers[index] = data
        return self._buffers[index]

    def _from_uri(self, uri) -> bytes:
        if not isinstance(uri, str):
            raise self.error("a buffer's URI is not text")
        if uri.startswith("data:"):
            head, comma, body = uri.partition(",")
            if not comma or not head.endswith(";base64"):
                raise self.error("a data URI that is not base64")
            try:
                return base64.b64decode(body, validate=True)
            except binascii.Error:
                raise self.error("a data URI that is not base64") from None
        name = unquote(uri)
        folder = self.path.resolve().parent
        if ":" in name or "\\" in name or "\0" in name or name.startswith("/"):
            raise self.error(f"the URI '{uri[:80]}' leaves the file's folder; only files beside it are read")
        target = (folder / name).resolve()
        if not target.is_relative_to(folder):
            raise self.error(f"the URI '{uri[:80]}' leaves the file's folder; only files beside it are read")
        return self._bytes(target, MAX_FILE_BYTES)

    def _view(self, index, dtype: np.dtype, width: int, count: int, offset: int) -> np.ndarray:
        """(count, width) of a buffer view; bounds are checked first."""
        view = self.item("bufferViews", index)
        buffer = self._buffer(view.get("buffer"))
        start = self._whole(view, "byteOffset", 0, MAX_FILE_BYTES, 0)
        size = self._whole(view, "byteLength", 1, MAX_FILE_BYTES)
        element = width * dtype.itemsize
        stride = self._whole(view, "byteStride", element, 252, element) if "byteStride" in view else element
        if start + size > len(buffer):
            raise self.error(f"buffer view {index} ends at byte {start + size} of {len(buffer)}")
        if offset + (count - 1) * stride + element > size:
            raise self.error(f"an accessor of {count} elements does not fit into the {size} bytes of its buffer view")
        return np.ndarray((count, width), dtype, buffer, start + offset, (stride, dtype.itemsize))

    def accessor(self, index, count: int | None = None) -> np.ndarray:
        """(count, width) float32 or integers of an accessor; normalised integers become floats.

        ``count``: what the accessor must hold, checked before memory is taken. Raises on NaN and infinity.
        """
        entry = self.item("accessors", index)
        if entry.get("componentType") not in _COMPONENTS or entry.get("type") not in _TYPES:
            raise self.error(f"accessor {index} has an unknown component type or type")
        dtype, width = np.dtype(_COMPONENTS[entry["componentType"]]), _TYPES[entry["type"]]
        declared = self._whole(entry, "count", 1, MAX_VALUES)
        if count is not None and declared != count:
            raise self.error(f"accessor {index} holds {declared} elements, {count} are expected")
        self.spend(declared * width, zeros="bufferView" not in entry)
        if "bufferView" in entry:
            offset = self._whole(entry, "byteOffset", 0, MAX_FILE_BYTES, 0)
            values = self._view(entry["bufferView"], dtype, width, declared, offset).copy()
        elif count is None and "sparse" not in entry:
            raise self.error(f"accessor {index} has no data")
        else:
            values = np.zeros((declared, width), dtype)
        if "sparse" in entry:
            self._fill_sparse(entry["sparse"], values)
        if dtype.kind == "f" and not np.isfinite(values).all():
            raise self.error(f"accessor {index} holds NaN or infinite values")
        if entry.get("normalized") and dtype.kind in "iu":
            return np.maximum(values / np.float32(np.iinfo(dtype).max), np.float32(-1.0)).astype(np.float32)
        return values

    def spend(self, values: int, zeros: bool = False) -> None:
        """Account for values about to be allocated; ``zeros``: the file holds no data for them. Raises when too many."""
        self._read_values += values
        self._zeros += values if zeros else 0
        if self._read_values > MAX_VALUES:
            raise self.error(f"its accessors hold more than {MAX_VALUES} values")
        if self._zeros > FREE_ZEROS + ZEROS_PER_BYTE * self.path.stat().st_size:
            raise self.error(f"it declares {self._zeros} values without data, far more than its size explains")

    def _fill_sparse(self, sparse: dict, values: np.ndarray) -> None:
        count = self._whole(sparse, "count", 1, len(values))
        indices, data = sparse["indices"], sparse["values"]
        if indices.get("componentType") not in (5121, 5123, 5125):
            raise self.error("sparse indices of an unknown component type")
        kind = np.dtype(_COMPONENTS[indices["componentType"]])
        offset = self._whole(indices, "byteOffset", 0, MAX_FILE_BYTES, 0)
        at = self._view(indices["bufferView"], kind, 1, count, offset)[:, 0]
        if at.max() >= len(values):
            raise self.error(f"a sparse index {at.max()} points outside {len(values)} elements")
        offset = self._whole(data, "byteOffset", 0, MAX_FILE_BYTES, 0)
        values[at] = self._view(data["bufferView"], values.dtype, values.shape[1], count, offset)

    def triangles(self, primitive: dict, n_vertices: int) -> np.ndarray:
        """(T, 3) int32 of a triangle primitive."""
        if "indices" in primitive:
            corners = self.accessor(primitive["indices"])
            if corners.shape[1] != 1 or corners.dtype.kind != "u":
                raise self.error("indices must be unsigned whole numbers")
            corners = corners[:, 0]
        else:
            corners = np.arange(n_vertices, dtype=np.uint32)
        if len(corners) % 3:
            raise self.error(f"{len(corners)} indices do not make triangles")
        if corners.max() >= n_vertices:
            raise self.error(f"index {corners.max()} points outside the {n_vertices} vertices")
        return corners.astype(np.int32).reshape(-1, 3)

    # ---- nodes ----
    def world_transforms(self) -> dict[int, np.ndarray]:
        """Node number -> (4, 4), for every node; a node with two parents or in a circle is an error."""
        nodes = self.items("nodes")
        children = [self._children(node, len(nodes)) for node in nodes]
        parents = [0] * len(nodes)
        for below in children:
            for child in below:
                parents[child] += 1
                if parents[child] > 1:
                    raise self.error(f"node {child} has two parents")
        world: dict[int, np.ndarray] = {}
        stack = [(number, np.eye(4)) for number, count in enumerate(parents) if count == 0]
        while stack:
            number, above = stack.pop()
            world[number] = above @ self._local(nodes[number])
            stack += [(child, world[number]) for child in children[number]]
        if len(world) < len(nodes):
            lost = next(number for number in range(len(nodes)) if number not in world)
            raise self.error(f"node {lost} lies in a circle of nodes")
        return world

    def _children(self, node: dict, count: int) -> list[int]:
        children = node.get("children", [])
        if not isinstance(children, list) or any(type(c) is not int or not 0 <= c < count for c in children):
            raise self.error(f"a node's children point outside the {count} nodes")
        return children

    def _local(self, node: dict) -> np.ndarray:
        if "matrix" in node:
            return self._numbers(node["matrix"], 16).reshape(4, 4).T
        x, y, z, w = self._numbers(node.get("rotation", [0, 0, 0, 1]), 4)
        norm = x * x + y * y + z * z + w * w
        if norm < 1e-12:
            raise self.error("a node's rotation is zero")
        s = 2.0 / norm
        turn = np.array([
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ])  # fmt: skip
        out = np.eye(4)
        out[:3, :3] = turn * self._numbers(node.get("scale", [1, 1, 1]), 3)
        out[:3, 3] = self._numbers(node.get("translation", [0, 0, 0]), 3)
        return out

    def _numbers(self, values, count: int) -> np.ndarray:
        if not isinstance(values, list) or len(values) != count or any(type(v) not in (int, float) for v in values):
            raise self.error(f"a node's transform is not made of {count} numbers")
        out = np.array(values, float)
        if not (np.abs(out) < 1e9).all():
            raise self.error("a node's transform is not finite")
        return out
