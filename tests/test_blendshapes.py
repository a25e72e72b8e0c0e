"""Deformation transfer: exact where it must be, equivariant, and the same as Sumner & Popovic's own formulation."""

import numpy as np
import pytest

from adaptiveface.geometry.mesh import rotation_vector_matrix, vertex_normals
from adaptiveface.model.blendshapes import STILL, deformation_gradients, deformation_transfer, gradient_operator
from adaptiveface.model.face_model import embedded_face_model


@pytest.fixture(scope="module")
def model():
    return embedded_face_model()


@pytest.fixture(scope="module")
def person(model):
    return model.neutral(np.random.default_rng(7).normal(size=len(model.identity_modes)))


def grid(n=6):
    """A bumpy square: vertices (n^2, 3), triangles."""
    x, y = np.meshgrid(np.arange(n, dtype=float), np.arange(n, dtype=float))
    vertices = np.stack([x, y, 0.3 * np.sin(1.7 * x + y)], axis=2).reshape(-1, 3)
    corner = (np.arange(n - 1)[:, None] * n + np.arange(n - 1)).ravel()
    triangles = np.concatenate(
        [np.stack([corner, corner + 1, corner + n], 1), np.stack([corner + 1, corner + n + 1, corner + n], 1)]
    )
    return vertices, triangles


def test_exact_when_target_and_source_agree(model):
    expressions = model.generic_expressions
    moved = deformation_transfer(model.mean, model.mean, model.triangles, expressions)
    assert np.abs(moved - expressions).max() < 1e-9


def test_takes_every_expression_unit(model, person):
    moved = deformation_transfer(model.mean, person, model.triangles, model.expressions)
    assert moved.shape == model.expressions.shape
    assert np.isfinite(moved).all()


def test_still_vertices_stay_still(model, person):
    expressions = model.generic_expressions
    still = np.linalg.norm(expressions, axis=2).max(axis=0) <= STILL
    assert still.any()
    moved = deformation_transfer(model.mean, person, model.triangles, expressions)
    assert (moved[:, still] == 0).all()
    assert deformation_transfer(model.mean, person, model.triangles, np.zeros_like(expressions)).max() == 0


def test_expressions_of_a_person_resemble_the_generic_ones(model, person):
    expressions = model.generic_expressions
    moved = deformation_transfer(model.mean, person, model.triangles, expressions)
    for generic, personal in zip(expressions, moved, strict=True):
        cosine = (generic * personal).sum() / np.linalg.norm(generic) / np.linalg.norm(personal)
        assert cosine > 0.9
        assert 0.6 < np.linalg.norm(personal) / np.linalg.norm(generic) < 1.6


def test_a_scaled_head_moves_by_the_scaled_amount(model):
    # With the still vertices fixed at their scaled place, the scaled displacement has exactly the source's gradients.
    expressions = model.generic_expressions[:3]
    moved = deformation_transfer(model.mean, 1.2 * model.mean, model.triangles, expressions)
    assert np.abs(moved - 1.2 * expressions).max() < 1e-2


def test_deformation_gradients_of_a_linear_map_are_that_map():
    vertices, triangles = grid()
    linear = rotation_vector_matrix(np.array([0.2, -0.4, 0.9]))
    maps = deformation_gradients(vertices, vertices @ linear.T, triangles)
    assert np.abs(maps - linear).max() < 1e-12


def test_gradient_operator_of_a_linear_function():
    vertices, triangles = grid()
    slope = np.array([0.3, -1.2, 0.5])
    gradient, area = gradient_operator(vertices, triangles)
    normals = np.cross(
        vertices[triangles[:, 1]] - vertices[triangles[:, 0]], vertices[triangles[:, 2]] - vertices[triangles[:, 0]]
    )
    assert np.allclose(area, 0.5 * np.linalg.norm(normals, axis=1))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    tangential = slope - (normals @ slope)[:, None] * normals
    assert np.abs((gradient @ (vertices @ slope)).reshape(-1, 3) - tangential).max() < 1e-12


def test_agrees_with_the_fourth_vertex_formulation():
    """Sumner & Popovic 2004, eqs. (3)-(5), with explicit fourth vertices and area weights, solved densely."""
    source, triangles = grid()
    rng = np.random.default_rng(0)
    target = source * [1.1, 0.9, 1.3] + 0.05 * rng.normal(size=source.shape)
    displacement = 0.3 * rng.normal(size=source.shape)
    displacement[:6] = 0
    moved = deformation_transfer(source, target, triangles, displacement[None])[0]

    n, count = len(target), len(triangles)
    wanted = deformation_gradients(source, source + displacement, triangles)
    frames = np.linalg.inv(_frames(target, triangles))
    area = 0.5 * np.linalg.norm(
        np.cross(target[triangles[:, 1]] - target[triangles[:, 0]], target[triangles[:, 2]] - target[triangles[:, 0]]), axis=1
    )
    rows, rhs = np.zeros((3 * count, n + count)), np.zeros((3 * count, 3))
    for t, (a, b, c) in enumerate(triangles):
        # T = [x_b - x_a, x_c - x_a, x_4 - x_a] V^-1; its rows, transposed, are linear in the unknown vertices.
        for k in range(3):
            w = np.sqrt(area[t]) * frames[t][:, k]
            rows[3 * t + k, [b, c, n + t]] += w
            rows[3 * t + k, a] -= w.sum()
            rhs[3 * t + k] = np.sqrt(area[t]) * wanted[t][:, k]
    held = np.arange(6)
    free = np.setdiff1d(np.arange(n + count), held)
    solved = np.linalg.lstsq(rows[:, free], rhs - rows[:, held] @ target[held], rcond=None)[0]
    assert np.abs(solved[: n - 6] - target[6:] - moved[6:]).max() < 1e-3


def _frames(vertices, triangles):
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    return np.stack([b - a, c - a, normal / np.sqrt(np.linalg.norm(normal, axis=1, keepdims=True))], axis=2)


def test_no_personal_expression_turns_the_skin_inside_out_where_the_generic_does_not(model, person):
    expressions = model.generic_expressions
    moved = deformation_transfer(model.mean, person, model.triangles, expressions)
    for generic, personal in zip(expressions, moved, strict=True):
        before = (vertex_normals(model.mean, model.triangles) * vertex_normals(model.mean + generic, model.triangles)).sum(
            axis=1
        )
        after = (vertex_normals(person, model.triangles) * vertex_normals(person + personal, model.triangles)).sum(axis=1)
        assert ((after < -0.2) & (before > 0.5)).sum() == 0
