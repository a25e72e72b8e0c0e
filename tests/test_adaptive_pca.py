"""Section 5 against batch PCA, direct EM, and scikit-learn; what may never happen to the correctives."""

import numpy as np
import pytest
from scenes import exact_actor
from scipy.linalg import subspace_angles

from adaptiveface.geometry.mesh import edges, grow
from adaptiveface.parameters import AdaptivePcaParameters
from adaptiveface.tracking.adaptive_pca import (
    AdaptiveModel,
    anchor_shapes,
    e_step,
    em_in_sample_space,
    m_step,
    orthonormalise,
)
from adaptiveface.tracking.types import SampleState


@pytest.fixture(scope="module")
def actor():
    return exact_actor()


def samples_outside_anchors(model, count, rank=12, seed=0, size=4.0, drift=0.0):
    """(count, 3n) displacements with decaying principal directions, plus noise; about ``size`` cm^2 each.

    ``drift``: how far the performance moves on to other directions from the first to the last sample.
    """
    rng = np.random.default_rng(seed)
    n = len(model.anchors)
    directions, _ = np.linalg.qr(rng.normal(size=(n, rank)))
    directions, _ = np.linalg.qr(directions - model.anchors @ (model.anchors.T @ directions))
    decay = np.abs(np.arange(rank) - drift * np.linspace(0, 1, count)[:, None])
    values = rng.normal(size=(count, rank)) * 0.7**decay + 0.01 * rng.normal(size=(count, rank))
    values *= np.sqrt(size * model._unit / (values**2).sum(axis=1, keepdims=True))
    return values @ directions.T


def feed(model, samples):
    for sample in samples:
        assert model.learn(model.parts(sample)) is SampleState.LEARNED


def assert_orthonormal(model, tolerance=1e-9):
    basis = np.hstack([model.anchors, model.correctives])
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=tolerance)


def test_anchor_shapes_span_the_blendshapes(actor):
    blendshapes = actor.blendshapes[:, actor.frontal].reshape(len(actor.blendshapes), -1)
    anchors, mix = anchor_shapes(blendshapes)
    np.testing.assert_allclose(anchors.T @ anchors, np.eye(anchors.shape[1]), atol=1e-12)
    np.testing.assert_allclose(blendshapes - blendshapes @ anchors @ anchors.T, 0.0, atol=1e-8)
    np.testing.assert_allclose(mix @ blendshapes, anchors.T, atol=1e-9)


def test_anchor_shapes_drop_a_repeated_blendshape():
    shapes = np.random.default_rng(0).normal(size=(4, 30))
    anchors, _ = anchor_shapes(np.vstack([shapes, shapes[:1]]))
    assert anchors.shape == (30, 4)


def test_em_in_sample_space_equals_direct_em():
    rng = np.random.default_rng(1)
    samples = rng.normal(size=(300, 40)) * np.linspace(3, 0.1, 300)[:, None]
    start = orthonormalise(rng.normal(size=(300, 5)))
    direct = start
    for _ in range(4):
        direct = m_step(samples, e_step(direct, samples))
    mixed = samples @ em_in_sample_space(samples.T @ samples, start.T @ samples, 4)
    np.testing.assert_allclose(mixed, direct, rtol=1e-8, atol=1e-10)


def test_em_converges_to_batch_pca():
    """Roweis 1998: the iteration ends in the span of the leading principal directions (uncentred, as in section 5)."""
    rng = np.random.default_rng(2)
    left, _ = np.linalg.qr(rng.normal(size=(200, 20)))
    samples = left @ (np.diag(0.6 ** np.arange(20)) @ rng.normal(size=(20, 80)))
    basis = orthonormalise(rng.normal(size=(200, 3)))
    for _ in range(100):
        basis = m_step(samples, e_step(basis, samples))
    truth = np.linalg.svd(samples, full_matrices=False)[0][:, :3]
    assert np.degrees(subspace_angles(basis, truth).max()) < 1e-3


