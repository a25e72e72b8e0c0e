"""Importers of other models: small files in each format, written here from the embedded model, and broken ones."""

import builtins
import pickle

import numpy as np
import pytest
import trimesh

from adaptiveface.errors import FileFormatError, MissingExtraError, ParameterError
from adaptiveface.geometry.frame import FEATURE_IDS, FEATURE_REGIONS
from adaptiveface.geometry.mesh import boundary_edges, surface_points, triangle_normals, vertex_normals
from adaptiveface.importers import import_face_model, load_basel, load_flame, load_gnm, load_ict_facekit
from adaptiveface.importers.assemble import arkit_generic, component_generic, read_feature_vertices
from adaptiveface.importers.association import associate, features_at
from adaptiveface.model.face_model import embedded_face_model, load_face_model, save_face_model

h5py = pytest.importorskip("h5py")
UNITS = ("jawOpen", "mouthSmileLeft", "mouthSmileRight", "browInnerUp", "eyeBlinkLeft", "mouthPucker")
SHIFT = np.array([0.0, 35.0, -60.0])  # where the foreign heads lie, mm


@pytest.fixture(scope="module")
def own():
    return embedded_face_model()


@pytest.fixture(scope="module")
def foreign(own):
    """Somebody else's model: another mean head, other vertex numbers, few modes; in mm and our axes."""
    rng = np.random.default_rng(4)
    order = rng.permutation(len(own.mean))
    number = np.argsort(order)
    mean = own.neutral(0.8 * rng.normal(size=50)) + SHIFT
    return {
        "mean": mean[order],
        "triangles": number[own.triangles],
        "order": order,
        "identity": own.identity_modes[:3, order],
        "units": np.stack([own.expressions[own.expression_names.index(n)] for n in UNITS])[:, order],
        "features": surface_points(mean, own.feature_triangles, own.feature_weights),
    }


def check_model(model, foreign, own, vertices=None):
    """The interface, the place in our head frame, and features where they are known to be."""
    mean = foreign["mean"] if vertices is None else vertices
    assert model.mean.shape == mean.shape
    offset = model.mean - mean
    np.testing.assert_allclose(offset, np.broadcast_to(offset[0], offset.shape), atol=1e-3)
    np.testing.assert_allclose(offset[0], -SHIFT, atol=4.0)
    features = surface_points(model.mean - offset[0], model.feature_triangles, model.feature_weights)
    error = np.linalg.norm(features - foreign["features"], axis=1)
    for region, limit in (("brows", 1.5), ("eyes", 1.2), ("lips", 1.2)):
        assert error[FEATURE_REGIONS == region].mean() < limit, region
    assert model.triangles.dtype == np.int32
    assert model.identity_modes.dtype == model.expressions.dtype == np.float32
    assert model.generic_weights.shape == (len(model.generic_names), len(model.expression_names))
    assert model.generic_expressions.shape == (len(model.generic_names), *model.mean.shape)
    assert not (model.depth_valid & ~model.frontal).any()
    assert not model.depth_valid[np.unique(boundary_edges(model.triangles))].any()


def agreement(mask, truth):
    return (mask == truth).mean()


# -- ICT-FaceKit ----------------------------------------------------------------------------------------------------


def write_obj(path, vertices, faces=()):
    lines = ["v {:.6f} {:.6f} {:.6f}".format(*v) for v in vertices]
    lines += ["vt 0.5 0.5"] + ["f " + " ".join(f"{a + 1}/1/{a + 1}" for a in face) for face in faces]
    path.write_text("\n".join(["# made by a test", *lines, ""]))


ICT_NAMES = {
    "jawOpen": "jawOpen",
    "mouthSmileLeft": "mouthSmile_L",
    "mouthSmileRight": "mouthSmile_R",
    "eyeBlinkLeft": "eyeBlink_L",
    "mouthPucker": "mouthPucker",
}


