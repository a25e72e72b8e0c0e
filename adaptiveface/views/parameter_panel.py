"""Sliders for the method's parameters, made from ``parameters.describe()``: nothing is written twice."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import ipywidgets as widgets
import numpy as np

from ..parameters import Parameters, describe
from .kernel import on_main_thread, shown_errors

TITLES = {
    "fusion": "fusion (section 3)", "fit": "identity fit (section 3)", "shrink_wrap": "shrink-wrap (section 3)",
    "depth": "depth map (4.1)", "rigid": "rigid ICP (4.1)",
    "refinement": "detected features",
    "blendshapes": "blendshape fit (4.2)",
    "kalman": "Kalman filter (4.2)", "laplacian": "Laplacian (4.3, 4.4)",
    "adaptive_pca": "adaptive PCA (5)",
}  # fmt: skip
#: Jupyter's tabs have one width and cut longer titles off.
TAB_STYLE = "<style>.adaptiveface-tabs .lm-TabBar-tab {flex: 0 0 auto !important; max-width: none !important}</style>"
OnChange = Callable[[Parameters], None]


class ParameterPanel:
    """One control per parameter. ``widget`` is what to display; ``parameters`` the values that were last applied.

    ``names``: stages ("laplacian") or parameters ("adaptive_pca.K"), in the order of display; several stages become
    tabs. ``on_change(parameters)`` is called for every change; when it (or a value) is refused, the message stands in
    the panel and ``parameters`` stays as it was. ``ranges``: name -> (low, high), for a slider narrower than the
    parameter's own range. Buttons set the paper's value where it differs from the default, and go back.
    """

    def __init__(
        self,
        names: Sequence[str],
        on_change: OnChange | None = None,
        parameters: Parameters | None = None,
        ranges: dict[str, tuple[float, float]] | None = None,
    ) -> None:
        self.parameters = self._start = parameters or Parameters()
        self.on_change = on_change or (lambda parameters: None)
        self.controls: dict[str, widgets.Widget] = {}
        self._quiet = False
        self._apply_on_main = on_main_thread(self._apply)
        self.message = widgets.HTML()
        self.message.add_class("adaptiveface-message")
        chosen = [
            row for name in names for row in describe() if name in (row["stage"], f"{row['stage']}.{row['name']}")
        ]
        groups: dict[str, list[widgets.Widget]] = {}
        for row in chosen:
            groups.setdefault(row["stage"], []).append(
                self._control(row, (ranges or {}).get(f"{row['stage']}.{row['name']}"))
            )
        reset = widgets.Button(description="reset all", icon="undo", layout=widgets.Layout(width="110px"))
        reset.on_click(lambda _: self.reset())
        self.widget = widgets.VBox([self._grouped(groups), widgets.HBox([reset, self.message])])

    def __getitem__(self, name: str) -> widgets.Widget:
        """The slider of "stage.name"; setting its ``value`` acts like moving it."""
        return self.controls[name]

    def set(self, **values) -> None:
        """Move several sliders at once, named ``stage__name``; applied together."""
        self._quiet = True
        try:
            for name, value in values.items():
                _move(self.controls[name.replace("__", ".")], value)
        finally:
            self._quiet = False
        self._apply_on_main()

    def reset(self) -> None:
        """Every slider back to where it started."""
        self.set(**{name.replace(".", "__"): _value(self._start, name) for name in self.controls})

    def _grouped(self, groups: dict[str, list[widgets.Widget]]) -> widgets.Widget:
        boxes = [widgets.VBox(rows) for rows in groups.values()]
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
        name = f"{row['stage']}.{row['name']}"
        control = _slider(row, _value(self._start, name), limits)
        control.description = row["name"]
        control.tooltip = f"{row['doc']} ({name})"
        control.style = {"description_width": "138px"}
        control.layout = widgets.Layout(width="330px")
        control.add_class("adaptiveface-" + name.replace(".", "-"))
        control.observe(lambda change: self._quiet or self._apply_on_main(), "value")
        self.controls[name] = control
        unit = widgets.HTML(
            f"<span title='{row['doc']}'>{row['unit'].replace(' per 3480 vertices', ' / mesh').replace('^2', '²')}</span>",
            layout=widgets.Layout(width="76px"),
        )
        parts = [control, unit]
        if row["paper"] is not None:
            paper = widgets.Button(
                description=f"paper: {_short(row['paper'])}",
                tooltip="set the paper's value",
                layout=widgets.Layout(width="auto", min_width="100px"),
            )
            paper.on_click(lambda _: _move(control, row["paper"]))
            parts.append(paper)
        return widgets.HBox(parts)

    def _apply(self) -> None:
        with shown_errors(lambda text: setattr(self.message, "value", text)):
            values = {name: _read(control) for name, control in self.controls.items()}
            changed = {name: v for name, v in values.items() if v != _value(self.parameters, name)}
            if changed:
                parameters = self.parameters.set(**changed)
                self.on_change(parameters)
                self.parameters = parameters


def _value(parameters: Parameters, name: str):
    stage, _, entry = name.partition(".")
    return getattr(getattr(parameters, stage), entry)


def _short(value) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _slider(row: dict, value, limits) -> widgets.Widget:
    low, high = limits or (row["low"], row["high"])
    if isinstance(value, bool):
        return widgets.Checkbox(value, indent=True)
    if row["choices"]:
        return widgets.Dropdown(options=row["choices"], value=value)
    if row["log"]:
        return widgets.SelectionSlider(
            options=_log_steps(low, high, value, row["paper"]), value=value, continuous_update=True
        )
    if isinstance(value, int):
        return widgets.IntSlider(value, min=int(low), max=int(high))
    step = 10.0 ** np.floor(np.log10(max((high - low) / 100, 1e-6)))
    digits = max(0, -int(np.floor(np.log10(step))))
    return widgets.FloatSlider(value, min=low, max=high, step=step, readout_format=f".{digits}f")


def _log_steps(low: float, high: float, *known) -> list[tuple[str, float]]:
    """Ten steps per decade from ``low`` to ``high``, and the known values exactly; zero, where allowed, comes first."""
    bottom = low if low > 0 else min([1e-3, *(0.1 * k for k in known if k)])
    first, last = np.log10(bottom), np.log10(high)
    steps = {float(f"{10**e:.3g}") for e in np.linspace(first, last, round(10 * (last - first)) + 1)}
    steps = (
        {s for s in steps if low <= s <= high}
        | {float(k) for k in known if k is not None}
        | ({0.0} if low <= 0 else set())
    )
    return [(_short(float(f"{s:.3g}")), s) for s in sorted(steps)]


def _read(control: widgets.Widget):
    return control.value


def _move(control: widgets.Widget, value) -> None:
    """Set a control; on a logarithmic slider to the nearest step."""
    if isinstance(control, widgets.SelectionSlider):
        steps = np.array([v for _, v in control.options])
        nearest = steps[np.abs(np.log(np.maximum(steps, 1e-12)) - np.log(max(value, 1e-12))).argmin()]
        control.value = float(nearest)
    else:
        control.value = value
