"""Characters: built in, from OBJ folders, glTF and VRM; the ARKit names and weights."""

from __future__ import annotations

import json
import struct
from importlib.resources import files

import numpy as np
import pytest
import trimesh
from export_scene import tracked_result
from PIL import Image
from scipy import ndimage
from written import read_glb_animation, write_obj_shapes

from adaptiveface import cli
from adaptiveface.errors import FileFormatError, ParameterError
from adaptiveface.export.animation import character_animation
from adaptiveface.export.arkit_csv import read_arkit_csv
from adaptiveface.export.gltf import write_glb
from adaptiveface.formats.obj import write_obj
from adaptiveface.geometry.mesh import boundary_edges, surface_points
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.retargeting import BUILT_IN
from adaptiveface.retargeting.arkit import ARKIT_NAMES, arkit_weights, canonical_name
from adaptiveface.retargeting.character import Character
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.portrait import portrait
from adaptiveface.retargeting.retarget import Performance, coverage


def performance(frames: int = 3) -> Performance:
    curves = np.random.default_rng(0).uniform(0, 1, (frames, len(ARKIT_NAMES)))
    return Performance(curves, np.arange(frames) / 30, np.tile(np.diag([1.0, -1, -1, 1]), (frames, 1, 1)))


def sphere(rows: int = 12, columns: int = 17) -> tuple[np.ndarray, np.ndarray]:
    """A head of another topology: a closed ball of 240 mm, quads as triangles."""
    a, b = np.meshgrid(np.linspace(0.05, np.pi - 0.05, rows), 2 * np.pi * np.arange(columns) / columns, indexing="ij")
    points = 120 * np.stack([np.sin(a) * np.sin(b), np.cos(a), np.sin(a) * np.cos(b)], axis=-1).reshape(-1, 3)
    triangles = []
    for r in range(rows - 1):
        for c in range(columns):
            i, j = r * columns + c, r * columns + (c + 1) % columns
            triangles += [[i, i + columns, j], [j, i + columns, j + columns]]
    return points, np.array(triangles)


# ---- ARKit names and weights ----


@pytest.mark.parametrize(
    ("name", "arkit"),
    [
        ("jawOpen", "jawOpen"),
        ("JAWOPEN", "jawOpen"),
        ("eyeBlink_L", "eyeBlinkLeft"),
        ("EyeBlinkRight", "eyeBlinkRight"),
        ("mouth_smile_right", "mouthSmileRight"),
        ("browInnerUp_L", "browInnerUp"),
        ("blendShape1.jawOpen", "jawOpen"),
        ("cheekPuff_R", "cheekPuff"),
        ("jaw-left", "jawLeft"),
        ("jawRight", "jawRight"),
        ("mouthLeft", "mouthLeft"),
        ("Fcl_ALL_Joy", None),
        ("", None),
        ("identity000", None),
    ],
)
def test_names_in_any_spelling(name, arkit):
    assert canonical_name(name) == arkit


def test_weights_go_both_ways():
    table = arkit_weights(embedded_face_model().generic_names)
    assert table.matrix.shape == (23, 52) and not table.unknown
    x = np.random.default_rng(1).uniform(0, 0.6, (20, 23))
    np.testing.assert_allclose(table.coefficients(x @ table.matrix), x, atol=1e-6)


def test_weights_are_the_mixtures_of_the_model():
    model = embedded_face_model()
    table = arkit_weights(model.generic_names)
    units = {canonical_name(name): unit for name, unit in zip(model.expression_names, model.expressions, strict=True)}
    mixed = sum(w * units[n] for n, w in zip(ARKIT_NAMES, table.matrix[5], strict=True) if w)
    np.testing.assert_allclose(mixed, model.generic_expressions[5], atol=1e-6)


def test_unknown_expressions_are_listed():
    table = arkit_weights(["jawOpen", "wiggleEars"])
    assert table.unknown == ("wiggleEars",) and not table.matrix[1].any()
    with pytest.raises(Exception, match="wiggleEars"):
        arkit_weights(["wiggleEars"])


# ---- built in ----


