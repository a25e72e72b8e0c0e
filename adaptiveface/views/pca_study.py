"""Show for notebook 06 the corrective shapes as heads, the energies of the samples, and the angle to the batch PCA."""

from __future__ import annotations

import asyncio

import ipywidgets as widgets
import numpy as np

from ..geometry.mesh import vertex_normals
from ..parameters import AdaptivePcaParameters
from ..studies.learning import angle_to_batch, singular_values
from ..studies.session import Session
from ..tracking.types import SampleState, TrackedFrame
from .charts import COLOURS, BarChart, LiveChart
from .face_view import FaceView
from .figures import INK
from .kernel import BackgroundTask, on_main_thread, running_loop
from .replay import Replay
from .stage_explorer import ChartSource, StageExplorer
from .thresholds import Thresholds


class CorrectiveView:
    """The first corrective shapes, each added to the neutral, and the singular values of all shapes. Display its ``widget``.

    A shape is scaled so that its largest displacement has the length on the slider ``amount``, mm. Its colours show how far it
    moves the skin outwards (positive) or inwards. Pass :meth:`update` as ``extra`` to a
    :class:`~adaptiveface.views.StageExplorer`.

    Parameters
    ----------
    session : Session
        The performance.
    count : int
        Number of shapes to show.
    reach : float
        The first amount, and the end of the colours' range, mm.
    most : int
        Largest number of singular values to show.
    """

    def __init__(self, session: Session, count: int = 4, reach: float = 4.0, most: int = 12) -> None:
        self.actor, self._most = session.actor, most
        self._normals = vertex_normals(session.actor.neutral, session.actor.triangles)
        titles = [f"corrective {k + 1}" for k in range(count)]
        label = "displacement along the normal, mm"
        self.view = FaceView.of(session.actor, titles, limits=(-reach, reach), label=label, pane=(200, 230))
        self.amount = widgets.FloatSlider(
            reach,
            min=-2 * reach,
            max=2 * reach,
            step=0.25,
            description="amount, mm",
            layout=widgets.Layout(width="420px"),
            style={"description_width": "90px"},
        )
        self.amount.add_class("adaptiveface-amount")
        self.values = BarChart(
            [str(k + 1) for k in range(most)], (0, 0.8), "mm (rms of a vertex)", "singular values", size=(260, 260)
        )
        row = widgets.Layout(flex_flow="row wrap", align_items="flex-start")
        heads = widgets.VBox([self.view.widget, self.amount])
        wide = self.view.pane[0] * count
        heads.layout = widgets.Layout(flex=f"1 1 {int(0.78 * wide)}px", max_width=f"{wide + 4}px", min_width="0")
        self.widget = widgets.HBox([heads, self.values.widget], layout=row)
        self._last: tuple | None = None
        self._wanted: tuple[Replay, int] | None = None
        self._task = BackgroundTask()
        self.amount.observe(on_main_thread(lambda _: self._draw_wanted()), "value")

    def update(self, replay: Replay, index: int) -> None:
        """Show the correctives after frame ``index``, soon and at most 2.5 times a second, so that playback does not wait."""
        self._wanted = replay, index
        if running_loop() is None:
            self._draw(replay, index)
        elif replay.learned_by(index) != self._last and not self._task.running:
            self._task.start(self._follow())

    async def _follow(self) -> None:
        while self._wanted is not None and self._wanted[0].learned_by(self._wanted[1]) != self._last:
            self._draw(*self._wanted)
            await asyncio.sleep(0.4)

    def _draw_wanted(self) -> None:
        if self._wanted is not None:
            self._draw(*self._wanted)

    def _draw(self, replay: Replay, index: int) -> None:
        model, frontal = replay.model_after(index), self.actor.frontal
        self._last = replay.learned_by(index)
        for k in range(len(self.view.titles)):
            heat = np.full(len(self.actor.neutral), np.nan)
            vertices = self.actor.neutral.copy()
            if k < model.correctives.shape[1]:
                shape = model.correctives[:, k].reshape(-1, 3)
                shape = shape * (self.amount.value / np.linalg.norm(shape, axis=1).max())
                vertices[frontal] += shape
                heat[frontal] = (shape * self._normals[frontal]).sum(axis=1)
            self.view.show(k, vertices, heat)
        self.view.refresh()
        values = singular_values(model)[: self._most]
        self.values.update(np.pad(values, (0, self._most - len(values))))

    def close(self) -> None:
        """Stop following the explorer. The last picture stays."""
        self._task.stop()
        self.view.close()


