"""Lay out the live view's buttons, choices and texts on the page. Their actions are in ``live_view.py``."""

from __future__ import annotations

import html
from collections.abc import Sequence

import ipywidgets as widgets

from ..live.guided import STEPS, Guidance
from ..live.statistics import LiveStatistics
from ..retargeting import BUILT_IN
from ..sensors.catalogue import list_sensors
from .kernel import ALERT
from .parameter_panel import ParameterPanel

#: Parameters of the tracker's stages act on the next frame, and those of the neutral's stages on the next scan.
STAGES = (
    "laplacian",
    "skin",
    "adaptive_pca",
    "personal_blendshapes",
    "blendshapes",
    "kalman",
    "rigid",
    "refinement",
    "depth",
    "fusion",
    "fit",
    "shrink_wrap",
)
_ROW = widgets.Layout(flex_flow="row wrap", align_items="flex-start")
_NARROW = {"description_width": "70px"}


def alert(text: str) -> str:
    """An error as HTML; "" for none."""
    if not text:
        return ""
    return f"<div role='alert' style='{ALERT}'><b>{html.escape(text)}</b></div>"


def coverage_bars(coverage: dict[str, float], step: str) -> str:
    """The progress of every direction of the scan, with the current one in bold."""
    cells = []
    for name in STEPS:
        share = coverage.get(name, 0.0)
        weight = "bold" if name == step else "normal"
        mark = "&#10003;" if share >= 1 else f"{100 * share:.0f} %"
        cells.append(
            f"<td style='padding:2px 8px;font-weight:{weight}'>{name}<br>"
            f"<progress max='1' value='{share:.2f}' style='width:70px'></progress> {mark}</td>"
        )
    return f"<table class='adaptiveface-coverage'><tr>{''.join(cells)}</tr></table>"


def instruction(guidance: Guidance) -> str:
    """The current instruction in large letters, red if something is wrong."""
    text = "; ".join(guidance.warnings) if guidance.warnings else guidance.text
    colour = ALERT if guidance.warnings else ""
    return f"<b style='font-size:150%;{colour}'>{html.escape(text)}</b>"


def dropped_frames(statistics: LiveStatistics) -> tuple[int, int, int]:
    """Frames lost by the sensor, the detector and the tracker since the sensor was opened."""
    return statistics.dropped_sensor, statistics.dropped_features, statistics.dropped_tracker


def figures(statistics: LiveStatistics, dropped: Sequence[int], rate: float, correctives: int, recorded: int | None) -> str:
    """Latency, rates and lost frames. ``rate``: pictures per second; ``recorded``: frames on disk, or None."""
    return (
        f"latency {statistics.latency_ms_p50:.0f} ms (95 %: {statistics.latency_ms_p95:.0f} ms), "
        f"{statistics.fps:.0f} frames/s tracked, {rate:.0f} pictures/s; frames dropped by the sensor {dropped[0]}, "
        f"the features {dropped[1]}, the tracker {dropped[2]}; correctives {correctives}"
        + ("" if recorded is None else f"; recorded {recorded} frames")
    )


def _button(text: str, icon: str, tooltip: str, name: str, toggle: bool = False, width: str = "150px"):
    kind = widgets.ToggleButton if toggle else widgets.Button
    out = kind(description=text, icon=icon, tooltip=tooltip, layout=widgets.Layout(width=width))
    out.add_class(f"adaptiveface-{name}")
    return out


class LiveControls:
    """The widgets by name. ``widget`` holds all of them, around the boxes ``pictures`` and ``curves``."""

    def __init__(
        self,
        on_parameters,
        parameters=None,
        sensor: str | None = None,
        character: str | None = None,
        expressions: int | None = None,
    ) -> None:
        self.sensor = widgets.Dropdown(
            options=self._sensors(sensor), description="sensor", style=_NARROW, layout=widgets.Layout(width="560px")
        )
        self.sensor.value = sensor or self.sensor.options[0][1]
        characters = [("no character", ""), *((name, name) for name in BUILT_IN)]
        if character and character not in BUILT_IN:
            characters.append((character, character))
        self.character = widgets.Dropdown(
            options=characters,
            value=character or "",
            description="character",
            style=_NARROW,
            layout=widgets.Layout(width="210px"),
        )
        self.start = _button("start", "play", "open the chosen sensor", "start", width="90px")
        self.stop = _button("stop", "stop", "close the sensor and end every thread", "stop", width="90px")
        self.status, self.trouble, self.figures = widgets.HTML(), widgets.HTML(), widgets.HTML()
        self.status.add_class("adaptiveface-live-status")
        self.figures.add_class("adaptiveface-live-figures")
        self.trouble.add_class("adaptiveface-live-trouble")
        self._make_buttons()
        self.panel = ParameterPanel(STAGES, on_parameters, parameters, expressions=expressions)
        self.pictures, self.curves = widgets.HBox([], layout=_ROW), widgets.VBox([])
        self._lay_out()

    def _sensors(self, given: str | None) -> list[tuple[str, str]]:
        known = list_sensors()
        self.states = {info.name: info.state for info in known}
        out = []
        for info in known:
            state = info.state if len(info.state) < 30 else "not available"
            out.append((f"{info.name}: {info.description} ({state})", info.name))
        if given and given not in self.states:
            out.insert(0, (given, given))
        return out

    def _make_buttons(self) -> None:
        self.progress = widgets.FloatProgress(0, min=0, max=1, layout=widgets.Layout(width="360px"))
        self.coverage = widgets.HTML()
        self.enough = _button("enough", "check", "build the head from the frames so far", "enough", width="100px")
        self.relearn = _button("relearn neutral", "user", "scan the neutral face again", "relearn")
        self.freeze = _button("freeze learning", "pause", "keep the correctives as they are", "freeze", toggle=True)
        self.reset = _button(
            "reset correctives", "trash", "forget every learned corrective, and what was learned about the expressions", "reset"
        )
        self.record = _button("record", "circle", "write the frames to the folder", "record", toggle=True, width="100px")
        self.folder = widgets.Text("", placeholder="folder (named by date and time)", layout=widgets.Layout(width="260px"))
        self.save = _button("save actor", "download", "write the head to the file", "save", width="110px")
        self.file = widgets.Text("actor.npz", layout=widgets.Layout(width="180px"))

    def _lay_out(self) -> None:
        self.scan = widgets.VBox(
            [widgets.HBox([self.progress, self.enough], layout=_ROW), self.coverage],
        )
        first = widgets.HBox([self.relearn, self.freeze, self.reset], layout=_ROW)
        second = widgets.HBox([self.record, self.folder, self.save, self.file], layout=_ROW)
        self.actions = widgets.VBox([first, second])
        top = widgets.HBox([self.sensor, self.character, self.start, self.stop], layout=_ROW)
        self.widget = widgets.VBox(
            [
                top,
                self.status,
                self.trouble,
                self.scan,
                self.pictures,
                self.figures,
                self.panel.widget,
                self.actions,
                self.curves,
            ]
        )
        self.widget.add_class("adaptiveface-live-view")

    def show(self, scanning: bool, tracking: bool, running: bool) -> None:
        """Show and enable only the controls that can be used now."""
        self.scan.layout.display = "flex" if scanning else "none"
        self.enough.disabled = not scanning
        for button in (self.relearn, self.freeze, self.reset, self.record, self.save):
            button.disabled = not tracking
        self.start.disabled, self.stop.disabled, self.sensor.disabled = running, not running, running