def test_built_in_characters_are_small():
    size = sum((files("adaptiveface") / "assets" / f"characters_{name}.npz").stat().st_size for name in BUILT_IN)
    assert size < 1_500_000


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_character_is_complete(name):
    character, model = load_character(name), embedded_face_model()
    assert set(character.expression_names) == set(ARKIT_NAMES) and not character.missing and not character.unknown
    assert character.shares_topology(model.triangles)
    assert np.linalg.norm(character.expressions, axis=2).max(axis=1).min() > 0.5  # every shape is seen to move
    skin = character.neutral[: character.skin]
    shape = np.linalg.norm(skin - skin.mean(0) - (model.mean - model.mean.mean(0)), axis=1)[model.frontal]
    assert shape.mean() > 6  # far from any actor: two adults of the model differ by 3 mm


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_character_blinks_and_opens_its_mouth(name):
    character, model = load_character(name), embedded_face_model()

    def features(**weights):
        w = np.zeros(len(character.expression_names))
        for key, value in weights.items():
            w[character.expression_names.index(key)] = value
        return surface_points(character.shape(w)[: character.skin], model.feature_triangles, model.feature_weights)

    def lids(points):  # middle of the upper and lower lid of both eyes: iBUG 37, 38 over 41, 40; 43, 44 over 47, 46
        return np.array(
            [points[[9, 10]].mean(0) - points[[12, 13]].mean(0), points[[15, 16]].mean(0) - points[[18, 19]].mean(0)]
        )[:, 1]

    rest, shut = lids(features()), lids(features(eyeBlinkLeft=1, eyeBlinkRight=1))
    assert (rest > 3).all() and (shut < 0.25 * rest).all()
    gap = [features(jawOpen=v)[34, 1] - features(jawOpen=v)[38, 1] for v in (0, 1)]  # inner lips: iBUG 62 over 66
    assert gap[0] < 2.5 and gap[1] > 15
    assert features(jawOpen=1)[38, 1] < features()[38, 1] - 10


@pytest.mark.parametrize("name", BUILT_IN)
def test_no_light_shines_through_the_open_mouth(name):
    character = load_character(name)
    loops = boundary_edges(character.triangles[:13804])
    assert len(loops)  # the skin alone is open
    w = np.zeros(len(character.expression_names))
    w[character.expression_names.index("jawOpen")] = 1.0
    image = portrait(character, character.shape(w), 160)
    background = (image == 255).all(axis=2)
    background[[0, -1]] = background[:, [0, -1]] = True
    _, regions = ndimage.label(background)
    assert regions == 1  # all background is joined to the picture's border: no holes


def test_saving_rounds_to_a_hundredth_of_a_millimetre(tmp_path):
    model = embedded_face_model()
    plain = Character("plain", model.mean, model.triangles, model.expression_names, model.expressions, skin=len(model.mean))
    plain.save(tmp_path / "plain.npz")
    again = load_character(tmp_path / "plain.npz")
    assert np.abs(again.expressions - plain.expressions).max() < 0.0201
    assert again.expression_names == plain.expression_names and again.skin == plain.skin


def test_unknown_character_is_refused():
    with pytest.raises(ParameterError, match="baby, hag, ogre"):
        load_character("nobody")


# ---- folders of OBJ files ----


def test_any_arkit_named_obj_folder_retargets(tmp_path):
    points, triangles = sphere()
    jaw = np.where(points[:, 1:2] < -40, [0.0, -20.0, 3.0], 0.0)
    smile = np.where(points[:, :1] > 40, [0.0, 8.0, 0.0], 0.0)
    for scale, folder in ((1.0, "mm"), (0.1, "cm"), (0.001, "m")):
        (tmp_path / folder).mkdir()
        for name, shape in (("Neutral", 0), ("JawOpen", jaw), ("mouthSmile_L", smile), ("wiggleEars", smile)):
            rows = [f"v {x:.7f} {y:.7f} {z:.7f}" for x, y, z in scale * (points + shape)]
            faces = [f"f {a}/1/1 {b}/1/1 {c}/1/1" for a, b, c in triangles + 1]
            (tmp_path / folder / f"{name}.obj").write_text("\n".join(["# a head", *rows, *faces]))
        character = load_character(tmp_path / folder)
        assert character.unknown == ("wiggleEars",) and "eyeBlinkLeft" in character.missing
        np.testing.assert_allclose(character.neutral, points, atol=0.01)
        curves = np.zeros((1, 52))
        curves[0, ARKIT_NAMES.index("jawOpen")] = 0.5
        curves[0, ARKIT_NAMES.index("mouthSmileLeft")] = 1.0
        driven = character.shape(character.weights(curves)[0])
        np.testing.assert_allclose(driven, points + 0.5 * jaw + smile, atol=0.01)
    lines = coverage(arkit_weights(embedded_face_model().generic_names), character)
    assert any("wiggleEars" in line for line in lines) and any("eyeBlinkLeft" in line for line in lines)
    mesh = character_animation(character, performance())
    write_glb(tmp_path / "ball.glb", mesh)
    assert load_character(tmp_path / "ball.glb").expression_names == character.expression_names