@pytest.fixture(scope="module")
def ict_folder(foreign, tmp_path_factory):
    folder = tmp_path_factory.mktemp("FaceXModel")
    ball = trimesh.creation.icosphere(subdivisions=2, radius=12)  # an eyeball, to be cut away
    more = np.array([30.0, 60.0, -70.0]) + ball.vertices
    mean = np.concatenate([foreign["mean"], more]) / 10
    n = len(foreign["mean"])
    quads = [[0 + n, 1 + n, 2 + n, 3 + n]]
    write_obj(folder / "generic_neutral_mesh.obj", mean, [*foreign["triangles"], *(ball.faces + n), *quads])

    def write(name, field):
        write_obj(folder / name, mean + np.concatenate([field, np.zeros_like(more)]) / 10)

    for k in range(2):
        write(f"identity{k:03d}.obj", foreign["identity"][k])
    for unit, field in zip(UNITS, foreign["units"], strict=True):
        if unit == "browInnerUp":  # ICT-FaceKit halves it
            left = (foreign["mean"][:, :1] > 0) * field
            write("browInnerUp_L.obj", left)
            write("browInnerUp_R.obj", field - left)
        else:
            write(ICT_NAMES[unit] + ".obj", field)
    return folder


def test_ict_facekit(ict_folder, foreign, own):
    model = import_face_model(ict_folder)
    check_model(model, foreign, own)
    assert agreement(model.frontal, own.frontal[foreign["order"]]) > 0.99
    assert agreement(model.depth_valid, own.depth_valid[foreign["order"]]) > 0.99
    halves = {"browInnerUpLeft", "browInnerUpRight"}
    assert set(model.expression_names) == set(UNITS) - {"browInnerUp"} | halves
    assert set(model.generic_names) == set(UNITS)
    for generic, unit in (("jawOpen", "jawOpen"), ("browInnerUp", "browInnerUp")):
        field = model.generic_expressions[model.generic_names.index(generic)]
        np.testing.assert_allclose(field, foreign["units"][UNITS.index(unit)], atol=1e-3)
    np.testing.assert_allclose(model.identity_modes, foreign["identity"][:2], atol=1e-3)


def test_ict_facekit_with_given_features(ict_folder, foreign, tmp_path):
    nearest = [int(np.linalg.norm(foreign["mean"] - p, axis=1).argmin()) for p in foreign["features"]]
    numbers = np.zeros(68, int)
    numbers[FEATURE_IDS] = nearest
    listing = tmp_path / "ibug68.txt"
    listing.write_text(", ".join(map(str, numbers)))
    model = load_ict_facekit(ict_folder, feature_vertices=listing)
    at = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    np.testing.assert_allclose(at, model.mean[nearest], atol=1e-9)
    outside = np.array(nearest)
    outside[3] = len(foreign["mean"]) + 5  # on the eyeball
    with pytest.raises(FileFormatError, match="not on the skin"):
        load_ict_facekit(ict_folder, feature_vertices=outside)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("generic_neutral_mesh.obj", "v 1 2 3\nf 1 2 3\n", "points outside 1..1"),
        ("generic_neutral_mesh.obj", "hello\n", "not an OBJ file"),
        ("generic_neutral_mesh.obj", "v 1 2 x\n", "three numbers"),
        ("generic_neutral_mesh.obj", "v 1 2\nv 3 4\n", "not an OBJ"),
        ("identity000.obj", "v 1 2 3\nv 1 2 3\n", "2 vertices; generic_neutral_mesh.obj has"),
        ("jawOpen.obj", "v nan 2 3\n", "vertex 1 is not finite"),
        ("jawOpen.obj", "v 1 2 3\nv 1 2\n", "three numbers|not an OBJ"),
    ],
)
def test_broken_ict_facekit(ict_folder, tmp_path, name, content, message):
    for path in ict_folder.iterdir():
        (tmp_path / path.name).symlink_to(path)
    (tmp_path / name).unlink()
    (tmp_path / name).write_text(content)
    with pytest.raises(FileFormatError, match=message) as caught:
        load_ict_facekit(tmp_path)
    assert name in str(caught.value)


def test_ict_facekit_without_its_parts(ict_folder, tmp_path):
    with pytest.raises(FileFormatError, match="generic_neutral_mesh.obj"):
        import_face_model(tmp_path)
    (tmp_path / "generic_neutral_mesh.obj").symlink_to(ict_folder / "generic_neutral_mesh.obj")
    with pytest.raises(FileFormatError, match="identity000.obj"):
        load_ict_facekit(tmp_path)


# -- Basel ----------------------------------------------------------------------------------------------------------


