"""The embedded face model: what every stage relies on, and what was mended in its expressions."""

from importlib.resources import files

import numpy as np
import pytest
import scipy.sparse as sp
from matplotlib.path import Path
from scipy.sparse.csgraph import connected_components

from adaptiveface.errors import FileFormatError
from adaptiveface.geometry.frame import FEATURE_REGIONS
from adaptiveface.geometry.mesh import (
    boundary_edges,
    edges,
    rigid_alignment,
    surface_points,
    transform_points,
    triangle_normals,
)
from adaptiveface.model.face_model import embedded_face_model, load_face_model

ASSETS = files("adaptiveface") / "assets"
ASSET = ASSETS / "face_model.npz"
ARKIT_SIDED = """
browDown browOuterUp cheekSquint eyeBlink eyeLookDown eyeLookIn eyeLookOut eyeLookUp eyeSquint
eyeWide mouthDimple mouthFrown mouthLowerDown mouthPress mouthSmile mouthStretch mouthUpperUp noseSneer
jaw mouth""".split()
ARKIT_WHOLE = """browInnerUp cheekPuff jawForward jawOpen mouthClose mouthFunnel mouthPucker mouthRollLower
mouthRollUpper mouthShrugLower mouthShrugUpper""".split()
# iBUG-68 pairs across the midline, and the inner lips' upper and lower pairs.
OPPOSITE = {
    18: 25,
    19: 24,
    20: 23,
    21: 22,
    36: 45,
    37: 44,
    38: 43,
    39: 42,
    40: 47,
    41: 46,
    48: 54,
    49: 53,
    50: 52,
    51: 51,
    55: 59,
    56: 58,
    57: 57,
    60: 64,
    61: 63,
    62: 62,
    65: 67,
    66: 66,
}
INNER_LIPS = [(61, 67), (62, 66), (63, 65)]


@pytest.fixture(scope="module")
def model():
    return embedded_face_model()


@pytest.fixture(scope="module")
def loops(model):
    """The boundary loops as vertex sets, by name."""
    border = boundary_edges(model.triangles)
    n = len(model.mean)
    _, label = connected_components(sp.coo_matrix((np.ones(len(border)), border.T), (n, n)), directed=False)
    found = [np.flatnonzero(label == k) for k in np.unique(label[border])]
    assert len(found) == 4, "openings at two eyes, mouth and neck only"
    found.sort(key=lambda ids: model.mean[ids, 1].mean())
    left, right = sorted(found[2:], key=lambda ids: -model.mean[ids, 0].mean())
    return {"neck": found[0], "mouth": found[1], "left eye": left, "right eye": right}


def features(model, vertices):
    points = surface_points(vertices, model.feature_triangles, model.feature_weights)
    return dict(zip(model.feature_ids.tolist(), points, strict=True))


def mirrored(model, field):
    return field[model.mirror] * [-1.0, 1.0, 1.0]


def test_sizes(model):
    assert 6500 <= len(model.mean) <= 7500
    n_frontal = model.frontal.sum()
    assert 3200 <= n_frontal <= 3800
    assert model.frontal[:n_frontal].all(), "frontal vertices come first"
    assert len(model.identity_modes) == 50
    assert model.eye_mean.shape == (144, 3)


def test_expression_names(model):
    sided = {name + side for name in ARKIT_SIDED for side in ("Left", "Right")}
    assert set(model.expression_names) == sided | set(ARKIT_WHOLE)
    assert len(model.expression_names) == 51
    assert len(set(model.generic_names)) == 23


def test_generic_expressions_move_the_face_and_are_independent(model):
    shapes = model.generic_expressions[:, model.frontal]
    assert (np.linalg.norm(shapes, axis=2).max(axis=1) > 3.0).all()
    flat = shapes.reshape(23, -1)
    singular = np.linalg.svd(flat / np.linalg.norm(flat, axis=1, keepdims=True), compute_uv=False)
    assert singular.min() > 0.04  # weakest: jawLeft + jawRight against jawForward


