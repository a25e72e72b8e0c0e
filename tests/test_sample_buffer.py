"""Which samples a full buffer keeps: the newest, or those that differ most."""

import numpy as np
import pytest
from scenes import exact_actor
from scipy.spatial.distance import cdist

from adaptiveface.parameters import AdaptivePcaParameters, Parameters
from adaptiveface.tracking.adaptive_pca import AdaptiveModel
from adaptiveface.tracking.sample_buffer import redundant_sample
from adaptiveface.tracking.types import SampleState


@pytest.fixture(scope="module")
def actor():
    return exact_actor()


def model_of(actor, **changes):
    return AdaptiveModel(actor, actor.blendshapes, AdaptivePcaParameters(**changes))


def directions(model, count, seed=0):
    """(count, 3n) orthonormal directions outside the anchors."""
    free = np.random.default_rng(seed).normal(size=(len(model.anchors), count))
    free -= model.anchors @ (model.anchors.T @ free)
    return np.linalg.qr(free)[0].T


def around(model, direction, count, spread=0.02, seed=1):
    """(count, 3n) valid samples of one expression: ``direction`` at slightly different strengths, with a little noise."""
    rng = np.random.default_rng(seed)
    length = np.sqrt(9.0 * model._unit)
    noise = directions(model, count, seed + 50) * (spread * length)
    return length * (1.0 + spread * rng.normal(size=(count, 1))) * direction + noise


def feed(model, samples):
    for sample in samples:
        assert model.learn(model.parts(sample)) is SampleState.LEARNED


def left_out(model, sample):
    """Share of the energy of a sample (3n,) outside the adaptive space."""
    rest = sample - model.anchors @ (model.anchors.T @ sample)
    return 1.0 - ((rest @ model.correctives) ** 2).sum() / (rest @ rest)


@pytest.mark.parametrize("seed", range(5))
def test_the_older_one_of_the_closest_pair_goes(seed):
    rng = np.random.default_rng(seed)
    points, new = rng.normal(size=(12, 4)), rng.normal(size=4)
    ages = rng.permutation(40)[:12]
    distances = cdist(np.vstack([points, new]), np.vstack([points, new]))
    np.fill_diagonal(distances, np.inf)
    pair = np.unravel_index(distances.argmin(), distances.shape)
    expected = min(pair, key=lambda k: ages[k] if k < 12 else 100)
    assert redundant_sample(points @ points.T, ages, points @ new, new @ new) == expected


def test_of_equally_close_pairs_the_oldest_sample_goes():
    points = np.eye(6)
    ages = np.array([3, 1, 4, 0, 5, 2])
    assert redundant_sample(points @ points.T, ages, np.zeros(6), 1.0) == 3


def test_an_expression_of_long_ago_is_still_known(actor):
    """One expression, then five times the buffer's length of others: the newest samples know nothing of it any more."""
    rest = {}
    for buffer in ("newest", "distinct"):
        model = model_of(actor, K=4, S=20, buffer=buffer)
        early, *others = directions(model, 4)
        feed(model, around(model, early, 8))
        for k in range(100):
            feed(model, around(model, others[k // 10 % 3], 1, seed=200 + k))
        rest[buffer] = left_out(model, early)
    assert rest["newest"] > 0.9 and rest["distinct"] < 0.01


def test_near_duplicates_do_not_fill_the_buffer(actor):
    """A neutral that misfits makes every frame a valid sample: four hundred of the face at rest."""
    model = model_of(actor, K=6, S=30, buffer="distinct")
    still, *expressions = directions(model, 11)
    for expression in expressions:
        feed(model, around(model, expression, 2))
    feed(model, around(model, still, 100))
    at_rest = np.abs(model.samples() @ still) > 0.5 * np.sqrt(9.0 * model._unit)
    assert at_rest.sum() < 20 and model.count == 30
    known = model.samples() @ np.array(expressions).T
    assert (np.abs(known).max(axis=0) > 0.5 * np.sqrt(9.0 * model._unit)).all(), "every expression has a sample"


def test_the_newest_sample_always_enters(actor):
    model = model_of(actor, K=3, S=10, buffer="distinct")
    for k, sample in enumerate(around(model, directions(model, 1)[0], 40)):
        feed(model, [sample])
        np.testing.assert_allclose(model.samples()[-1], sample, atol=1e-4)
        assert model.ages.max() == k and len(set(model.ages[: model.count])) == model.count


def test_the_small_matrices_are_those_of_the_samples(actor):
    """S^T S stays what it is by definition, and M orthonormal, however often rows are replaced."""
    model = model_of(actor, K=5, S=15, buffer="distinct")
    feed(model, np.concatenate([around(model, d, 12, seed=k) for k, d in enumerate(directions(model, 6))]))
    samples = model._samples.astype(float)
    np.testing.assert_allclose(model._gram, samples @ samples.T, rtol=1e-5, atol=1e-5 * model._gram.max())
    basis = np.hstack([model.anchors, model.correctives])
    np.testing.assert_allclose(basis.T @ basis, np.eye(basis.shape[1]), atol=1e-9)
    truth = np.linalg.svd(samples, full_matrices=False)[2][:5]
    explained = [((samples @ rows.T) ** 2).sum() for rows in (model.correctives.T, truth)]
    assert explained[0] > 0.97 * explained[1]


def test_the_same_samples_give_the_same_bits(actor):
    models = [model_of(actor, K=4, S=12, buffer="distinct") for _ in range(2)]
    for model in models:
        feed(model, np.concatenate([around(model, d, 10) for d in directions(model, 3)]))
    np.testing.assert_array_equal(models[0].correctives, models[1].correctives)
    np.testing.assert_array_equal(models[0].ages, models[1].ages)


def test_learning_anew_keeps_what_differs(actor):
    """A smaller buffer, filled from a larger one, holds every expression and not the newest one alone."""
    model = model_of(actor, K=3, S=60, buffer="distinct")
    shapes = directions(model, 3)
    feed(model, np.concatenate([around(model, shape, 20) for shape in shapes]))
    small = model_of(actor, K=3, S=9, buffer="distinct")
    small.learn_all(model.samples())
    assert small.count == 9 and max(left_out(small, shape) for shape in shapes) < 0.01


def test_the_paper_keeps_the_newest():
    assert Parameters.paper().adaptive_pca.buffer == "newest"