def write_basel(path, foreign, **change):
    """A statismo file; ``change`` replaces datasets (None leaves one out)."""
    rng = np.random.default_rng(0)

    def basis(fields):  # orthonormal columns and variances whose product spans the fields
        q, r = np.linalg.qr(fields.reshape(len(fields), -1).T)
        return q.astype(np.float32), np.abs(np.diag(r)) ** 2

    shape, shape_variance = basis(foreign["identity"])
    expression, expression_variance = basis(foreign["units"])
    drift = rng.normal(0, 0.01, foreign["mean"].size)
    datasets = {
        "shape/model/mean": (foreign["mean"].ravel() - drift).astype(np.float32),
        "shape/model/pcaBasis": shape,
        "shape/model/pcaVariance": shape_variance,
        "shape/representer/cells": foreign["triangles"].T.astype(np.int32),
        "expression/model/mean": drift.astype(np.float32),
        "expression/model/pcaBasis": expression,
        "expression/model/pcaVariance": expression_variance,
    } | {k.replace("__", "/"): v for k, v in change.items()}
    with h5py.File(path, "w") as file:
        for name, array in datasets.items():
            if array is not None:
                file[name] = array
    return path


def test_basel(foreign, own, tmp_path):
    path = write_basel(tmp_path / "model2019_face12.h5", foreign)
    model = import_face_model(path)
    check_model(model, foreign, own)
    assert model.expression_names == tuple(f"pca{k:03d}" for k in range(len(UNITS)))
    assert model.generic_names[:2] == ("pca000+", "pca000-")
    np.testing.assert_allclose(model.generic_expressions[0], 2 * model.expressions[0], atol=1e-4)
    np.testing.assert_allclose(model.generic_expressions[1], -2 * model.expressions[0], atol=1e-4)
    # The first component is the first field, up to its sign, one standard deviation long.
    first = model.identity_modes[0] * np.sign((model.identity_modes[0] * foreign["identity"][0]).sum())
    np.testing.assert_allclose(first, foreign["identity"][0], atol=1e-3)


def refused(load, path, message):
    """The loader refuses the file, and says which one and why."""
    with pytest.raises(FileFormatError, match=message) as caught:
        load(path)
    assert path.name in str(caught.value)


def test_broken_basel(foreign, tmp_path):
    def broken(message, **change):
        refused(load_basel, write_basel(tmp_path / "broken.h5", foreign, **change), message)

    broken("'expression/model/pcaBasis' is missing", expression__model__pcaBasis=None)
    broken("cells", shape__representer__cells=foreign["triangles"][:, :2])
    broken("triangles point outside", shape__representer__cells=foreign["triangles"].T + 9000)
    broken("mean holds NaN", shape__model__mean=np.full(foreign["mean"].size, np.nan, np.float32))
    broken("negative", shape__model__pcaVariance=-np.ones(3))
    broken("expected", shape__model__pcaBasis=np.zeros((30, 3), np.float32))
    broken("array of numbers", shape__model__pcaBasis=np.zeros(30, np.float32))
    broken("numbers, expected", expression__model__mean=np.zeros(9, np.float32))
    broken("vertices; a face model has", shape__model__mean=np.zeros(30, np.float32))
    broken("mm wide", shape__model__mean=(foreign["mean"].ravel() / 1000).astype(np.float32))


def test_basel_that_is_no_hdf5_or_points_elsewhere(foreign, tmp_path):
    text = tmp_path / "text.h5"
    text.write_text("not HDF5")
    with pytest.raises(FileFormatError, match="text.h5: not a readable HDF5"):
        load_basel(text)
    good = write_basel(tmp_path / "good.h5", foreign)
    cut = tmp_path / "cut.h5"
    cut.write_bytes(good.read_bytes()[:3000])
    with pytest.raises(FileFormatError, match="cut.h5"):
        load_basel(cut)
    with h5py.File(tmp_path / "linked.h5", "w") as file:
        file["shape/model"] = h5py.ExternalLink(str(good), "shape/model")
    with pytest.raises(FileFormatError, match="link to elsewhere"):
        load_basel(tmp_path / "linked.h5")
    with pytest.raises(FileFormatError, match="no such file"):
        load_basel(tmp_path / "absent.h5")


