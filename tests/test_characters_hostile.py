"""Broken and malicious character files: one clear error each, in bounded time and memory."""

from __future__ import annotations

import base64
import json
import struct
import time
import tracemalloc

import numpy as np
import pytest
from written import read_glb_animation

from adaptiveface.errors import AdaptiveFaceError, FileFormatError
from adaptiveface.export.animation import AnimatedMesh
from adaptiveface.export.gltf import write_glb
from adaptiveface.retargeting.character import Character
from adaptiveface.retargeting.loading import load_character

MUTATIONS, LONGEST_S = 600, 5.0  # of processor time


def small_character() -> Character:
    rng = np.random.default_rng(0)
    points = rng.normal(size=(40, 3))
    points *= 100 / np.linalg.norm(points, axis=1, keepdims=True)
    triangles = np.array([[i, (i + 1) % 40, (i + 7) % 40] for i in range(40)], np.int32)
    shapes = rng.normal(size=(3, 40, 3))
    shapes[:, :25] = 0
    return Character("small", points, triangles, ("jawOpen", "eyeBlinkLeft", "browDown_R"), shapes)


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    """A small .glb: its bytes, its JSON object, its binary chunk."""
    c = small_character()
    rigid = np.tile(np.eye(4), (4, 1, 1))
    mesh = AnimatedMesh(
        c.name,
        c.neutral,
        c.triangles,
        c.expression_names,
        c.expressions,
        np.random.default_rng(1).uniform(size=(4, 3)),
        np.arange(4) / 30,
        rigid,
    )
    path = tmp_path_factory.mktemp("good") / "small.glb"
    write_glb(path, mesh)
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    assert len(load_character(path).expression_names) == 3
    return data, json.loads(data[20 : 20 + size]), data[28 + size :]


def pack(document, binary: bytes) -> bytes:
    text = document if isinstance(document, bytes) else json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def refused(path, reason: str | None = None) -> str:
    """Loading ends in one clear error that names the file, in time and without taking memory."""
    tracemalloc.start()
    start = time.thread_time()
    with pytest.raises(FileFormatError, match=reason) as caught:
        load_character(path)
    elapsed, (_, peak) = time.thread_time() - start, tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert elapsed < LONGEST_S and peak < 200e6
    assert path.name in str(caught.value) and "\n" not in str(caught.value)
    return str(caught.value)


def edited(good, change) -> bytes:
    document = json.loads(json.dumps(good[1]))
    change(document)
    return pack(document, good[2])