def low_poly_head() -> tuple[trimesh.Trimesh, dict[str, np.ndarray]]:
    """A crude head and its displacements: an ellipsoid with nose and ears of their own, made by nothing of ours."""
    skull = trimesh.creation.icosphere(subdivisions=2, radius=1.0)
    skull.apply_scale([75, 110, 90])
    nose = trimesh.creation.cone(radius=12, height=30, sections=7)
    nose.apply_translation([0, -5, 85])
    ears = [
        trimesh.creation.box(extents=[8, 40, 25], transform=trimesh.transformations.translation_matrix([x, 0, 0]))
        for x in (-78, 78)
    ]
    head = trimesh.util.concatenate([skull, nose, *ears])
    x, y, z = head.vertices.T
    front = z > 20
    chin, brow = np.clip((-20 - y) / 80, 0, 1) * front, np.exp(-(((y - 45) / 15) ** 2)) * front
    corner = np.exp(-(((np.abs(x) - 35) / 15) ** 2) - ((y + 40) / 15) ** 2) * front
    return head, {
        "JawOpen": chin[:, None] * [0.0, -30.0, -5.0],
        "browInnerUp": brow[:, None] * [0.0, 12.0, 0.0],
        "mouthSmile_L": (corner * (x > 0))[:, None] * [6.0, 9.0, 0.0],
        "MouthSmileRight": (corner * (x < 0))[:, None] * [-6.0, 9.0, 0.0],
        "cheekPuff": (np.abs(x) > 40)[:, None] * front[:, None] * np.array(head.vertex_normals) * 6.0,
    }


def test_a_head_of_foreign_topology_retargets_without_code(tmp_path, capsys):
    """Only files and commands: OBJ files as trimesh writes them, then ``export`` to every format."""
    head, shapes = low_poly_head()
    assert len(head.vertices) < 300 and len(head.split(only_watertight=False)) == 4
    folder = tmp_path / "blocky"
    folder.mkdir()
    for name, shape in {"neutral": 0, **shapes}.items():
        moved = trimesh.Trimesh(head.vertices + shape, head.faces, process=False)
        moved.export(folder / f"{name}.obj")
    actor, result, _ = tracked_result()
    actor.save(tmp_path / "actor.npz")
    result.save(tmp_path / "result.npz")
    for kind, out in (("glb", "b.glb"), ("arkit-csv", "b.csv"), ("obj", "b"), ("gif", "b.gif")):
        command = [
            "export",
            str(tmp_path / "result.npz"),
            "--character",
            str(folder),
            "--format",
            kind,
            "--out",
            str(tmp_path / out),
        ]
        assert cli.main(command) == 0
    said = capsys.readouterr().out
    assert "blocky lacks: " in said and "eyeBlinkLeft" in said  # nothing is dropped silently
    mesh = read_glb_animation(tmp_path / "b.glb")
    assert len(mesh.neutral) == len(head.vertices) and np.array_equal(mesh.triangles, head.faces)
    curves = read_arkit_csv(tmp_path / "b.csv").curves
    expected = np.array(head.vertices)[None] + sum(
        curves[:, ARKIT_NAMES.index(canonical_name(name)), None, None] * shape for name, shape in shapes.items()
    )
    got = np.stack([mesh.shape(f) for f in range(len(mesh))])
    np.testing.assert_allclose(got, expected, atol=0.02)
    assert np.linalg.norm(expected - head.vertices, axis=2).max() > 10  # it does move
    assert len(list((tmp_path / "b").glob("*.obj"))) == len(result)
    with Image.open(tmp_path / "b.gif") as picture:
        assert picture.n_frames > 3


def test_ict_facekit_layout(tmp_path):
    points, triangles = sphere()
    half = np.where(points[:, :1] > 0, [0.0, 5.0, 0.0], 0.0)
    write_obj(tmp_path / "generic_neutral_mesh.obj", points / 10, triangles)
    write_obj(tmp_path / "browInnerUp_L.obj", (points + half) / 10, triangles)
    write_obj(tmp_path / "browInnerUp_R.obj", (points + [0.0, 5.0, 0.0] - half) / 10, triangles)
    write_obj(tmp_path / "identity000.obj", points / 9, triangles)
    character = load_character(tmp_path)
    assert character.expression_names == ("browInnerUp",)
    np.testing.assert_allclose(character.expressions[0], np.tile([0.0, 5.0, 0.0], (len(points), 1)), atol=0.01)
    assert any("browInnerUp_L + browInnerUp_R" in note for note in character.notes)
    assert any("identity" in note for note in character.notes)


