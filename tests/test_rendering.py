"""The ray caster against analytic depth and brute force, and the shading's simple truths."""

import numpy as np
import pytest

from adaptiveface.geometry.camera import Camera
from adaptiveface.geometry.mesh import triangle_normals, vertex_normals
from adaptiveface.geometry.rendering import Light, covering_window, heat_map, picture, ray_cast, shade
from adaptiveface.synthetic.scene import unit_sphere

CAMERA = Camera(64, 48, 80.0, 82.0, 30.7, 24.2)


def ball(centre=(5.0, -3.0, 400.0), radius=90.0):
    vertices, triangles = unit_sphere(12, 16)
    # Turned, so that no edge runs along a row or column of pixels.
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    return radius * vertices @ turn.T + centre, triangles


def brute_force(camera, vertices, triangles):
    """Nearest hit of every ray with every triangle (Moeller & Trumbore 1997)."""
    rays = camera.rays().reshape(-1, 1, 3)
    a, b, c = (vertices[triangles[:, k]][None] for k in range(3))
    p = np.cross(rays, c - a)
    det = ((b - a) * p).sum(-1)
    u = (-a * p).sum(-1) / det
    q = np.cross(-a, b - a)
    v = (rays * q).sum(-1) / det
    depth = ((c - a) * q).sum(-1) / det
    depth[(u < 0) | (v < 0) | (u + v > 1) | (depth <= 0)] = np.inf
    nearest = depth.argmin(axis=1)
    z = depth[np.arange(len(depth)), nearest]
    shape = (camera.height, camera.width)
    return np.where(np.isfinite(z), z, 0).reshape(shape), np.where(np.isfinite(z), nearest, -1).reshape(shape)


def test_depth_of_a_tilted_plane_is_exact():
    corners = np.array([[-900.0, -900, 0], [900, -900, 0], [900, 900, 0], [-900, 900, 0]])
    corners[:, 2] = 500 + 0.2 * corners[:, 0] - 0.3 * corners[:, 1]
    hits = ray_cast(CAMERA, corners, np.array([[0, 1, 2], [0, 2, 3]]))
    rays = CAMERA.rays()
    expected = 500 / (1 - 0.2 * rays[..., 0] + 0.3 * rays[..., 1])
    assert hits.mask.all()
    np.testing.assert_allclose(hits.depth, expected, rtol=1e-12)


def test_hits_agree_with_brute_force():
    vertices, triangles = ball()
    behind, _ = ball((-60.0, 20.0, 520.0), 120.0)
    vertices, triangles = np.concatenate([vertices, behind]), np.concatenate([triangles, triangles + len(vertices)])
    depth, triangle = brute_force(CAMERA, vertices, triangles)
    hits = ray_cast(CAMERA, vertices, triangles)
    np.testing.assert_array_equal(hits.mask, triangle >= 0)
    np.testing.assert_allclose(hits.depth, depth, atol=1e-9)
    assert 0.2 < hits.mask.mean() < 0.9
    assert (hits.triangle == triangle).mean() > 0.999
    points = np.einsum("pk,pkd->pd", hits.barycentric[hits.mask], vertices[triangles[hits.triangle[hits.mask]]])
    np.testing.assert_allclose(points, (CAMERA.rays() * hits.depth[..., None])[hits.mask], atol=1e-9)


def test_no_ray_slips_between_triangles():
    vertices, triangles = ball()
    mask = ray_cast(CAMERA, vertices, triangles).mask
    for row in mask[mask.any(axis=1)]:
        columns = np.flatnonzero(row)
        assert len(columns) == np.ptp(columns) + 1


def test_culling_keeps_front_faces_and_passes_back_faces():
    vertices, triangles = ball()
    plain, culled = (ray_cast(CAMERA, vertices, triangles, cull=cull) for cull in (False, True))
    np.testing.assert_array_equal(plain.depth, culled.depth)
    inside_out = ray_cast(CAMERA, vertices, triangles[:, ::-1], cull=True)
    assert (inside_out.depth[plain.mask] > plain.depth[plain.mask]).mean() > 0.95


def test_window_is_a_crop_and_covers_the_mesh():
    vertices, triangles = ball()
    window = covering_window(CAMERA, vertices)
    u0, v0, u1, v1 = window
    whole, part = ray_cast(CAMERA, vertices, triangles), ray_cast(CAMERA, vertices, triangles, window)
    assert part.mask.sum() == whole.mask.sum()
    assert part.mask.size < whole.mask.size
    np.testing.assert_array_equal(whole.depth[v0:v1, u0:u1], part.depth)
    np.testing.assert_array_equal(whole.barycentric[v0:v1, u0:u1], part.barycentric)
    with pytest.raises(ValueError, match="window"):
        ray_cast(CAMERA, vertices, triangles, (0, 0, 65, 48))


def test_what_lies_behind_the_camera_is_not_seen():
    vertices, triangles = ball((0.0, 0.0, -400.0))
    assert not ray_cast(CAMERA, vertices, triangles).mask.any()
    assert covering_window(CAMERA, vertices) == (0, 0, 0, 0)
    off_side, _ = ball((5000.0, 0.0, 400.0))
    u0, v0, u1, v1 = covering_window(CAMERA, off_side)
    assert ray_cast(CAMERA, off_side, triangles, (u0, v0, u1, v1)).mask.sum() == 0


def test_vertex_normals_are_the_area_weighted_means():
    vertices, triangles = ball()
    expected = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(expected, triangles[:, k], triangle_normals(vertices, triangles))
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    np.testing.assert_allclose(vertex_normals(vertices, triangles), expected, atol=1e-12)


def test_shading_is_brightest_where_the_surface_faces_the_camera():
    vertices, triangles = ball((0.0, 0.0, 400.0))
    hits = ray_cast(CAMERA, vertices, triangles)
    image = shade(hits, vertices, triangles, (100, 100, 100), camera=CAMERA, light=Light(key=0.0), background=(1, 2, 3))
    assert (image[~hits.mask] == (1, 2, 3)).all()
    grey = image[..., 0].astype(float)
    centre = grey[24, 31]
    rim = hits.mask & ~np.roll(hits.mask, 2, axis=1)
    assert centre > 1.3 * grey[rim].mean()


def test_heat_map_follows_its_limits():
    rgb = heat_map(np.array([-5.0, 0.0, 1.0, 7.0, np.nan]), (0.0, 1.0))
    np.testing.assert_array_equal(rgb[0], rgb[1])
    np.testing.assert_array_equal(rgb[2], rgb[3])
    assert np.abs(rgb[1] - rgb[2]).max() > 50
    assert (rgb[4] == 160).all()
    vertices, triangles = ball()
    black = np.zeros((48, 64, 3), np.uint8)
    image = picture(CAMERA, vertices, triangles, vertices[:, 0], limits=(-85, 95), background=black)
    seen = image.sum(axis=2) > 0
    columns = np.flatnonzero(seen.any(axis=0))
    left, right = image[:, columns[4]][seen[:, columns[4]]].mean(0), image[:, columns[-5]][seen[:, columns[-5]]].mean(0)
    assert np.argmax(left) == 2 and right[2] < right[:2].max()  # viridis runs from blue to yellow