def test_online_correctives_follow_batch_pca(actor):
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(K=7, S=120, buffer="newest"))
    samples = samples_outside_anchors(model, 300)
    feed(model, samples)
    assert_orthonormal(model)
    kept = samples[-120:]
    residual = kept - kept @ model.anchors @ model.anchors.T
    truth = np.linalg.svd(residual, full_matrices=False)[2][:7].T
    assert np.degrees(np.median(subspace_angles(model.correctives, truth))) < 0.5

    def explained(basis):
        return ((residual @ basis) ** 2).sum() / (residual**2).sum()

    assert explained(model.correctives) > 0.999 * explained(truth)


def test_growing_start_explains_a_new_expression_that_the_full_buffer_policy_misses(actor):
    """Unexplained energy just after a sample was seen, while the performance moves on and the buffer is not full yet."""
    left_out = {}
    for startup in ("growing", "full-buffer"):
        model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(K=7, S=60, startup=startup))
        shares = []
        for sample in samples_outside_anchors(model, 50, rank=7, seed=4, drift=6.0):
            feed(model, [sample])
            rest = sample - model.anchors @ (model.anchors.T @ sample)
            shares.append(1 - ((rest @ model.correctives) ** 2).sum() / (rest @ rest))
        assert_orthonormal(model)
        assert (model.updates > 0) == (startup == "growing")
        left_out[startup] = np.mean(shares[20:])
    assert left_out["growing"] < 0.5 * left_out["full-buffer"]


def test_full_buffer_policy_updates_once_the_buffer_is_full(actor):
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(K=7, S=20, startup="full-buffer"))
    samples = samples_outside_anchors(model, 25)
    feed(model, samples[:19])
    assert model.updates == 0 and model.correctives.shape[1] == 7
    feed(model, samples[19:])
    assert model.updates == 6


def test_more_correctives_than_the_buffer_has_samples_still_learn(actor):
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(K=7, S=5, buffer="newest"))
    samples = samples_outside_anchors(model, 25)
    feed(model, samples)
    assert model.updates == 25 and model.correctives.shape[1] == 5
    rest = samples[-5:] - samples[-5:] @ model.anchors @ model.anchors.T
    assert ((rest @ model.correctives) ** 2).sum() > 0.99 * (rest**2).sum(), "the newest samples, not the first"


def test_a_buffer_of_duplicates_stays_well_conditioned(actor):
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(S=30, buffer="newest"))
    sample = samples_outside_anchors(model, 1)[0]
    feed(model, [sample] * 50)
    assert model.correctives.shape[1] == 1
    assert_orthonormal(model)
    fresh = samples_outside_anchors(model, 60, seed=9)
    feed(model, fresh)
    feed(model, [sample] * 40)
    assert_orthonormal(model)
    assert np.isfinite(model.correctives).all()
    assert model.correctives.shape[1] == 1, "what no sample in the buffer has any more is forgotten"
    feed(model, fresh)
    assert model.correctives.shape[1] == model.parameters.K
    assert_orthonormal(model)


@pytest.mark.parametrize("startup, count", [("growing", 9), ("growing", 50), ("full-buffer", 9), ("full-buffer", 50)])
def test_parts_are_those_of_the_basis_written_out(actor, startup, count):
    """M_K^T d and M_K M_K^T d by the samples, before and after the buffer is full, against the matrix M."""
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(K=7, S=20, startup=startup))
    samples = samples_outside_anchors(model, count + 1)
    feed(model, samples[:-1])
    displacement = samples[-1] + model.anchors @ np.random.default_rng(1).normal(size=model.anchors.shape[1])
    parts, m = model.parts(displacement), model.correctives
    np.testing.assert_allclose(parts.in_correctives, m.T @ displacement, atol=1e-3)
    np.testing.assert_allclose(parts.corrective, m @ (m.T @ displacement), atol=1e-5)
    np.testing.assert_allclose(parts.anchor, model.anchors @ (model.anchors.T @ displacement), atol=1e-5)
    rest = displacement - model.anchors @ (model.anchors.T @ displacement)
    lengths = [np.linalg.norm(r.reshape(-1, 3), axis=1).mean() for r in (rest, rest - m @ (m.T @ rest))]
    np.testing.assert_allclose(parts.distances(), lengths, atol=1e-5)


