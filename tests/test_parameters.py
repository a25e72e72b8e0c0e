"""One source of truth: defaults, ranges, the paper's values, text and JSON."""

import dataclasses
import importlib
import json
import sys

import pytest

import adaptiveface
from adaptiveface.cli.arguments import parameters
from adaptiveface.errors import ParameterError
from adaptiveface.parameters import FitParameters, Parameters, describe
from adaptiveface.renamed import OLD_MODULES, OLD_NAMES, OLD_OBJECTS


def test_paper_values_are_the_printed_ones():
    paper = Parameters.paper()
    assert (paper.blendshapes.w, paper.blendshapes.A, paper.blendshapes.iterations) == (5e-5, 23, 3)
    assert (paper.blendshapes.lower, paper.blendshapes.upper) == (0.0, 1.0)
    assert (paper.laplacian.w1, paper.laplacian.w2, paper.laplacian.final_w2) == (0.1, 100.0, 100.0)
    assert (paper.adaptive_pca.K, paper.adaptive_pca.S, paper.adaptive_pca.em_steps) == (7, 200, 2)
    assert (paper.adaptive_pca.valid_min, paper.adaptive_pca.valid_max) == (1.0, 100.0)
    assert paper.adaptive_pca.startup == "full-buffer"
    assert (paper.rigid.max_correspondence_distance, paper.rigid.max_residual, paper.depth.crop) == (25.0, 3.0, 200)
    assert (paper.kalman.process_noise, paper.kalman.measurement_noise) == (0.05, 0.02)


def test_live_tracking_differs_from_the_defaults_in_how_often_the_detector_looks():
    assert Parameters.live() == Parameters().replace(refinement__detect_every=2)
    assert parameters(["laplacian.w1=0.2"], live=True) == Parameters.live().replace(laplacian__w1=0.2)
    assert parameters(["refinement.detect_every=1"], live=True) == Parameters()


@pytest.mark.parametrize("key, value", [("laplacian.w1", "0.2"), ("laplacian__w1", 0.2)])
def test_set_takes_text_and_values(key, value):
    changed = Parameters().replace(**{key: value})
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
        Parameters().replace(**{key: value})
    assert key in str(error.value) or "nowhere" in str(error.value)


@pytest.mark.parametrize("low, high", [(200, 100), (100.0001, 100), (1e4, 0), (1.5, 1)])
def test_valid_min_above_valid_max_is_refused_with_a_reason(low, high):
    """No sample could be learned. Both may change at once, and may be equal."""
    with pytest.raises(ParameterError, match="valid_min = .* is above adaptive_pca.valid_max = .*no sample"):
        Parameters().replace(**{"adaptive_pca.valid_min": low, "adaptive_pca.valid_max": str(high)})
    with pytest.raises(ParameterError, match="valid_min"):
        Parameters.from_json(json.dumps({"adaptive_pca": {"valid_min": low, "valid_max": high}}))
    for pair in ((high, low), (high, high), (0, 0), (500, 1000)):
        kept = Parameters().replace(adaptive_pca__valid_min=pair[0], adaptive_pca__valid_max=pair[1]).adaptive_pca
        assert (kept.valid_min, kept.valid_max) == pair


def test_json_round_trip():
    changed = Parameters().replace(laplacian__w2=7.5, adaptive_pca__learn=False)
    assert Parameters.from_json(changed.to_json()) == changed
    assert json.loads(changed.to_json())["laplacian"]["w2"] == 7.5
    with pytest.raises(ParameterError):
        Parameters.from_json("[1, 2]")


def test_a_copy_is_changed_and_the_earlier_name_of_replace_warns():
    start = Parameters()
    changed = start.replace(laplacian__w2=7.5)
    assert changed != start == Parameters()
    with pytest.warns(DeprecationWarning, match="Parameters.set is now called replace"):
        assert start.set(laplacian__w2=7.5) == changed


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


KINDS = {type(getattr(Parameters(), entry.name)).__name__: entry.name for entry in dataclasses.fields(Parameters)}
OLD_PARAMETERS = [(stage, *pair) for kind, stage in KINDS.items() for pair in OLD_NAMES.get(kind, {}).items()]


@pytest.mark.parametrize("stage, old, new", OLD_PARAMETERS)
def test_old_names_of_parameters_work_with_a_warning(stage, old, new):
    row = next(row for row in describe() if (row["stage"], row["name"]) == (stage, new))
    value = type(row["default"])(row["low"])
    with pytest.warns(DeprecationWarning, match=new):
        changed = Parameters().replace(**{f"{stage}.{old}": value})
    assert changed == Parameters().replace(**{f"{stage}__{new}": value})
    with pytest.warns(DeprecationWarning, match=new):
        assert getattr(getattr(changed, stage), old) == value
    with pytest.warns(DeprecationWarning, match=f"{old}.* is now called {new}"):
        assert type(getattr(changed, stage))(**{old: value}) == getattr(changed, stage)


@pytest.mark.filterwarnings("error")
def test_files_of_an_earlier_version_keep_their_parameters_without_a_warning():
    today = Parameters().replace(rigid__max_residual=2.0, blendshapes__vertex_stride=5, laplacian__cg_iterations=4)
    names = {(stage, new): old for stage, old, new in OLD_PARAMETERS}
    stages = json.loads(today.to_json())
    earlier = {s: {names.get((s, name), name): v for name, v in values.items()} for s, values in stages.items()}
    assert earlier["rigid"]["lost"] == 2.0 and "max_residual" not in earlier["rigid"]
    assert Parameters.from_json(json.dumps(earlier)) == today
    assert Parameters.stored(json.dumps(earlier)) == stages


def test_old_names_of_attributes_and_keywords_work_with_a_warning():
    from adaptiveface.tracking.types import TrackedFrame

    arrays = dict.fromkeys(("v1", "v2", "v3", "v4", "coefficients_initial", "coefficients"), None)
    with pytest.warns(DeprecationWarning, match="head_pose"):
        frame = TrackedFrame(0, 0.0, True, rigid="pose", **arrays, sample_state=0, corrective_updates=0)
    with pytest.warns(DeprecationWarning, match="TrackedFrame.rigid is now called head_pose"):
        assert frame.rigid == frame.head_pose == "pose"
    with pytest.warns(DeprecationWarning, match="head_pose"):
        assert dataclasses.replace(frame, rigid="other").head_pose == "other"
    assert not {old for names in OLD_NAMES.values() for old in names} & {entry.name for entry in dataclasses.fields(frame)}


def test_old_names_of_classes_work_with_a_warning():
    for module, names in OLD_OBJECTS.items():
        for old, (home, new) in names.items():
            with pytest.warns(DeprecationWarning, match=new):
                found = getattr(importlib.import_module(module), old)
            assert found is getattr(importlib.import_module(home), new)
            with pytest.raises(AttributeError, match="no attribute"):
                getattr(importlib.import_module(module), f"{old}Nobody")
    assert FitParameters().max_correspondence_distance == 20.0


@pytest.mark.parametrize("old, new", OLD_MODULES.items())
def test_modules_that_moved_are_found_by_their_old_names_with_a_warning(old, new, monkeypatch):
    module = importlib.import_module(new)
    specification = module.__spec__
    monkeypatch.delitem(sys.modules, old, raising=False)
    with pytest.warns(DeprecationWarning, match=f"{old} is now called {new}") as caught:
        assert importlib.import_module(old) is module
    assert module.__spec__ is specification and module.__package__ == new.rpartition(".")[0]
    assert not caught[0].filename.endswith("renamed.py")
