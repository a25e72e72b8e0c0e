"""One source of truth: defaults, ranges, the paper's values, text and JSON."""

import dataclasses
import json

import pytest

import adaptiveface
from adaptiveface.errors import ParameterError
from adaptiveface.parameters import Parameters, describe


def test_paper_values_are_the_printed_ones():
    paper = Parameters.paper()
    assert (paper.blendshapes.w, paper.blendshapes.A, paper.blendshapes.iterations) == (5e-5, 23, 3)
    assert (paper.blendshapes.lower, paper.blendshapes.upper) == (0.0, 1.0)
    assert (paper.laplacian.w1, paper.laplacian.w2, paper.laplacian.final_w2) == (0.1, 100.0, 100.0)
    assert (paper.adaptive_pca.K, paper.adaptive_pca.S, paper.adaptive_pca.em_steps) == (7, 200, 2)
    assert (paper.adaptive_pca.valid_min, paper.adaptive_pca.valid_max) == (1.0, 100.0)
    assert paper.adaptive_pca.startup == "full-buffer"
    assert (paper.rigid.prune, paper.rigid.lost, paper.depth.crop) == (25.0, 3.0, 200)
    assert (paper.kalman.process_noise, paper.kalman.measurement_noise) == (0.05, 0.02)


@pytest.mark.parametrize("key, value", [("laplacian.w1", "0.2"), ("laplacian__w1", 0.2)])
def test_set_takes_text_and_values(key, value):
    changed = Parameters().set(**{key: value})
    assert changed.laplacian.w1 == 0.2
    assert changed.rigid == Parameters().rigid


@pytest.mark.parametrize(
    "key, value, words",
    [
        ("laplacian.w1", "many", "a number"),
        ("laplacian.w1", -1, "outside its range"),
        ("laplacian.w1", float("nan"), "finite"),
        ("adaptive_pca.K", 2.5, "whole number"),
        ("adaptive_pca.startup", "now", "growing"),
        ("adaptive_pca.learn", "perhaps", "true or false"),
        ("nowhere.w1", 1, "unknown stage"),
        ("laplacian.w9", 1, "unknown parameter"),
    ],
)
def test_wrong_values_are_named(key, value, words):
    with pytest.raises(ParameterError, match=words) as error:
        Parameters().set(**{key: value})
    assert key in str(error.value) or "nowhere" in str(error.value)


@pytest.mark.parametrize("low, high", [(200, 100), (100.0001, 100), (1e4, 0), (1.5, 1)])
def test_valid_min_above_valid_max_is_refused_with_a_reason(low, high):
    """No sample could be learned. Both may change at once, and may be equal."""
    with pytest.raises(ParameterError, match="valid_min = .* is above adaptive_pca.valid_max = .*no sample"):
        Parameters().set(**{"adaptive_pca.valid_min": low, "adaptive_pca.valid_max": str(high)})
    with pytest.raises(ParameterError, match="valid_min"):
        Parameters.from_json(json.dumps({"adaptive_pca": {"valid_min": low, "valid_max": high}}))
    for pair in ((high, low), (high, high), (0, 0), (500, 1000)):
        kept = Parameters().set(adaptive_pca__valid_min=pair[0], adaptive_pca__valid_max=pair[1]).adaptive_pca
        assert (kept.valid_min, kept.valid_max) == pair


def test_json_round_trip():
    changed = Parameters().set(laplacian__w2=7.5, adaptive_pca__learn=False)
    assert Parameters.from_json(changed.to_json()) == changed
    assert json.loads(changed.to_json())["laplacian"]["w2"] == 7.5
    with pytest.raises(ParameterError):
        Parameters.from_json("[1, 2]")


def test_every_parameter_is_documented_and_its_values_lie_in_range():
    rows = describe()
    assert (
        len({(row["stage"], row["name"]) for row in rows})
        == len(rows)
        == sum(len(dataclasses.fields(getattr(Parameters(), stage.name))) for stage in dataclasses.fields(Parameters))
    )
    for row in rows:
        assert row["doc"], row
        numeric = isinstance(row["default"], (int, float)) and not isinstance(row["default"], bool)
        assert not numeric or (row["low"] is not None and row["high"] is not None), row
        for value in (row["default"], row["paper"]):
            if value is not None and row["low"] is not None:
                assert row["low"] <= value <= row["high"], row


def test_public_names_resolve():
    for name in adaptiveface.__all__:
        assert getattr(adaptiveface, name) is not None
    with pytest.raises(AttributeError):
        adaptiveface.no_such_name  # noqa: B018
