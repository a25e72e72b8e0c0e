"""Sliders for the method's parameters, made from ``parameters.describe()``: nothing is written twice."""

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
#: Jupyter's tabs have one width and cut longer titles off.
TAB_STYLE = "<style>.adaptiveface-tabs .lm-TabBar-tab {flex: 0 0 auto !important; max-width: none !important}</style>"
#: The number of expressions used; an actor has only so many.
EXPRESSIONS = "blendshapes.A"
#: Names that are too long for the place beside a slider, and what stands there.
LABELS = {"max_correspondence_distance": "max_distance", "max_reprojection_error": "max_reprojection"}
OnChange = Callable[[Parameters], None]


class ParameterPanel:
    """One control per parameter. ``widget`` is what to display; ``parameters`` the values that were last applied.

    ``names``: stages ("laplacian") or parameters ("adaptive_pca.K"), in the order of display; several stages become
    tabs. ``on_change(parameters)`` is called for every change. When it refuses the change, or a value is out of range, the
    panel shows the message and ``parameters`` stays as it was. ``ranges``: name -> (low, high), for a slider narrower than the
    parameter's own range. ``expressions``: how many the actor has, where A's slider ends. Buttons set the paper's value
    where it differs from the default, and go back. A parameter changes only when its control is moved.
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
        self._stands_for: dict[str, tuple] = {}  # what a control shows, and the exact value that it shows so
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
        """The slider of "stage.name"; setting its ``value`` acts like moving it."""
        return self.controls[Parameters.current_name(name)]

    def set(self, **values) -> None:
        """Move several sliders at once, named ``stage__name``; applied together."""
        values = {Parameters.current_name(name): value for name, value in values.items()}
        wanted = None
        with self._errors_shown():
            wanted = self.parameters.replace(**values)
        if wanted is not None:
            self._show({name: _value(wanted, name) for name in values})
            self._apply_on_main()

    def reset(self) -> None:
        """Every slider back to where it started."""
        self.set(**{name: _value(self._start, name) for name in self.controls})

    def limit_expressions(self, count: int) -> None:
        """Let A's slider, if there is one, end at the ``count`` expressions of an actor; A itself stays as it is."""
        slider = self.controls.get(EXPRESSIONS)
        if slider is not None:
            exact = self._shown(EXPRESSIONS)
            with self._silence():
                slider.max = max(count, slider.min + 1)  # a slider needs two ends
            self._show({EXPRESSIONS: exact})

    def _show(self, values: dict) -> None:
        """Let the controls show exact values by name, without a change."""
        with self._silence():
            for name, value in values.items():
                control = self.controls[name]
                if isinstance(control, widgets.IntSlider) and name != EXPRESSIONS:
                    control.min, control.max = min(control.min, value), max(control.max, value)
                control.value = value
                self._stands_for[name] = (control.value, value)

    @contextmanager
    def _silence(self):
        """Controls that move in here do not call back."""
        self._quiet = True
        try:
            yield
        finally:
            self._quiet = False

    def _grouped(self, groups: dict[str, list[widgets.Widget]]) -> widgets.Widget:
        # As high as the heads beside it: what is used most comes first, and the rest is scrolled to.
        boxes = [widgets.VBox(rows, layout=widgets.Layout(max_height="240px", overflow="auto")) for rows in groups.values()]
        if len(boxes) == 1:
            (stage,) = groups
            return widgets.VBox([widgets.HTML(f"<b>{TITLES.get(stage, stage)}</b>"), *boxes])
        titles = [TITLES.get(stage, stage) for stage in groups]
        if len(titles) > 5:  # no room for the sections
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
        """The value that a control shows: the exact one where nobody moved it."""
        (shown, exact), value = self._stands_for[name], self.controls[name].value
        return exact if value == shown else value


def _name(row: dict) -> str:
    return f"{row['stage']}.{row['name']}"


def _value(parameters: Parameters, name: str):
    stage, _, entry = name.partition(".")
    return getattr(getattr(parameters, stage), entry)


def _control_for(row: dict, value, limits) -> widgets.Widget:
    """A control that holds the value, the default and the paper's value exactly."""
    if isinstance(value, bool):
        return widgets.Checkbox(value, indent=True)
    if row["choices"]:
        return widgets.Dropdown(options=row["choices"], value=value)
    low, high = limits or (row["low"], row["high"])
    if isinstance(value, int):  # whole numbers come back as they are
        return widgets.IntSlider(value, min=min(int(low), value), max=max(int(high), value))
    known = [float(k) for k in (value, row["default"], row["paper"]) if k is not None]
    steps = log_steps(low, high, known) if row["log"] else linear_steps(low, high)
    return ValueSlider([*steps, *(k for k in known if low <= k <= high)], value)