def test_exactly_symmetric(model):
    m = model.mirror
    assert (m[m] == np.arange(len(m))).all()
    np.testing.assert_array_equal(mirrored(model, model.mean), model.mean)
    np.testing.assert_array_equal(model.frontal[m], model.frontal)
    np.testing.assert_array_equal(model.depth_valid[m], model.depth_valid)
    flipped = np.sort(np.roll(m[model.triangles][:, ::-1], 0, axis=1), axis=1)
    assert {*map(tuple, flipped)} == {*map(tuple, np.sort(model.triangles, axis=1))}
    by_name = dict(zip(model.expression_names, model.expressions, strict=True))
    for name, field in by_name.items():
        opposite = name[:-4] + "Right" if name.endswith("Left") else name[:-5] + "Left" if name.endswith("Right") else name
        np.testing.assert_array_equal(mirrored(model, field), by_name[opposite], err_msg=name)
    for mode in model.identity_modes:
        parity = np.sign((mode * mirrored(model, mode)).sum())
        np.testing.assert_allclose(mirrored(model, mode), parity * mode, atol=0.02)


def test_left_is_the_subjects_left(model):
    """+x is the subject's left, and units named Left move that side more."""
    for name, field in zip(model.expression_names, model.expressions, strict=True):
        if name.endswith("Left") and name not in ("jawLeft", "mouthLeft"):
            assert np.linalg.norm(field[model.mean[:, 0] > 5]) > np.linalg.norm(field[model.mean[:, 0] < -5]), name
        if name in ("jawLeft", "mouthLeft"):
            assert field[:, 0].max() > -field[:, 0].min()


def test_topology(model, loops):
    assert set(loops) == {"neck", "mouth", "left eye", "right eye"}
    t = model.triangles
    directed = np.concatenate([t[:, [0, 1]], t[:, [1, 2]], t[:, [2, 0]]])
    assert len(np.unique(directed, axis=0)) == len(directed), "consistent winding, no edge with three triangles"
    n = len(model.mean)
    pairs = edges(t)
    count, _ = connected_components(sp.coo_matrix((np.ones(len(pairs)), pairs.T), (n, n)), directed=False)
    assert count == 1
    assert n - len(pairs) + len(t) == 2 - 4, "a sphere with four holes"
    nose = model.mean[:, 2].argmax()
    assert triangle_normals(model.mean, t)[(t == nose).any(axis=1)].sum(axis=0)[2] > 0, "normals point outwards"


def triangle_quality(vertices, triangles):
    corners = vertices[triangles]
    squares = sum(((corners[:, k] - corners[:, k - 1]) ** 2).sum(axis=1) for k in range(3))
    return 2 * np.sqrt(3) * np.linalg.norm(triangle_normals(vertices, triangles), axis=1) / squares


def test_triangles_are_well_shaped(model):
    quality = triangle_quality(model.mean, model.triangles)
    assert quality.min() > 0.4
    assert np.percentile(quality, 1) > 0.7
    length = np.linalg.norm(np.subtract(*model.mean[edges(model.triangles).T]), axis=1)
    assert 1.0 < length.min() and length.max() < 12.0


def test_sampled_identities_are_plausible_heads(model):
    rng = np.random.default_rng(11)
    rest = triangle_normals(model.mean, model.triangles)
    for _ in range(60):
        c = rng.normal(size=len(model.identity_modes))
        head = model.neutral(c)
        turned = (triangle_normals(head, model.triangles) * rest).sum(axis=1) < 0
        assert turned.mean() < 2e-3
        left, right = model.eyes(c)[:72].mean(axis=0), model.eyes(c)[72:].mean(axis=0)
        assert 50 < np.linalg.norm(left - right) < 78
        assert 120 < np.ptp(head[model.frontal][:, 0]) < 185


