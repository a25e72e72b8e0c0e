"""Sliders without a browser: which numbers they hold, what they send, and what a panel makes of it."""

from __future__ import annotations

import math

import pytest

pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")
pytest.importorskip("anywidget", reason="the extra 'notebooks' is not installed")

import ipywidgets as widgets  # noqa: E402
import traitlets  # noqa: E402

from adaptiveface import views  # noqa: E402
from adaptiveface.parameters import Parameters, describe  # noqa: E402
from adaptiveface.views.sliders import TypedNumbers, ValueSlider, linear_steps, log_steps, short  # noqa: E402

STAGES = list(dict.fromkeys(row["stage"] for row in describe()))
NUMBERS = [row for row in describe() if type(row["default"]) in (int, float)]


def in_the_browser(slider, value: float) -> float:
    """What JupyterLab sends back for a value when it shows a slider: noUiSlider's arithmetic, in percent of the range."""
    if isinstance(slider, ValueSlider):
        value, low, high, step = slider.numbers.index(value), 0, len(slider.numbers) - 1, 1
    else:
        low, high, step = slider.min, slider.max, slider.step
    percent = (value + abs(low) if low < 0 else value - low) * 100 / (high - low)
    step = step * 100 / (high - low)
    percent = math.floor(percent / step + 0.5) * step
    shown = high if percent >= 100 else percent * (high - low) / 100 + low
    if isinstance(slider, ValueSlider):
        return slider.numbers[round(shown)]
    return round(shown) if isinstance(slider, widgets.IntSlider) else shown


@pytest.mark.parametrize(
    "start",
    [
        Parameters(),
        Parameters.paper(),
        Parameters().replace(
            blendshapes__sparsity=1 / 3,
            laplacian__w2=7.123,
            rigid__max_correspondence_distance=17.25,
            fusion__voxel=0.7,
            rigid__min_step=0.1 + 0.2,
        ),
    ],
    ids=["defaults", "paper", "odd values"],
)
def test_no_parameter_changes_by_being_shown(start):
    """Every control holds its value, the default and the paper's value, and the browser's rounding changes none."""
    panel = views.ParameterPanel(STAGES, parameters=start)
    for row in NUMBERS:
        name = f"{row['stage']}.{row['name']}"
        control = panel[name]
        exact = getattr(getattr(start, row["stage"]), row["name"])
        for value in (exact, row["default"], row["paper"], row["low"], row["high"]):
            if value is not None:
                assert not isinstance(control, ValueSlider) or value in control.numbers, (name, value)
                assert in_the_browser(control, value) == value, (name, value)
        if isinstance(control, ValueSlider):
            control.set_state({"index": round(control.index + 1e-9)})
            assert len(set(control._options_labels)) == len(control.numbers) < 400, f"{name}: steps that look alike"
        else:
            control.set_state({"value": in_the_browser(control, control.value)})
    assert repr(panel.parameters) == repr(start)


def test_a_browser_that_rounds_would_be_seen():
    """The check above finds what was wrong: 2.5 on steps of 10 and 20 on steps of 1."""
    assert in_the_browser(widgets.FloatSlider(2.5, min=0, max=1000, step=10), 2.5) == 0
    assert in_the_browser(widgets.FloatSlider(20, min=1, max=200, step=1), 20.0) == 19.999999999999996


def test_a_parameter_changes_only_when_its_own_control_moves():
    """An actor with fewer expressions than A: the slider ends there, and A stays what it was until it is moved."""
    told = []
    panel = views.ParameterPanel(["blendshapes"], told.append, expressions=10)
    assert (panel["blendshapes.A"].value, panel["blendshapes.A"].max) == (10, 10)
    panel["blendshapes.sparsity"].set_state({"index": panel["blendshapes.sparsity"].index + 1})
    assert told[-1].blendshapes.A == 23 and told[-1].blendshapes.sparsity > 2.5
    panel["blendshapes.A"].value = 4
    assert told[-1].blendshapes.A == 4
    panel.reset()
    assert repr(panel.parameters) == repr(told[-1]) == repr(Parameters()) and panel["blendshapes.A"].value == 10


@pytest.mark.parametrize("count, end", [(1, 2), (7, 7), (23, 23), (52, 52)])
def test_the_slider_of_A_ends_at_the_actors_expressions(count, end):
    told = []
    panel = views.ParameterPanel(["blendshapes.A"], told.append, expressions=count)
    assert panel["blendshapes.A"].max == end
    panel.limit_expressions(30)
    assert panel["blendshapes.A"].max == 30 and panel["blendshapes.A"].value == 23 and not told


