"""What the paper prints, as choices of the stages: each equals its formula, solved densely."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scenes import CAMERA, coefficients, exact_actor, head_pose, posed_shape, render_frame
from scipy.optimize import lsq_linear

from adaptiveface.geometry.frame import Features2D
from adaptiveface.geometry.mesh import cotangent_laplacian, transform_points, vertex_normals
from adaptiveface.parameters import (
    AdaptivePcaParameters,
    DepthParameters,
    KalmanParameters,
    LaplacianParameters,
    Parameters,
)
from adaptiveface.registration.association import find_correspondences
from adaptiveface.registration.step import apply_rigid_update, rigid_jacobian
from adaptiveface.registration.surface import crop_window, depth_surface
from adaptiveface.tracking.adaptive_pca import AdaptiveModel, e_step, m_step
from adaptiveface.tracking.expression import BlendshapeFit
from adaptiveface.tracking.kalman import CoefficientFilter
from adaptiveface.tracking.laplacian import LaplacianDeformation
from adaptiveface.tracking.printed import depth_offsets, offsets_at_features, printed_term
from adaptiveface.tracking.rigid import RigidTracker

SIDE = 9
W1, W2 = 0.3, 2.0


class Patch:
    """A bent square of 81 vertices, whose inner ones deform, with features, depth points and a pose of its own."""

    def __init__(self) -> None:
        rng = np.random.default_rng(11)
        x, y = np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing="ij")
        flat = np.column_stack([x.ravel(), y.ravel(), 0.1 * (x.ravel() - 3.0) ** 2]).astype(float)
        self.vertices = 3.0 * (flat - flat.mean(axis=0)) + 0.1 * rng.normal(size=flat.shape)
        corner = (x[:-1, :-1] * SIDE + y[:-1, :-1]).ravel()
        halves = [corner, corner + SIDE, corner + 1], [corner + SIDE, corner + SIDE + 1, corner + 1]
        self.triangles = np.concatenate([np.column_stack(half) for half in halves])
        inner = (x > 0) & (x < SIDE - 1) & (y > 0) & (y < SIDE - 1)
        self.frontal = inner.ravel()
        self.corners = self.triangles[rng.choice(len(self.triangles), 5, replace=False)]
        self.shares = rng.dirichlet(np.ones(3), 5)
        self.pose = head_pose((0.1, 0.2, -0.1), (12.0, -30.0, 600.0))
        self.points = np.einsum("fk,fkd->fd", self.shares, self.vertices[self.corners])
        pixels = CAMERA.project(transform_points(self.pose, self.points)) + rng.normal(size=(5, 2))
        self.features = Features2D(pixels, np.array([1.0, 0.7, 1.0, 0.0, 0.4]))
        n = self.n = int(self.frontal.sum())
        self.rise = rng.normal(size=5)
        self.offsets = rng.normal(size=(n, 3))

    def solver(self, w1: float, w2: float) -> LaplacianDeformation:
        return LaplacianDeformation(self.vertices, self.triangles, self.frontal, self.corners, self.shares, w1, w2)

    def blocks(self, form: str):
        """H (f, 3, 3), d (f, 3), confidence (f,), Q (3f, 3n) in the camera frame; L (3N, 3n), written out as printed."""
        h, d, q, weights = [], [], [], []
        place = np.cumsum(self.frontal) - 1
        p = np.diag([CAMERA.fx, CAMERA.fy, 1.0])
        for f in np.flatnonzero(self.features.valid):
            v = transform_points(self.pose, self.points[f])
            u = self.features.pixels[f] - [CAMERA.cx, CAMERA.cy]
            image = np.array([CAMERA.fx * v[0] / v[2], CAMERA.fy * v[1] / v[2]])
            a, b = u - image if form == "printed" else u
            h.append([[1, 0, -a], [0, 1, -b], [0, 0, 1]])
            lateral = np.zeros(2) if form == "printed" else (u - image) * v[2]
            d.append([*lateral, self.rise[f]])
            row = np.zeros((3, 3 * self.n))
            for vertex, share in zip(self.corners[f], self.shares[f], strict=True):
                if self.frontal[vertex]:
                    row[:, 3 * place[vertex] : 3 * place[vertex] + 3] += share * p
            q.append(row)
            weights.append(self.features.confidence[f])
        laplacian = cotangent_laplacian(self.vertices, self.triangles)[:, np.flatnonzero(self.frontal)].toarray()
        return np.array(h), np.array(d), np.array(weights), np.vstack(q), np.kron(laplacian, np.eye(3))

    def in_camera(self, offsets: np.ndarray) -> np.ndarray:
        return offsets @ self.pose[:3, :3].T


@pytest.fixture(scope="module")
def patch():
    return Patch()


@pytest.fixture(scope="module")
def actor():
    return exact_actor()


def dense(patch: Patch, form: str, weights: str, w1: float, w2: float, offsets: np.ndarray) -> np.ndarray:
    """Equation (7) stacked in full, with G and a as printed, and solved by numpy; (n, 3) in the head frame."""
    h, d, confidence, q, laplacian = patch.blocks(form)
    identity = np.eye(3 * patch.n)
    target = patch.in_camera(offsets).ravel()
    if weights == "pseudo-inverse":
        solved_rows = np.sqrt(confidence).repeat(3)  # G^-1 a, row by row; a feature of confidence 0.5 counts half
        k = np.vstack([solved_rows[:, None] * q, identity if w1 else np.zeros((0, 3 * patch.n)), laplacian])
        first = solved_rows * np.concatenate([np.linalg.inv(a) @ b for a, b in zip(h, d, strict=True)])
        ga = np.concatenate([first, target if w1 else [], np.zeros(len(laplacian))])
        solution = np.linalg.pinv(k) @ ga
    else:
        g1, g2 = (w1, w2) if weights == "rows" else (np.sqrt(w1), np.sqrt(w2))
        scale = np.sqrt(confidence).repeat(3)
        hq = np.concatenate([a @ q[3 * i : 3 * i + 3] for i, a in enumerate(h)])
        rows = np.vstack([scale[:, None] * hq, g1 * identity, g2 * laplacian])
        a = np.concatenate([scale * d.ravel(), g1 * target, np.zeros(len(laplacian))])
        solution = np.linalg.lstsq(rows, a, rcond=None)[0]
    return solution.reshape(-1, 3) @ patch.pose[:3, :3]


@pytest.mark.parametrize("form", ["printed", "consistent"])
@pytest.mark.parametrize("weights", ["energy", "rows", "pseudo-inverse"])
def test_equations_3_to_7_equal_the_stacked_system(patch, form, weights):
    p = LaplacianParameters(w1=W1, w2=W2, final_w2=W2, feature_rows=form, weights=weights)
    term = printed_term(patch.features, CAMERA, patch.pose, patch.points, patch.rise, p)
    got = patch.solver(*p.energies).deform_to_points(patch.offsets, term)
    np.testing.assert_allclose(got, dense(patch, form, weights, W1, W2, patch.offsets), atol=1e-5)
    assert np.abs(got).max() > 0.02
    final = patch.solver(*p.final_energies).deform_to_features(term)
    np.testing.assert_allclose(final, dense(patch, form, weights, 0.0, W2, 0 * patch.offsets), atol=1e-5)


def test_the_pseudo_inverse_knows_no_weights(patch):
    """Equation (7) as printed: G^-1 a takes w1 and w2 out again, so that other values change nothing."""
    for values in ((0.1, 100.0), (10.0, 0.01)):
        p = LaplacianParameters(w1=values[0], w2=values[1], weights="pseudo-inverse")
        assert p.energies == (1.0, 1.0) and p.final_energies == (0.0, 1.0)
    rows = LaplacianParameters(w1=0.1, w2=100.0, weights="rows")
    np.testing.assert_allclose(rows.energies, (0.01, 1e4))
    assert LaplacianParameters().energies == (LaplacianParameters().w1, LaplacianParameters().w2)


def test_equation_4_moves_no_vertex_where_the_depth_stays(patch):
    """The offset of a feature multiplies only the change of depth; the consistent rows bring the feature to its ray."""
    moved = {}
    for form in ("printed", "consistent"):
        p = LaplacianParameters(final_w2=W2, feature_rows=form)
        term = printed_term(patch.features, CAMERA, patch.pose, patch.points, 0.0, p)
        moved[form] = patch.solver(*p.final_energies).deform_to_features(term)
    assert np.abs(moved["printed"]).max() == 0.0
    whole = np.zeros_like(patch.vertices)
    whole[patch.frontal] = moved["consistent"]
    points = patch.points + np.einsum("fk,fkd->fd", patch.shares, whole[patch.corners])
    inside = patch.frontal[patch.corners].all(axis=1) & patch.features.valid
    assert inside.sum() >= 2
    left = CAMERA.project(transform_points(patch.pose, points)) - patch.features.pixels
    assert np.abs(left[inside]).max() < 0.05, "hard constraints"


def test_no_features_leave_the_points_alone(patch):
    term = printed_term(None, CAMERA, patch.pose, patch.points, 0.0, LaplacianParameters(feature_rows="printed"))
    solver = patch.solver(W1, 1e-8)
    np.testing.assert_allclose(solver.deform_to_points(patch.offsets, term), patch.offsets, atol=1e-5)
    np.testing.assert_array_equal(solver.deform_to_features(term), 0.0)


def test_depth_offsets_lead_to_the_depth_point_on_the_viewing_ray():
    depth = np.full((CAMERA.height, CAMERA.width), 600.0, np.float32)
    surface = depth_surface(depth, CAMERA, (0, 0, CAMERA.width, CAMERA.height), DepthParameters())
    pose = head_pose((0.05, 0.1, 0.0), (10.0, 5.0, 598.0))
    shape = np.array([[0.0, 0.0, 0.0], [20.0, 10.0, 0.0], [-30.0, 15.0, 2.0], [0.0, 0.0, 400.0]])
    normals = np.tile([0.0, 0.0, -1.0], (4, 1)) @ pose[:3, :3]
    matches = find_correspondences(surface, shape, normals, 25.0, pose)
    assert list(matches.weights > 0) == [True, True, True, False]
    held = np.full((4, 3), 7.0)
    offsets = depth_offsets(matches, pose, held)
    np.testing.assert_array_equal(offsets[3], held[3])
    at, moved = (transform_points(pose, points)[:3] for points in (shape, shape + offsets))
    np.testing.assert_allclose(moved[:, 2], 600.0, atol=1e-3)
    np.testing.assert_allclose(CAMERA.project(moved), CAMERA.project(at), atol=1e-3)
    corners, shares = np.array([[0, 1, 2], [0, 1, 3]]), np.array([[0.2, 0.3, 0.5], [0.2, 0.3, 0.5]])
    at_features = offsets_at_features(matches, pose, corners, shares)
    np.testing.assert_allclose(at_features[0], shares[0] @ offsets[:3])
    np.testing.assert_array_equal(at_features[1], 0.0)


def test_the_window_is_200_by_200_around_the_model():
    pixels = np.array([[280.0, 190.0], [371.0, 300.0]])
    left, top, right, bottom = crop_window(CAMERA, pixels, 15.0, Parameters.paper().depth.crop)
    assert (right - left, bottom - top) == (200, 200)
    assert abs((left + right) / 2 - 325.5) <= 0.5 and (top + bottom) / 2 == 245.0


def whole_surface(frame):
    return depth_surface(frame.depth, frame.camera, (0, 0, frame.camera.width, frame.camera.height), DepthParameters())


def test_plain_rigid_icp_ends_after_the_step_that_comes_below_3_mm(actor):
    """Every iterate is a plain least-squares step; the end is the first of them below 3 mm, mostly the first of all."""
    used = np.flatnonzero(actor.frontal & actor.depth_valid)[::4]
    shape, normals = actor.neutral[used], vertex_normals(actor.neutral, actor.triangles)[used]
    paper = Parameters.paper().rigid
    for shift, fewest in (((2.0, 1.0, 2.0), 1), ((4.0, 3.0, 18.0), 1)):
        start = head_pose((0.05, 0.1, 0.0), (10.0, -5.0, 620.0))
        frame = render_frame(actor, actor.neutral, head_pose((0.1, 0.15, 0.0), np.array([10.0, -5.0, 620.0]) + shift))
        surface, pose, steps = whole_surface(frame), start, 0
        while True:
            points = transform_points(pose, shape)
            matches = find_correspondences(surface, points, normals @ pose[:3, :3].T, paper.max_correspondence_distance)
            matched, centre = matches.weights > 0, transform_points(pose, shape.mean(axis=0))
            if steps and np.abs(matches.distances[matched]).mean() < 3.0:
                break
            rows = rigid_jacobian(points[matched], matches.normals[matched], centre)
            pose = apply_rigid_update(pose, np.linalg.lstsq(rows, -matches.distances[matched], rcond=None)[0], centre)
            steps += 1
        weights = 1.0 / (1.0 + np.full(len(used), 5.0 / paper.half_weight_motion) ** 2)
        fit = RigidTracker(weights, paper).align(surface, shape, normals, start)
        np.testing.assert_allclose(fit.pose, pose, atol=1e-4)
        assert steps >= fewest and fit.residual < 3.0
        further = RigidTracker(weights, dataclasses.replace(paper, stop="motion")).align(surface, shape, normals, start)
        assert further.residual < fit.residual, "the rule stops short of the minimum"


def test_plain_icp_gives_up_after_its_iterations(actor):
    far = head_pose(translation=(0, 0, 900.0))
    frame = render_frame(actor, actor.neutral, head_pose())
    used = np.flatnonzero(actor.frontal)[::4]
    normals = vertex_normals(actor.neutral, actor.triangles)[used]
    fit = RigidTracker(np.ones(len(used)), Parameters.paper().rigid).align(
        whole_surface(frame), actor.neutral[used], normals, far
    )
    assert fit.residual == np.inf


def test_the_bounded_fit_minimises_equations_1_and_2(actor):
    """One round at a known pose: the rows stacked, every correspondence of weight 1, solved by SciPy within [0, 1]."""
    paper = dataclasses.replace(Parameters.paper().blendshapes, iterations=1)
    fit = BlendshapeFit(actor, paper)
    pose = head_pose((0.0, 0.1, 0.0))
    truth = coefficients(actor, jawOpen=0.4, browInnerUp=0.6)
    frame = render_frame(actor, posed_shape(actor, truth), pose)
    surface, used = whole_surface(frame), fit.depth_vertices
    normals = vertex_normals(actor.neutral, actor.triangles)[used]
    _, x = fit.fit(surface, frame.features, CAMERA, pose, np.zeros(23), normals)
    points = transform_points(pose, actor.neutral[used])
    matches = find_correspondences(surface, points, normals @ pose[:3, :3].T, paper.max_correspondence_distance)
    matched = matches.weights > 0
    directions = (matches.normals @ pose[:3, :3])[matched]
    rows = [np.einsum("nd,and->na", directions, actor.blendshapes[:23][:, used][:, matched])]
    right = [-matches.distances[matched]]
    for f, u in enumerate(frame.features.pixels):
        share, corners = actor.feature_weights[f], actor.feature_triangles[f]
        eq2 = np.array([[1, 0, -u[0]], [0, 1, -u[1]]]) @ CAMERA.matrix
        rows.append(np.sqrt(paper.w) * eq2 @ pose[:3, :3] @ np.einsum("k,akd->da", share, actor.blendshapes[:23][:, corners]))
        right.append(-np.sqrt(paper.w) * eq2 @ transform_points(pose, share @ actor.neutral[corners]))
    expected = lsq_linear(np.vstack(rows), np.concatenate(right), (0.0, 1.0), tol=1e-12).x
    np.testing.assert_allclose(x, expected, atol=2e-4)


def test_kalman_as_printed_is_the_textbook_filter():
    """Welch and Bishop's predict and correct with full matrices: Q = 0.05 I, R = 0.02, position and velocity."""
    measured = np.random.default_rng(4).uniform(size=30)
    kalman = CoefficientFilter(KalmanParameters())
    a, h = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]])
    state, p = np.array([measured[0], 0.0]), np.eye(2)
    for number, z in enumerate(measured):
        got = kalman.update(np.array([z]))
        if number:
            state, p = a @ state, a @ p @ a.T + 0.05 * np.eye(2)
            k = p @ h.T @ np.linalg.inv(h @ p @ h.T + 0.02)
            state, p = state + k @ (z - h @ state), (np.eye(2) - k @ h) @ p
        np.testing.assert_allclose(got, state[0], atol=1e-12)
    assert Parameters.paper().kalman == KalmanParameters()