#: What can become of a frame as a sample, and its mark in the energy chart.
MARKS = {
    SampleState.LEARNED: ("learned", {"marker": "o", "ms": 3, "ls": "", "color": COLOURS[2]}),
    SampleState.IN_ANCHOR_SPACE: ("too near", {"marker": "v", "ms": 4, "ls": "", "color": COLOURS[0]}),
    SampleState.OUTLIER: ("outlier", {"marker": "x", "ms": 6, "mew": 2, "ls": "", "color": COLOURS[1]}),
    SampleState.HIDDEN: ("hidden", {"marker": "s", "ms": 3, "ls": "", "color": INK}),
}


class EnergyChart(LiveChart):
    """Chart of ||s||^2 of every frame on a logarithmic axis, with valid_min and valid_max as lines that can be dragged."""

    def __init__(self, frames: int, y: tuple[float, float] = (0.1, 300.0)) -> None:
        marks, self._decades, self._steered = dict(MARKS.values()), np.log10(y), False
        ylabel = r"$\|s\|^2$, cm$^2$"
        super().__init__(tuple(marks), (0, frames - 1), y, "frame", ylabel, "energy of the sample", log=True, styles=marks)

    def _picture(self, size: tuple[int, int]) -> Thresholds:
        box = self._axis.get_position()
        return Thresholds(
            size=list(size),
            axes=[box.x0, 1 - box.y1, box.x1, 1 - box.y0],
            decades=[float(d) for d in self._decades],
            names={"low": "valid_min", "high": "valid_max"},
            description="energy of every frame's sample, with the thresholds valid_min and valid_max",
        )

    def show(self, parameters: AdaptivePcaParameters) -> None:
        """Move the lines to the parameters' values."""
        self._steered = True
        try:
            with self._image.hold_sync():
                self._image.low, self._image.high = parameters.valid_min, parameters.valid_max
        finally:
            self._steered = False

    def steer(self, bench: StageExplorer) -> None:
        """Let the lines move the sliders of a stage explorer."""

        def moved(change) -> None:
            if not self._steered:
                name = {"low": "valid_min", "high": "valid_max"}[change["name"]]
                bench.set(**{f"adaptive_pca__{name}": change["new"]})

        self._image.observe(on_main_thread(moved), ["low", "high"])


def energy_chart(session: Session) -> tuple[EnergyChart, ChartSource]:
    """Make the chart of ||s||^2 and its source for a stage explorer. :meth:`EnergyChart.steer` lets its lines act."""
    chart, frontal = EnergyChart(len(session.frames)), session.actor.frontal
    known: dict[int, tuple[TrackedFrame, float]] = {}

    def energy(replay: Replay, index: int, result: TrackedFrame) -> float:
        if index not in known or known[index][0] is not result:
            model = replay.tracker.model
            known[index] = (result, model.energy(model.parts((result.v2 - result.v1)[frontal].ravel()).residual))
        return known[index][1]

    def source(replay: Replay) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        chart.show(replay.parameters.adaptive_pca)
        tracked = [(k, r) for k, r in enumerate(replay.results) if r is not None and r.tracked]
        lines = {}
        for state, (name, _) in MARKS.items():
            found = [(k, energy(replay, k, r)) for k, r in tracked if r.sample_state == state]
            lines[name] = (np.array([k for k, _ in found]), np.array([e for _, e in found]))
        return lines

    return chart, source


def angle_chart(session: Session, every: int = 10):
    """Make the chart "angle to batch PCA" and its source for a stage explorer."""
    chart = LiveChart(
        ("angle",),
        (0, len(session.frames) - 1),
        (0, 30),
        "frame",
        "angle, degrees",
        "mean angle to batch PCA",
    )
    known: dict[int, tuple[object, float]] = {}

    def source(replay: Replay):
        """The curve up to the newest tracked frame."""
        values = np.full(len(replay.frames), np.nan)
        for index in range(every - 1, replay.done, every):
            result = replay.results[index]
            if index not in known or known[index][0] is not result:
                known[index] = (result, angle_to_batch(replay.model_after(index)))
            values[index] = known[index][1]
        seen = np.flatnonzero(np.isfinite(values))
        return {"angle": (seen, values[seen])}

    return chart, source