def test_basel_of_absurd_size_is_refused_before_it_is_read(tmp_path):
    path = tmp_path / "huge.h5"
    with h5py.File(path, "w") as file:  # chunked and never written: takes no space
        file.create_dataset("shape/model/mean", (3 * 10**9,), np.float32, chunks=(1 << 20,))
        file.create_dataset("shape/representer/cells", (3, 10**9), np.int32, chunks=(3, 1 << 20))
    with pytest.raises(FileFormatError, match="1000000000 vertices"):
        load_basel(path)


def test_basel_without_h5py(monkeypatch, tmp_path):
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name == "h5py":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(MissingExtraError, match=r'pip install "adaptiveface\[importers\]"'):
        load_basel(tmp_path / "any.h5")


# -- FLAME ----------------------------------------------------------------------------------------------------------


def write_flame(path, foreign, **change):
    n = len(foreign["mean"])
    directions = np.zeros((n, 3, 303), np.float32)
    directions[:, :, :3] = np.moveaxis(foreign["identity"], 0, 2) / 1000
    directions[:, :, 300:] = np.moveaxis(foreign["units"][1:4], 0, 2) / 1000
    jaw = np.zeros((n, 5))
    jaw[:, 2] = np.clip(np.linalg.norm(foreign["units"][0], axis=1) / 30, 0, 1)
    jaw[:, 0] = 1 - jaw[:, 2]
    hinge = np.zeros((5, n))
    behind = np.argsort(np.linalg.norm(foreign["mean"] - SHIFT - [0, -5, -75], axis=1))[:200]
    hinge[2, behind] = 1 / len(behind)
    arrays = {
        "v_template": foreign["mean"] / 1000,
        "shapedirs": directions,
        "f": foreign["triangles"].astype(np.uint32),
        "weights": jaw,
        "J_regressor": hinge,
        "posedirs": np.zeros((n, 3, 36), np.float32),
    } | change
    np.savez_compressed(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


def test_flame(foreign, own, tmp_path):
    model = import_face_model(write_flame(tmp_path / "flame2020.npz", foreign))
    check_model(model, foreign, own)
    assert model.expression_names == ("pca000", "pca001", "pca002", "jawOpen")
    assert model.generic_names == ("jawOpen", "pca000+", "pca000-", "pca001+", "pca001-", "pca002+", "pca002-")
    assert len(model.identity_modes) == 3, "components that move nothing are left out"
    np.testing.assert_allclose(model.expressions[0], foreign["units"][1], atol=1e-3)
    at = surface_points(model.expressions[3], model.feature_triangles, model.feature_weights)
    motion = dict(zip(model.feature_ids.tolist(), at, strict=True))
    assert motion[57][1] < -10, "the lower lip drops"
    assert abs(motion[51][1]) < 0.3 * abs(motion[57][1])


def test_broken_flame(foreign, tmp_path):
    def broken(message, **change):
        refused(load_flame, write_flame(tmp_path / "broken.npz", foreign, **change), message)

    broken("'shapedirs' is missing", shapedirs=None)
    broken("more than 300 are expected", shapedirs=np.zeros((len(foreign["mean"]), 3, 300), np.float32))
    broken("'f' points outside", f=foreign["triangles"].astype(np.uint32) + 100)
    broken("NaN", v_template=np.full_like(foreign["mean"], np.nan))
    broken("Python objects", J_regressor=np.array([[None]]))
    broken("mm wide", v_template=foreign["mean"])
    broken("shape", weights=np.zeros((3, 5)))
    whole = write_flame(tmp_path / "whole.npz", foreign).read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    for load in (load_flame, import_face_model):
        with pytest.raises(FileFormatError, match="cut.npz"):
            load(tmp_path / "cut.npz")


def test_pickles_are_refused_and_never_read(tmp_path):
    class Trap:
        def __reduce__(self):
            return (open, (str(tmp_path / "sprung"), "w"))

    for name, protocol in (("generic_model.pkl", 0), ("flame.npz", 4)):
        path = tmp_path / name
        path.write_bytes(pickle.dumps({"v_template": Trap()}, protocol=protocol))
        for load in (load_flame, import_face_model):
            with pytest.raises(FileFormatError, match="isolated") as caught:
                load(path)
            assert "np.savez" in str(caught.value) and name in str(caught.value)
    assert not (tmp_path / "sprung").exists()


def test_the_conversion_line_makes_a_readable_file(foreign, tmp_path, monkeypatch):
    """The line that the refusal prints does what it says (run here on a pickle of our own making)."""
    import subprocess
    import sys

    import scipy.sparse as sp

    with np.load(write_flame(tmp_path / "x.npz", foreign)) as arrays:
        content = dict(arrays)
    content["J_regressor"] = sp.csc_matrix(content["J_regressor"])
    (tmp_path / "flame.pkl").write_bytes(pickle.dumps(content))
    with pytest.raises(FileFormatError) as caught:
        load_flame(tmp_path / "flame.pkl")
    line = str(caught.value).split("chumpy): ")[1]
    code = line.removeprefix('python -c "').removesuffix('"')
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True)
    with np.load(tmp_path / "flame.npz", allow_pickle=False) as made:
        for name in ("v_template", "shapedirs", "f", "weights", "J_regressor"):
            assert made[name].shape == np.load(tmp_path / "x.npz")[name].shape