def test_obj_shapes_round_trip(tmp_path):
    points, triangles = sphere()
    (tmp_path / "in").mkdir()
    write_obj(tmp_path / "in" / "neutral.obj", points, triangles)
    write_obj(tmp_path / "in" / "jawOpen.obj", points + np.where(points[:, 1:2] < 0, [0, -9.0, 0], 0), triangles)
    character = load_character(tmp_path / "in")
    write_obj_shapes(tmp_path / "out", character_animation(character, performance()))
    again = load_character(tmp_path / "out")
    np.testing.assert_allclose(again.neutral, character.neutral, atol=1e-4)
    np.testing.assert_allclose(again.expressions, character.expressions, atol=1e-4)
    assert again.expression_names == character.expression_names
    assert np.array_equal(again.triangles, character.triangles)


@pytest.mark.parametrize(
    ("name", "text", "reason"),
    [
        ("neutral.obj", None, "no neutral.obj"),
        ("neutral.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "points outside"),
        ("neutral.obj", "v 0 0 0\nv 1 0 nan\nv 0 1 0\nf 1 2 3\n", "not finite"),
        ("neutral.obj", "v 0 0\nf 1 2 3\n", "three"),
        ("neutral.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf a b c\n", "not made of numbers"),
        ("jawOpen.obj", "v 0 0 0\nv 1 0 0\n", "2 vertices, but the neutral has 3"),
        ("jawOpen.obj", None, "ARKit name"),
        ("jawOpen.obj", "v 0 0 0\nv inf 0 0\nv 0 1 0\n", "not finite"),
    ],
)
def test_broken_obj_folders_end_in_one_clear_error(tmp_path, name, text, reason):
    good = "v 0 0 0\nv 200 0 0\nv 0 200 0\nf 1 2 3\n"
    texts = {"neutral.obj": good, "jawOpen.obj": good, "other.obj": good} | {name: text}
    for file, content in texts.items():
        if content is not None:
            (tmp_path / file).write_text(content)
    with pytest.raises(FileFormatError, match=reason) as caught:
        load_character(tmp_path)
    assert str(tmp_path) in str(caught.value)


# ---- VRM ----


def glb_document(path) -> tuple[dict, bytes]:
    data = path.read_bytes()
    size = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def write_document(path, document: dict, binary: bytes) -> None:
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body)


def test_vrm_expressions_and_axes(tmp_path):
    points, triangles = sphere()
    shapes = np.stack([np.where(points[:, 1:2] < -40, [0.0, -20.0, 3.0], 0.0), np.where(points > 100, 5.0, 0.0)])
    from adaptiveface.retargeting.character import Character

    character = Character("ball", points, triangles.astype(np.int32), ("morph_a", "morph_b"), shapes)
    write_glb(tmp_path / "plain.glb", character_animation(character, performance()))
    with pytest.raises(FileFormatError, match="no morph target has an ARKit name"):
        load_character(tmp_path / "plain.glb")
    document, binary = glb_document(tmp_path / "plain.glb")
    custom = {"jawOpen": {"morphTargetBinds": [{"node": 1, "index": 0, "weight": 0.5}]}}
    document["extensions"] = {"VRMC_vrm": {"expressions": {"custom": custom}}}
    write_document(tmp_path / "one.vrm", document, binary)
    one = load_character(tmp_path / "one.vrm")
    jaw = one.expressions[one.expression_names.index("jawOpen")]
    np.testing.assert_allclose(jaw, 0.5 * shapes[0], atol=1e-4)
    assert set(one.unknown) == {"morph_a", "morph_b"}
    groups = [{"name": "JawOpen", "binds": [{"mesh": 0, "index": 0, "weight": 100}]}]
    document["extensions"] = {"VRM": {"blendShapeMaster": {"blendShapeGroups": groups}}}
    write_document(tmp_path / "zero.vrm", document, binary)
    zero = load_character(tmp_path / "zero.vrm")
    jaw = zero.expressions[zero.expression_names.index("JawOpen")]
    np.testing.assert_allclose(jaw, shapes[0] * [-1, 1, -1], atol=1e-4)
    np.testing.assert_allclose(zero.neutral - zero.neutral.mean(0), (points - points.mean(0)) * [-1, 1, -1], atol=0.1)