def test_identity_modes_are_sorted_and_rigid_free(model):
    size = np.sqrt((model.identity_modes[:, model.frontal] ** 2).sum(axis=2).mean(axis=1))
    assert size[:5].min() > size[-5:].max()
    for mode in model.identity_modes[:10]:
        moved = model.mean + mode
        rigid = rigid_alignment(model.mean[model.frontal], moved[model.frontal])
        drift = transform_points(rigid, model.mean) - model.mean
        assert np.linalg.norm(drift[model.frontal], axis=1).mean() < 0.75


def test_mouth_is_closed_and_lips_do_not_cross(model):
    def openings(vertices):
        at = features(model, vertices)
        return np.array([at[up][1] - at[low][1] for up, low in INNER_LIPS])

    assert np.abs(openings(model.mean)).max() < 1.2
    for name, field in zip(model.generic_names, model.generic_expressions, strict=True):
        assert openings(model.mean + field).min() > -1.2, name


def test_lip_profiles_do_not_cross(model):
    """In vertical slices the lowest point of the upper lip stays above the highest of the lower lip."""
    upper, lower = lip_sides(model)
    for name, field in [("neutral", 0.0), *zip(model.generic_names, model.generic_expressions, strict=True)]:
        vertices = model.mean + field
        for x in range(-14, 15, 2):
            sides = [vertices[side][np.abs(vertices[side, 0] - x) < 1.0, 1] for side in (upper, lower)]
            if all(len(side) for side in sides):
                assert sides[0].min() - sides[1].max() > -0.6, (name, x)


def lip_sides(model):
    """Vertices between the outer lip contours, above and below the contact line, by walking from the mouth's rim."""
    at = features(model, model.mean)
    contour = np.array([at[i][:2] for i in range(48, 60)])
    inside = Path(contour).contains_points(model.mean[:, :2]) & model.frontal & (model.mean[:, 2] > 0)
    t = model.triangles[inside[model.triangles].all(axis=1)]
    graph = sp.coo_matrix((np.ones(3 * len(t)), (t.ravel(), np.roll(t, 1, axis=1).ravel())), (len(inside),) * 2)
    central = inside & (np.abs(model.mean[:, 0]) < 16)
    keep = sp.diags(central.astype(float))
    _, label = connected_components(keep @ graph @ keep, directed=False)
    size = np.bincount(label[central])
    sides = [np.flatnonzero(central & (label == k)) for k in np.argsort(size)[-2:]]
    assert all(len(side) > 40 for side in sides)
    sides.sort(key=lambda ids: -model.mean[ids, 1].mean())
    return sides


def eye_area(vertices, loop, triangles):
    """Area inside one lid opening as seen from the front, mm^2."""
    border = boundary_edges(triangles)
    after = {}
    inside = set(loop.tolist())
    for a, b in border.tolist():
        if a in inside:
            after.setdefault(a, []).append(b)
            after.setdefault(b, []).append(a)
    chain = [int(loop[0])]
    while len(chain) < len(loop):
        chain.append(next(x for x in after[chain[-1]] if x not in chain))
    polygon = vertices[chain][:, :2]
    grid = np.stack(np.meshgrid(*(np.arange(lo, hi, 0.1) for lo, hi in zip(polygon.min(0), polygon.max(0), strict=True))), -1)
    return 0.01 * Path(polygon).contains_points(grid.reshape(-1, 2)).sum()


def test_blink_closes_the_eye(model, loops):
    blink = model.expressions[model.expression_names.index("eyeBlinkLeft")]
    open_area = eye_area(model.mean, loops["left eye"], model.triangles)
    assert open_area > 100
    assert eye_area(model.mean + blink, loops["left eye"], model.triangles) < 0.03 * open_area
    half = eye_area(model.mean + 0.5 * blink, loops["left eye"], model.triangles)
    assert 0.3 * open_area < half < 0.7 * open_area
    np.testing.assert_array_equal(blink[loops["right eye"]], 0)