# -- GNM ------------------------------------------------------------------------------------------------------------


def write_gnm(path, mean, faces, identity, expressions, **change):
    """The skin and, in front of it in the file, a tongue with a component of its own."""
    ball = trimesh.creation.icosphere(subdivisions=2, radius=15)
    n = len(ball.vertices)
    inside = ball.vertices + mean.mean(axis=0) - [0, 20, 0]

    def fields(of_skin):
        return np.concatenate([np.zeros((len(of_skin), n, 3)), of_skin], axis=1) / 1000

    tongue = np.zeros((1, n + len(mean), 3))
    tongue[:, :n] = 0.004
    arrays = {
        "template_vertex_positions": (np.concatenate([inside, mean]) / 1000).astype(np.float32),
        "vertex_identity_basis": np.concatenate([fields(identity), tongue]).astype(np.float32),
        "expression_basis": np.concatenate([tongue, fields(expressions)]).astype(np.float32),
        "expression_names": np.array(["tongue_0", *(f"lower_face_region_{k}" for k in range(len(expressions)))]),
        "triangles": np.concatenate([ball.faces, faces + n]).astype(np.int32),
        "vertex_groups": np.stack([np.arange(n + len(mean)) < n, np.arange(n + len(mean)) >= n]).astype(np.float32),
        "vertex_group_names": np.array(["tongue", "skin"]),
        "version": np.array("3.0"),
    } | change
    np.savez_compressed(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


def test_gnm_with_a_finer_mesh(foreign, own, tmp_path):
    """Four times the triangles: 28 thousand vertices on a tessellation of its own."""

    def finer(values):
        return np.concatenate([values, 0.5 * (values[pairs[:, 0]] + values[pairs[:, 1]])])

    pairs = trimesh.Trimesh(foreign["mean"], foreign["triangles"], process=False).edges_unique
    mean, triangles = trimesh.remesh.subdivide(foreign["mean"], foreign["triangles"])
    order = {tuple(np.round(p, 6)): i for i, p in enumerate(finer(foreign["mean"]))}
    number = np.array([order[tuple(np.round(p, 6))] for p in mean])
    fields = [np.stack([finer(f)[number] for f in foreign[k]]) for k in ("identity", "units")]
    path = write_gnm(tmp_path / "gnm_head.npz", mean, triangles, *fields)
    model = import_face_model(path)
    check_model(model, foreign, own, vertices=mean)
    assert len(model.identity_modes) == 3 and len(model.expressions) == len(UNITS), "the tongue's modes are left out"
    assert model.expression_names[0] == "lower_face_region_0"
    np.testing.assert_allclose(model.expressions, fields[1], atol=1e-3)
    # The same model through our own layout.
    save_face_model(tmp_path / "own.npz", model)
    again = import_face_model(tmp_path / "own.npz")
    np.testing.assert_allclose(again.mean, model.mean, atol=1e-4)
    np.testing.assert_allclose(again.generic_expressions, model.generic_expressions, atol=1e-4)
    with pytest.raises(ParameterError, match="identity_modes"):
        import_face_model(tmp_path / "own.npz", identity_modes=3)


def test_broken_gnm(foreign, tmp_path):
    def broken(message, **change):
        arrays = (foreign[name] for name in ("mean", "triangles", "identity", "units"))
        refused(load_gnm, write_gnm(tmp_path / "broken.npz", *arrays, **change), message)

    broken("'expression_basis' is missing", expression_basis=None)
    broken("shape", vertex_identity_basis=np.zeros((2, 9, 3), np.float32))
    broken("'triangles' points outside", triangles=foreign["triangles"].astype(np.int32) - 5)
    broken("skin has 0 triangles", vertex_groups=np.zeros((2, len(foreign["mean"]) + 162), np.float32))
    broken("dtype", triangles=foreign["triangles"].astype(float))


# -- what they share ------------------------------------------------------------------------------------------------


def test_what_is_no_model(tmp_path):
    (tmp_path / "note.txt").write_text("hello")
    with pytest.raises(FileFormatError, match="note.txt: not a face model"):
        import_face_model(tmp_path / "note.txt")
    np.savez(tmp_path / "other.npz", a=np.zeros(3))
    with pytest.raises(FileFormatError, match="other.npz"):
        import_face_model(tmp_path / "other.npz")
    with pytest.raises(FileFormatError, match="absent.npz"):
        import_face_model(tmp_path / "absent.npz")


def test_a_mesh_that_is_no_face_is_refused(tmp_path):
    egg = trimesh.creation.icosphere(subdivisions=4, radius=1.0)
    mean = egg.vertices * [75.0, 110.0, 95.0]
    field = np.random.default_rng(0).normal(size=(2, *mean.shape))
    path = write_gnm(tmp_path / "egg.npz", mean, egg.faces, field, field)
    with pytest.raises(FileFormatError, match="egg.npz: the mean mesh is not recognised as a face"):
        load_gnm(path)


def test_association_keeps_the_lips_apart(own):
    """Upper and lower inner-lip features must not change lips, though the closed lips touch."""
    found = associate(own.mean, own.triangles)
    normals = vertex_normals(own.mean, own.triangles)
    ours = surface_points(normals, found.feature_triangles, found.feature_weights)
    true = surface_points(normals, own.feature_triangles, own.feature_weights)
    inner = np.isin(FEATURE_IDS, [61, 62, 63, 65, 66, 67])
    assert ((ours * true).sum(axis=1)[inner] > 0.5).all()
    np.testing.assert_allclose(found.offset, 0, atol=0.7)


def test_features_at_vertices(own):
    wanted = np.arange(100, 140)
    triangles, weights = features_at(wanted, own.triangles)
    np.testing.assert_array_equal((triangles * weights).sum(axis=1), wanted)
    assert {*map(tuple, triangles)} <= {*map(tuple, own.triangles)}


@pytest.mark.parametrize("given", [np.zeros(39, int), np.zeros(40), [10**6] * 40, "no such file.txt"])
def test_bad_feature_vertices(given):
    with pytest.raises(FileFormatError):
        read_feature_vertices(given, 500)


def test_arkit_mixtures_over_missing_units(tmp_path):
    weights, names = arkit_generic(("cheekPuffLeft", "cheekPuffRight", "somethingElse"), tmp_path)
    assert names == ("cheekPuff",)
    np.testing.assert_array_equal(weights, [[1, 1, 0]])
    with pytest.raises(FileFormatError, match="ARKit"):
        arkit_generic(("a", "b"), tmp_path)


def test_component_mixtures_take_the_strongest():
    rng = np.random.default_rng(0)
    size = rng.permutation(np.arange(1, 21)).astype(float)
    fields = size[:, None, None] * rng.normal(size=(20, 50, 3))
    weights, names = component_generic(fields, tuple(f"pca{k:03d}" for k in range(20)), np.ones(50, bool))
    assert len(names) == 22
    chosen = {int(n[3:6]) for n in names}
    assert size[sorted(chosen)].min() > size[sorted(set(range(20)) - chosen)].max()
    assert set(np.unique(weights)) == {-2.0, 0.0, 2.0}


def test_saved_model_is_read_back(own, tmp_path):
    save_face_model(tmp_path / "own.npz", own)
    again = load_face_model(tmp_path / "own.npz")
    assert again.expression_names == own.expression_names
    np.testing.assert_allclose(again.expressions, own.expressions, atol=1e-6)
    assert (triangle_normals(again.mean, again.triangles) == triangle_normals(own.mean, own.triangles)).all()