def test_copies_learn_each_for_itself(actor):
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(K=4, S=10))
    samples = samples_outside_anchors(model, 18)
    feed(model, samples[:12])
    kept, other, alone = model.copy(), model.copy(), AdaptiveModel(actor, actor.blendshapes, model.parameters)
    before = model.correctives.copy()
    feed(other, samples[12:])
    feed(model, samples[12:15])
    feed(alone, samples)
    np.testing.assert_array_equal(kept.correctives, before)
    np.testing.assert_array_equal(kept.parts(samples[0]).corrective, kept.copy().parts(samples[0]).corrective)
    np.testing.assert_allclose(kept.parts(samples[0]).corrective, before @ (before.T @ samples[0]), atol=1e-6)
    np.testing.assert_array_equal(other.correctives, alone.correctives)


@pytest.mark.parametrize(
    "size, state", [(0.5, SampleState.IN_ANCHOR_SPACE), (4.0, SampleState.LEARNED), (150.0, SampleState.OUTLIER)]
)
def test_thresholds_are_square_centimetres(actor, size, state):
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters())
    sample = samples_outside_anchors(model, 1, size=size)[0]
    assert model.learn(model.parts(sample)) is state
    energy = (sample**2).sum() / 100.0 * 3480 / actor.frontal.sum()
    np.testing.assert_allclose(energy, size, rtol=1e-4)
    assert model.correctives.shape[1] == (1 if state is SampleState.LEARNED else 0)


def test_nan_samples_are_outliers_and_change_nothing(actor):
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters())
    feed(model, samples_outside_anchors(model, 10))
    before = model.correctives.copy()
    assert model.learn(model.parts(np.full(len(before), np.nan))) is SampleState.OUTLIER
    np.testing.assert_array_equal(model.correctives, before)


def test_projection_has_no_seam_at_the_frontal_border(actor):
    """Deformations that vanish at the border: v3 may step across it no more than it does one ring further in."""
    model = AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(K=3, valid_max=1e6))
    rng = np.random.default_rng(5)
    inner = grow(~actor.frontal, actor.triangles, 3)
    centres = actor.neutral[rng.choice(np.flatnonzero(actor.frontal & ~inner), 20)]
    for centre in centres:
        bump = 60.0 * np.exp(-((actor.neutral - centre) ** 2).sum(axis=1) / 25.0**2)
        deformation = np.where(inner, 0.0, bump)[:, None] * rng.normal(size=3)
        model.learn(model.parts(deformation[actor.frontal].ravel()))
    assert model.correctives.shape[1] == 3
    frontal, outside = model.project(model.parts(deformation[actor.frontal].ravel()))
    field = np.zeros_like(actor.neutral)
    field[actor.frontal], field[~actor.frontal] = frontal.reshape(-1, 3), outside.reshape(-1, 3)
    pairs = edges(actor.triangles)
    jump = np.linalg.norm(field[pairs[:, 0]] - field[pairs[:, 1]], axis=1)
    jump /= np.linalg.norm(actor.neutral[pairs[:, 0]] - actor.neutral[pairs[:, 1]], axis=1)
    across = actor.frontal[pairs[:, 0]] != actor.frontal[pairs[:, 1]]
    near = inner[pairs].all(axis=1) & actor.frontal[pairs].all(axis=1)
    assert np.abs(outside).max() > 0.05
    assert jump[across].max() < 1.5 * jump[near].max()
