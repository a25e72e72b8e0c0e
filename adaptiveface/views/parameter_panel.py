"""Make sliders for the method's parameters from ``parameters.describe()``, so that nothing is written twice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import contextmanager

import ipywidgets as widgets

from ..parameters import Parameters, describe
from .kernel import on_main_thread, shown_errors
from .sliders import TypedNumbers, ValueSlider, linear_steps, log_steps, short

TITLES = {
    "fusion": "fusion (section 3)",
    "fit": "identity fit (section 3)",
    "shrink_wrap": "shrink-wrap (section 3)",
    "depth": "depth map (4.1)",
    "rigid": "rigid ICP (4.1)",
    "refinement": "detected features",
    "blendshapes": "blendshape fit (4.2)",
    "kalman": "Kalman filter (4.2)",
    "laplacian": "Laplacian (4.3, 4.4)",
    "skin": "dense skin",
    "adaptive_pca": "adaptive PCA (5)",
    "personal_blendshapes": "personal blendshapes",
}
#: Shorter titles. All of Jupyter's tabs have the same width, and longer titles are cut off.
TAB_STYLE = "<style>.adaptiveface-tabs .lm-TabBar-tab {flex: 0 0 auto !important; max-width: none !important}</style>"
#: The number of expressions in use, which cannot exceed that of the actor.
EXPRESSIONS = "blendshapes.A"
#: Names that are too long for the space beside a slider, and their short forms.
LABELS = {"max_correspondence_distance": "max_distance", "max_reprojection_error": "max_reprojection"}
OnChange = Callable[[Parameters], None]


class ParameterPanel:
    """One control per parameter. Display its ``widget``; ``parameters`` holds the values that were applied last.

    A parameter changes only when its control is moved. Buttons set the paper's value if it differs from the default, and go
    back. If ``on_change`` refuses a change, or a value is out of range, the panel shows the message and ``parameters`` keeps
    its values.

    Parameters
    ----------
    names : sequence of str
        Stages ("laplacian") or parameters ("adaptive_pca.K") in the order of display. Several stages become tabs.
    on_change : callable, optional
        ``on_change(parameters)`` is called for every change.
    parameters : Parameters, optional
        The first values; our defaults without.
    ranges : dict, optional
        (low, high) by name, for sliders that are narrower than the parameter's own range.
    expressions : int, optional
        Number of the actor's expressions, at which A's slider ends.
    """

    def __init__(
        self,
        names: Sequence[str],
        on_change: OnChange | None = None,
        parameters: Parameters | None = None,
        ranges: dict[str, tuple[float, float]] | None = None,
        expressions: int | None = None,
    ) -> None:
        self.parameters = self._start = parameters or Parameters()
        self.on_change = on_change or (lambda parameters: None)
        self.controls: dict[str, widgets.Widget] = {}
        self._stands_for: dict[str, tuple] = {}  # what a control shows, and the exact value behind it
        self._quiet = False
        self._apply_on_main = on_main_thread(self._apply)
        self.message = widgets.HTML()
        self.message.add_class("adaptiveface-message")
        groups: dict[str, list[widgets.Widget]] = {}
        names = [Parameters.current_name(name) if "." in name else name for name in names]
        ranges = {Parameters.current_name(name): limits for name, limits in (ranges or {}).items()}
        for row in (row for name in names for row in describe() if name in (row["stage"], _name(row))):
            groups.setdefault(row["stage"], []).append(self._control(row, ranges.get(_name(row))))
        if expressions is not None:
            self.limit_expressions(expressions)
        reset = widgets.Button(description="reset all", icon="undo", layout=widgets.Layout(flex="0 0 110px"))
        reset.on_click(lambda _: self.reset())
        below = widgets.HBox([reset, self.message, TypedNumbers(self.controls.values())])
        self.widget = widgets.VBox([self._grouped(groups), below])
        self.widget.add_class("adaptiveface-numbers")

    def __getitem__(self, name: str) -> widgets.Widget:
        """Return the slider of "stage.name". Setting its ``value`` has the effect of moving it."""
        return self.controls[Parameters.current_name(name)]

    def set(self, **values) -> None:
        """Move several sliders, named ``stage__name``, and apply their values together."""
        values = {Parameters.current_name(name): value for name, value in values.items()}
        wanted = None
        with self._errors_shown():
            wanted = self.parameters.replace(**values)
        if wanted is not None:
            self._show({name: _value(wanted, name) for name in values})
            self._apply_on_main()

    def reset(self) -> None:
        """Move every slider back to its first value."""
        self.set(**{name: _value(self._start, name) for name in self.controls})

    def limit_expressions(self, count: int) -> None:
        """Let A's slider, if there is one, end at the number of an actor's expressions. A itself does not change."""
        slider = self.controls.get(EXPRESSIONS)
        if slider is not None:
            exact = self._shown(EXPRESSIONS)
            with self._silence():
                slider.max = max(count, slider.min + 1)  # a slider needs two ends
            self._show({EXPRESSIONS: exact})

    def _show(self, values: dict) -> None:
        """Let the controls show exact values, by name, without applying a change."""
        with self._silence():
            for name, value in values.items():
                control = self.controls[name]
                if isinstance(control, widgets.IntSlider) and name != EXPRESSIONS:
                    control.min, control.max = min(control.min, value), max(control.max, value)
                control.value = value
                self._stands_for[name] = (control.value, value)

    @contextmanager
    def _silence(self):
        """Context in which controls can be moved without a call of ``on_change``."""
        self._quiet = True
        try:
            yield
        finally:
            self._quiet = False

    def _grouped(self, groups: dict[str, list[widgets.Widget]]) -> widgets.Widget:
        # The box is as high as the heads beside it. The most used sliders come first, and the others are reached by scrolling.
        boxes = [widgets.VBox(rows, layout=widgets.Layout(max_height="240px", overflow="auto")) for rows in groups.values()]
        if len(boxes) == 1:
            (stage,) = groups
            return widgets.VBox([widgets.HTML(f"<b>{TITLES.get(stage, stage)}</b>"), *boxes])
        titles = [TITLES.get(stage, stage) for stage in groups]
        if len(titles) > 5:  # there is no room for the sections
            titles = [title.partition(" (")[0] for title in titles]
        tabs = widgets.Tab(boxes, titles=titles)
        tabs.add_class("adaptiveface-tabs")
        return widgets.VBox([widgets.HTML(TAB_STYLE, layout=widgets.Layout(display="none")), tabs])

    def _control(self, row: dict, limits) -> widgets.Widget:
        name, value = _name(row), _value(self._start, _name(row))
        control = _control_for(row, value, limits)
        control.description = LABELS.get(row["name"], row["name"])
        control.tooltip = f"{row['doc']} ({name})"
        control.style = {"description_width": "136px"}
        control.layout = widgets.Layout(width="318px")
        control.add_class("adaptiveface-" + name.replace(".", "-"))
        control.observe(lambda change: self._quiet or self._apply_on_main(), "value")
        self.controls[name], self._stands_for[name] = control, (control.value, value)
        measure = row["unit"].replace(" per 3480 vertices", "/mesh").replace("^2", "²")
        unit = widgets.HTML(
            f"<span style='white-space: nowrap' title='{row['doc']}'>{measure}</span>",
            layout=widgets.Layout(width="68px"),
        )
        parts = [control, unit]
        if row["paper"] is not None:
            paper = widgets.Button(
                description=f"paper: {short(row['paper'])}",
                tooltip="set the paper's value",
                layout=widgets.Layout(width="auto", min_width="84px"),
            )
            paper.on_click(lambda _: self.set(**{name: row["paper"]}))
            parts.append(paper)
        return widgets.HBox(parts, layout=widgets.Layout(flex="0 0 auto"))

    def _apply(self) -> None:
        with self._errors_shown():
            changed = {name: v for name in self.controls if (v := self._shown(name)) != _value(self.parameters, name)}
            if changed:
                parameters = self.parameters.replace(**changed)
                self.on_change(parameters)
                self.parameters = parameters

    def _errors_shown(self):
        return shown_errors(lambda text: setattr(self.message, "value", text))

    def _shown(self, name: str):
        """The value of a control, which is the exact one until it is moved."""
        (shown, exact), value = self._stands_for[name], self.controls[name].value
        return exact if value == shown else value


def _name(row: dict) -> str:
    return f"{row['stage']}.{row['name']}"


def _value(parameters: Parameters, name: str):
    stage, _, entry = name.partition(".")
    return getattr(getattr(parameters, stage), entry)


def _control_for(row: dict, value, limits) -> widgets.Widget:
    """Make a control that can hold the value, the default and the paper's value exactly."""
    if isinstance(value, bool):
        return widgets.Checkbox(value, indent=True)
    if row["choices"]:
        return widgets.Dropdown(options=row["choices"], value=value)
    low, high = limits or (row["low"], row["high"])
    if isinstance(value, int):  # whole numbers come back unchanged
        return widgets.IntSlider(value, min=min(int(low), value), max=max(int(high), value))
    known = [float(k) for k in (value, row["default"], row["paper"]) if k is not None]
    steps = log_steps(low, high, known) if row["log"] else linear_steps(low, high)
    return ValueSlider([*steps, *(k for k in known if low <= k <= high)], value)