def test_the_full_buffer_start_is_qr_of_the_first_k_samples_and_then_em(actor):
    """Section 5 on the whole matrices: anchors by SVD, M_K by QR, nothing until the buffer is full, then two EM steps."""
    k, size = 7, 12
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(K=k, S=size, startup="full-buffer", buffer="newest"))
    n = int(actor.frontal.sum())
    left = np.linalg.svd(actor.blendshapes[:, actor.frontal].reshape(len(actor.blendshapes), -1).T, full_matrices=False)[0]
    rng = np.random.default_rng(2)
    samples = rng.normal(size=(size + 3, 4)) @ rng.normal(size=(4, 3 * n)) + 0.3 * rng.normal(size=(size + 3, 3 * n))
    samples *= 0.3  # between the two limits of a valid sample
    rest = (samples - samples @ left @ left.T).T
    for number in range(1, size + 4):
        model.learn(model.parts(samples[number - 1]))
        if number < k:
            continue
        if number == k:
            basis = np.linalg.qr(rest[:, :k])[0]
        if number >= size:
            buffer, m = rest[:, number - size : number], basis
            for _ in range(2):
                m = m_step(buffer, e_step(m, buffer))
            basis = np.linalg.qr(m)[0]
        cosines = np.linalg.svd(basis.T @ model.correctives, compute_uv=False)
        assert cosines.min() > 1 - 1e-8, number
        assert model.updates == max(0, number - size + 1)