def test_code_sets_exact_values_also_beyond_a_narrowed_slider():
    panel = views.ParameterPanel(["adaptive_pca"], ranges={"adaptive_pca.K": (0, 30), "adaptive_pca.valid_max": (1, 500)})
    panel.set(adaptive_pca__K=50, adaptive_pca__valid_max=12345.678)
    assert (panel["adaptive_pca.K"].value, panel["adaptive_pca.valid_max"].value) == (50, 12345.678)
    assert (panel.parameters.adaptive_pca.K, panel.parameters.adaptive_pca.valid_max) == (50, 12345.678)


def test_a_refused_value_stays_visible_and_counts_once_it_is_possible(monkeypatch):
    monkeypatch.delenv("ADAPTIVEFACE_STRICT", raising=False)
    panel = views.ParameterPanel(["adaptive_pca"])
    panel["adaptive_pca.valid_min"].value = 250
    assert "valid_min = 250 is above adaptive_pca.valid_max = 100" in panel.message.value
    assert repr(panel.parameters) == repr(Parameters())
    panel.set(adaptive_pca__valid_max=20.0)
    assert panel.message.value and panel.parameters == Parameters()
    panel["adaptive_pca.valid_max"].value = 300.0
    assert (panel.parameters.adaptive_pca.valid_min, panel.parameters.adaptive_pca.valid_max) == (250, 300)
    assert panel.message.value == ""
    panel.set(adaptive_pca__K=1000)
    assert "outside its range" in panel.message.value and panel["adaptive_pca.K"].value == 12


def test_value_slider_takes_numbers_between_its_steps():
    slider = ValueSlider(linear_steps(0, 1, 0.25), 0.5, description="share")
    seen = []
    slider.observe(lambda change: seen.append(slider.value), "value")
    slider.value = 0.6
    slider.value = 0.1
    slider.value = 2.0
    assert seen == [0.6, 0.1, 2.0] and slider.numbers == (0, 0.1, 0.25, 0.5, 0.6, 0.75, 1, 2)
    slider.set_state({"index": 3})
    assert slider.value == 0.5 and slider.label == "0.5"
    for wrong in (math.nan, math.inf):
        with pytest.raises(traitlets.TraitError, match="finite"):
            slider.value = wrong
    assert slider.value == 0.5


@pytest.mark.parametrize(
    "text, value",
    [
        ("0.3", 0.3),
        ("0,3", 0.3),
        ("3e-1", 0.3),
        ("\u22121", 0.0),
        ("7", 1.0),
        ("much", 0.5),
        ("", 0.5),
        ("nan", 0.5),
        ("inf", 0.5),
        (None, 0.5),
    ],
)
def test_typed_numbers_move_the_slider_within_its_ends(text, value):
    slider = ValueSlider(linear_steps(0, 1), 0.5)
    typed = TypedNumbers([slider, widgets.IntSlider(3)])
    typed.type(slider.model_id, text)
    typed.type("another", "0.9")
    assert slider.value == value


@pytest.mark.parametrize("low, high", [(0, 1), (1, 200), (0.5, 10), (-3, 3), (0, 1e6), (-1, 0), (0.1, 0.10001), (5, 1e5)])
def test_linear_steps_are_round_and_hold_both_ends(low, high):
    steps = linear_steps(low, high)
    assert (steps[0], steps[-1]) == (low, high) and 80 < len(steps) < 210
    assert all(float(f"{s:.9g}") == s for s in steps) and steps == sorted(set(steps))


def test_log_steps_begin_at_zero_where_zero_is_allowed():
    assert log_steps(0, 100)[:2] == [0, 1e-3] and log_steps(0, 100, [1e-5])[1] == 1e-6
    assert log_steps(0.3, 7)[0] == 0.3 and log_steps(0.3, 7)[-1] == 7
    assert [short(v) for v in (5e-5, 0.1, 2.5, 1e6, 1 / 3, 7, 1234567.5)] == [
        "5e-05",
        "0.1",
        "2.5",
        "1e+06",
        "0.333333333333",
        "7",
        "1234567.5",
    ]


def test_every_parameters_name_has_room_beside_its_slider():
    """Jupyter cuts longer ones off."""
    panel = views.ParameterPanel(list(dict.fromkeys(row["stage"] for row in describe())), lambda _: None)
    assert [c.description for c in panel.controls.values() if len(c.description) > 20] == []