def _position(d) -> dict:
    return d["accessors"][d["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]


def _circle(d) -> None:
    d["nodes"][1]["children"] = [0]


def _long_circle(d) -> None:
    count = 5000
    d["nodes"] = [{"children": [(i + 1) % count]} for i in range(count)]


def _two_parents(d) -> None:
    d["nodes"] += [{"children": [1]}]


def _set(*keys):
    def change(d):
        at = d
        for key in keys[:-2]:
            at = at[key]
        at[keys[-2]] = keys[-1]

    return change


CASES = {
    "node in a circle": (_circle, "circle|parents"),
    "a circle of 5000 nodes": (_long_circle, "circle"),
    "two parents": (_two_parents, "two parents"),
    "child outside": (_set("nodes", 0, "children", [99]), "outside"),
    "huge count": (lambda d: _position(d).update(count=10**9), "whole number|does not fit"),
    "count beyond the view": (lambda d: _position(d).update(count=100), "does not fit"),
    "huge zero target": (
        lambda d: d["accessors"].__setitem__(
            d["meshes"][0]["primitives"][0]["targets"][0]["POSITION"],
            {"componentType": 5126, "count": 150_000_000, "type": "VEC3"},
        ),
        "expected",
    ),
    "huge positions from a sparse accessor": (
        lambda d: d["accessors"].__setitem__(
            d["meshes"][0]["primitives"][0]["attributes"]["POSITION"],
            {
                "componentType": 5126,
                "count": 30_000_000,
                "type": "VEC3",
                "sparse": d["accessors"][d["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]]["sparse"],
            },
        ),
        "without data",
    ),
    "huge buffer": (_set("buffers", 0, "byteLength", 2**40), "whole number"),
    "buffer longer than the file": (_set("buffers", 0, "byteLength", 10**8), "declares"),
    "view beyond the buffer": (_set("bufferViews", 0, "byteLength", 10**8), "ends at"),
    "negative offset": (_set("bufferViews", 0, "byteOffset", -4), "whole number"),
    "negative count": (lambda d: _position(d).update(count=-1), "whole number"),
    "count as text": (lambda d: _position(d).update(count="40"), "whole number"),
    "unknown type": (lambda d: _position(d).update(type="VEC9"), "unknown"),
    "no targets": (lambda d: d["meshes"][0]["primitives"][0].pop("targets"), "morph targets"),
    "empty targets": (_set("meshes", 0, "primitives", [{"attributes": {"POSITION": 0}, "targets": []}]), "morph targets"),
    "names missing": (lambda d: d["meshes"][0].pop("extras"), "ARKit"),
    "too few names": (_set("meshes", 0, "extras", {"targetNames": ["jawOpen"]}), "target names"),
    "names are numbers": (_set("meshes", 0, "extras", {"targetNames": [1, 2, 3]}), "names"),
    "mesh outside": (_set("nodes", 1, "mesh", 7), "outside"),
    "NaN matrix": (_set("nodes", 1, "matrix", [1e308] * 16), "finite"),
    "zero rotation": (_set("nodes", 1, "rotation", [0, 0, 0, 0]), "zero"),
    "compressed": (lambda d: d.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco"),
    "nodes is a number": (lambda d: d.update(nodes=5), "list of objects"),
    "primitive without attributes": (_set("meshes", 0, "primitives", [{"targets": [{}]}]), "malformed"),
    "stride too small": (_set("bufferViews", 0, "byteStride", 4), "byteStride"),
}


@pytest.mark.parametrize("name", CASES)
def test_each_kind_of_damage_has_its_message(good, tmp_path, name):
    change, reason = CASES[name]
    path = tmp_path / "bad.glb"
    path.write_bytes(edited(good, change))
    refused(path, reason)


def test_nan_and_indices_in_the_data(good, tmp_path):
    document, binary = good[1], good[2]
    view = document["bufferViews"][_position(document)["bufferView"]]
    nan = bytearray(binary)
    nan[view["byteOffset"] : view["byteOffset"] + 4] = struct.pack("<f", float("nan"))
    (tmp_path / "nan.glb").write_bytes(pack(document, bytes(nan)))
    refused(tmp_path / "nan.glb", "NaN")
    indices = document["accessors"][document["meshes"][0]["primitives"][0]["indices"]]
    view = document["bufferViews"][indices["bufferView"]]
    far = bytearray(binary)
    far[view["byteOffset"] : view["byteOffset"] + 2] = struct.pack("<H", 40)
    (tmp_path / "far.glb").write_bytes(pack(document, bytes(far)))
    refused(tmp_path / "far.glb", "index 40 points outside the 40 vertices")
    target = document["accessors"][document["meshes"][0]["primitives"][0]["targets"][0]["POSITION"]]
    view = document["bufferViews"][target["sparse"]["indices"]["bufferView"]]
    sparse = bytearray(binary)
    sparse[view["byteOffset"] : view["byteOffset"] + 2] = struct.pack("<H", 999)
    (tmp_path / "sparse.glb").write_bytes(pack(document, bytes(sparse)))
    refused(tmp_path / "sparse.glb", "sparse index 999")


@pytest.mark.parametrize(
    "uri",
    [
        "../secret.bin",
        "/etc/passwd",
        "file:///etc/passwd",
        "http://127.0.0.1/x.bin",
        "sub/../../secret.bin",
        "%2e%2e/secret.bin",
        "..\\secret.bin",
        "C:\\secret.bin",
        "link.bin",
        "//host/share.bin",
        "\0.bin",
        7,
        None,
    ],
)
def test_uris_never_leave_the_folder(good, tmp_path, uri):
    (tmp_path / "secret.bin").write_bytes(good[2])
    folder = tmp_path / "character"
    (folder / "sub").mkdir(parents=True)
    (folder / "link.bin").symlink_to(tmp_path / "secret.bin")
    document = json.loads(json.dumps(good[1]))
    document["buffers"][0]["uri"] = uri
    path = folder / "bad.gltf"
    path.write_text(json.dumps(document))
    refused(path, "leaves the file's folder|URI is not text")


def test_uris_inside_the_folder_and_data_uris_are_read(good, tmp_path):
    document = json.loads(json.dumps(good[1]))
    (tmp_path / "my data.bin").write_bytes(good[2])
    document["buffers"][0]["uri"] = "my%20data.bin"
    (tmp_path / "good.gltf").write_text(json.dumps(document))
    beside = load_character(tmp_path / "good.gltf")
    document["buffers"][0]["uri"] = "data:application/octet-stream;base64," + base64.b64encode(good[2]).decode()
    (tmp_path / "data.gltf").write_text(json.dumps(document))
    np.testing.assert_array_equal(load_character(tmp_path / "data.gltf").expressions, beside.expressions)
    document["buffers"][0]["uri"] = "data:application/octet-stream;base64,%%%"
    (tmp_path / "bad.gltf").write_text(json.dumps(document))
    refused(tmp_path / "bad.gltf", "base64")


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"glTF",
        b"glTF" + bytes(16),
        b"\x00" * 100,
        b"{",
        b"[]",
        b"null",
        b"[" * 100_000,
        b'{"a":' * 50_000,
        b'{"nodes": NaN}',
        b'{"asset": ' + b"9" * 10_000 + b"}",
        b"\xff\xfe\x00",
        b"{}",
        pack(b"{}", b""),
        pack(b"[[[[", b""),
        struct.pack("<4sII", b"glTF", 1, 20) + bytes(8),
        struct.pack("<4sIII4s", b"glTF", 2, 20, 2**31, b"JSON"),
    ],
)
def test_files_that_are_no_gltf(tmp_path, data):
    path = tmp_path / "bad.glb"
    path.write_bytes(data)
    refused(path)


def _mutated_json(value, rng: np.random.Generator):
    """The JSON object with one randomly chosen value replaced or removed."""
    strange = [None, -1, 0, 1, 7, 2**31, 2**63, 1e308, -0.5, "", "x" * 300, "../x", [], {}, [[]], True, [1e30] * 16]
    document = json.loads(json.dumps(value))
    at, parent, key = document, None, None
    for _ in range(int(rng.integers(2, 9))):
        if isinstance(at, dict) and at:
            parent, key = at, list(at)[rng.integers(len(at))]
        elif isinstance(at, list) and at:
            parent, key = at, int(rng.integers(len(at)))
        else:
            break
        at = parent[key]
    if rng.random() < 0.2:
        del parent[key]
    else:
        parent[key] = strange[rng.integers(len(strange))]
    return document


def _mutation(good, seed: int) -> bytes:
    data, document, binary = good
    rng = np.random.default_rng([seed, 0xBAD])
    kind = rng.integers(4)
    if kind == 0:  # bytes anywhere
        out = bytearray(data)
        for at in rng.integers(0, len(out), int(rng.integers(1, 20))):
            out[at] = rng.integers(256)
        return bytes(out)
    if kind == 1:  # bytes of the header and the JSON
        out = bytearray(data)
        end = 20 + struct.unpack_from("<I", data, 12)[0]
        for at in rng.integers(0, end, int(rng.integers(1, 5))):
            out[at] = rng.integers(256)
        return bytes(out)
    if kind == 2:  # cut or doubled
        at = int(rng.integers(0, len(data)))
        return data[:at] if rng.random() < 0.7 else data[:at] + data[at // 2 :]
    for _ in range(int(rng.integers(1, 4))):
        document = _mutated_json(document, rng)
    return pack(document, binary)


def test_hundreds_of_mutated_files_end_in_one_clear_error_or_load(good, tmp_path):
    """No traceback of another kind, no hang; what still loads is a usable character."""
    path = tmp_path / "mutated.glb"
    outcomes = {"loaded": 0, "refused": 0}
    slowest = 0.0
    for seed in range(MUTATIONS):
        path.write_bytes(_mutation(good, seed))
        for load in (load_character, read_glb_animation):
            start = time.thread_time()
            try:
                loaded = load(path)
            except AdaptiveFaceError as error:
                assert "\n" not in str(error) and len(str(error)) < 600, seed
                assert "mutated.glb" in str(error)
                outcomes["refused"] += 1
            else:
                outcomes["loaded"] += 1
                assert np.isfinite(loaded.neutral).all() and loaded.triangles.max() < len(loaded.neutral)
                if load is load_character:
                    assert np.isfinite(loaded.expressions).all()
                    assert loaded.expressions.shape == (len(loaded.expression_names), *loaded.neutral.shape)
            slowest = max(slowest, time.thread_time() - start)
    assert slowest < LONGEST_S
    assert outcomes["refused"] > MUTATIONS // 2 and outcomes["loaded"] > 20, outcomes


def test_mutated_character_npz(tmp_path):
    path = tmp_path / "small.npz"
    small_character().save(path)
    data = path.read_bytes()
    for seed in range(60):
        rng = np.random.default_rng([seed, 0x0FF])
        out = bytearray(data)
        for at in rng.integers(0, len(out), int(rng.integers(1, 12))):
            out[at] = rng.integers(256)
        path.write_bytes(bytes(out[: rng.integers(1, len(out))] if rng.random() < 0.3 else out))
        try:
            loaded = load_character(path)
        except AdaptiveFaceError as error:
            assert "small.npz" in str(error)
        else:
            assert np.isfinite(loaded.neutral).all()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(skin=np.array(-1)), "'skin' = -1, but there are"),
        (dict(skin=np.array(10**6)), "'skin' = 1000000, but there are"),
        (dict(moving=np.array([10**6])), "'expressions' has shape"),
        (dict(triangles=np.array([[0, 1, 10**6]])), "'triangles' points outside"),
        (dict(expressions=None), "'expressions' is missing"),
    ],
)
def test_a_wrong_character_npz_says_what_is_wrong(tmp_path, change, words):
    path = tmp_path / "small.npz"
    small_character().save(path)
    with np.load(path) as stored:
        known = dict(stored) | change
    np.savez(path, **{name: values for name, values in known.items() if values is not None})
    with pytest.raises(FileFormatError, match=words):
        load_character(path)


def test_mutated_obj_folders(tmp_path):
    good = "v 0 0 0\nv 200 0 0\nv 0 200 0\nv 0 0 200\nf 1 2 3\nf 1/1/1 2/2/2 4/4/4\n"
    for seed in range(60):
        rng = np.random.default_rng([seed, 0x0B1])
        for name in ("neutral.obj", "jawOpen.obj"):
            out = bytearray(good.encode())
            if rng.random() < 0.7:
                for at in rng.integers(0, len(out), int(rng.integers(1, 4))):
                    out[at] = rng.integers(256)
            (tmp_path / name).write_bytes(bytes(out))
        try:
            loaded = load_character(tmp_path)
        except AdaptiveFaceError as error:
            assert str(tmp_path) in str(error)
        else:
            assert np.isfinite(loaded.neutral).all() and np.isfinite(loaded.expressions).all()