def test_lids_stay_outside_the_eyeball(model):
    eye = model.eye_mean[:72]
    centre = eye.mean(axis=0)
    radius = np.linalg.norm(eye - centre, axis=1).mean()
    near = model.frontal & (np.abs(model.mean[:, :2] - centre[:2]) < [18, 14]).all(axis=1)
    blink = model.expressions[model.expression_names.index("eyeBlinkLeft")]
    for amount in (0.0, 0.5, 1.0):
        distance = np.linalg.norm((model.mean + amount * blink)[near] - centre, axis=1)
        assert distance.min() > radius - 0.4


def test_expressions_have_no_creases(model):
    """Neighbouring vertices move alike: the largest strain of the units that were mended for steps."""
    pairs = edges(model.triangles)
    length = np.linalg.norm(np.subtract(*model.mean[pairs.T]), axis=1)
    for name in ("cheekPuff", "cheekSquintLeft", "mouthSmileLeft"):
        field = model.expressions[model.expression_names.index(name)]
        strain = np.linalg.norm(np.subtract(*field[pairs.T]), axis=1) / length
        assert strain.max() < 0.9, name


def test_features_are_on_the_face_and_symmetric(model):
    np.testing.assert_allclose(model.feature_weights.sum(axis=1), 1, atol=1e-6)
    assert (model.feature_weights >= 0).all()
    assert model.frontal[model.feature_triangles].all()
    at = features(model, model.mean)
    for a, b in OPPOSITE.items():
        np.testing.assert_allclose(at[a], at[b] * [-1, 1, 1], atol=1e-4)
    brows, eyes, lips = (np.array(list(at.values()))[FEATURE_REGIONS == r] for r in ("brows", "eyes", "lips"))
    assert brows[:, 1].min() > eyes[:, 1].max() > eyes[:, 1].min() > lips[:, 1].max()
    assert 40 < at[54][0] - at[48][0] < 60, "mouth width, mm"
    assert at[45][0] > at[42][0] > 0 > at[39][0] > at[36][0]


def test_eye_and_lip_features_lie_on_the_rims(model, loops):
    at = features(model, model.mean)
    for name, ids in (("left eye", (43, 44, 45, 46, 47)), ("right eye", (36, 37, 38, 40, 41))):
        rim = model.mean[loops[name]]
        for i in ids:
            assert np.linalg.norm(rim - at[i], axis=1).min() < 1.6


def test_depth_mask(model, loops):
    assert not (model.depth_valid & ~model.frontal).any()
    assert model.depth_valid.sum() > 0.9 * model.frontal.sum()
    for name in ("left eye", "right eye", "mouth"):
        assert not model.depth_valid[loops[name]].any()


def test_loader_names_the_fault(tmp_path):
    source = dict(np.load(ASSET, allow_pickle=False))

    def broken(message, **change):
        arrays = {k: v for k, v in (source | change).items() if v is not None}
        path = tmp_path / "broken.npz"
        np.savez(path, **arrays)
        with pytest.raises(FileFormatError, match=message):
            load_face_model(path)

    broken("mean", mean=None)
    broken("triangles", triangles=source["triangles"] + np.uint16(60000))
    broken("frontal", frontal=source["frontal"][:-1])
    broken("expression_names", expression_names=np.array([None] * 51))
    broken("generic_weights", generic_weights=np.full_like(source["generic_weights"], np.nan))
    short = tmp_path / "short.npz"
    with open(ASSET, "rb") as file:
        short.write_bytes(file.read()[:50000])
    with pytest.raises(FileFormatError, match="short.npz"):
        load_face_model(short)
    with pytest.raises(FileFormatError, match="no such file"):
        load_face_model(tmp_path / "absent.npz")


def test_asset_is_small_and_licensed():
    assert ASSET.stat().st_size < 2.6e6
    licence = (ASSETS / "LICENSE-face_model.txt").read_text(encoding="utf-8")
    assert "CC0 1.0" in licence and "MakeHuman" in licence and "Mika Suominen" in licence
