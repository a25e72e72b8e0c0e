"""Combine a parameter panel, a face view, a player and charts around one replay of a performance."""

from __future__ import annotations

import html
import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence

import ipywidgets as widgets
import numpy as np

from ..errors import ParameterError
from ..geometry.frame import RgbdFrame
from ..geometry.polydata import correctives, surface
from ..insides.gaze import GazeEstimator
from ..parameters import Parameters
from ..studies.measures import Measures, Pane, TunedPane, model_features
from ..studies.recorded import NAMED
from ..studies.session import Session
from ..tracking.types import TrackedFrame
from ..tracking.verdict import verdict_of
from .charts import LiveChart, Series
from .face_view import FaceView
from .kernel import Displayed, on_main_thread
from .parameter_panel import ParameterPanel
from .pictures import CameraView
from .player import Player
from .replay import MakeTracker, Replay

#: Rate at which the charts and the sensor's picture are redrawn in turn while a performance plays, per second. The face has
#: priority.
ASIDES_PER_SECOND = 12.0
#: Largest number of frames from one picture to the next while the tracker learns.
LEARNING_STEP = 2


#: The function that gives a chart its lines: replay -> name -> values per frame.
ChartSource = Callable[[Replay], Mapping[str, Series]]


class StageExplorer(Displayed):
    """Shows a stage of the tracker and lets its parameters be changed. Display its ``widget``; :meth:`close` stops everything.

    A moved slider shows its effect on the current frame at once. The other frames follow in the background, and the charts
    grow with them.

    Parameters
    ----------
    session : Session
        The performance.
    controls : sequence of str
        Stages or parameters for the panel.
    panes : dict
        A :data:`~adaptiveface.studies.measures.Pane` or :class:`~adaptiveface.studies.measures.TunedPane` for each title.
    charts : sequence of (LiveChart, ChartSource)
        Charts over frame numbers, each with the function that gives its lines.
    limits, label : (float, float), str
        Range and meaning of the heat maps.
    parameters : Parameters, optional
        The first values; our defaults without.
    ranges : dict, optional
        (low, high) by name, for narrower sliders.
    camera : bool
        Whether the sensor's picture is shown.
    make_tracker : callable, optional
        ``make_tracker(actor, parameters)`` -> Tracker, for a tracker with other stages.
    extra : callable, optional
        ``extra(replay, index)`` is called for every frame that is shown, for further views.
    start : int
        The first frame to show.
    """

    def __init__(
        self,
        session: Session,
        controls: Sequence[str],
        panes: Mapping[str, Pane | TunedPane],
        charts: Sequence[tuple[LiveChart, ChartSource]] = (),
        *,
        limits=(0.0, 4.0),
        label: str = "",
        parameters: Parameters | None = None,
        ranges=None,
        camera: bool = True,
        make_tracker: MakeTracker | None = None,
        extra: Callable | None = None,
        start: int = 0,
    ) -> None:
        self.session, self.panes, self.charts, self.extra = session, list(panes.values()), list(charts), extra
        make_tracker = make_tracker or session.make_tracker
        self.replay = Replay(session.frames, session.actor, parameters, self._on_result, make_tracker)
        expressions = len(session.actor.blendshapes)
        self._eyes = GazeEstimator(session.actor)
        self.panel = ParameterPanel(controls, self._change, self.replay.parameters, ranges, expressions)
        side = 220 if len(panes) > 2 else 270
        self.view = FaceView.of(
            session.actor, list(panes), limits=limits, label=label, pane=(side, int(1.1 * side)), compare=True
        )
        self.camera = CameraView((190, 220)) if camera else None
        self.player = Player(len(session.frames), self.show, session.fps)
        self.verdict = widgets.HTML()  #: what the reader must know first
        self.message, self._live, self._aside, self._aside_due = widgets.HTML(), False, 0, 0.0
        self.player.button.observe(on_main_thread(lambda _: self._update_charts()), "value")
        restart = widgets.Button(
            description="learn live",
            icon="circle",
            layout=widgets.Layout(width="110px"),
            tooltip="forget everything and track the performance again while it plays",
        )
        restart.add_class("adaptiveface-live")
        restart.on_click(on_main_thread(lambda _: self.learn_live()))
        self._lay_out(restart)
        self.replay.run()
        self._update_charts()
        self.player.go_to(start) if start else self.show(0)

    def _lay_out(self, restart: widgets.Widget) -> None:
        row = widgets.Layout(flex_flow="row wrap", align_items="flex-start")
        charts = [chart.widget for chart, _ in self.charts] + ([self.camera.widget] if self.camera else [])
        # The heads are beside the sliders, and the player and the charts are below, so that everything is in sight on a laptop.
        # If a list of files takes some of the width, the heads become a little smaller before the sliders move below them. More
        # than two heads leave no room beside them, so that their sliders are beside the charts.
        wide = self.view.pane[0] * len(self.panes)
        self.view.widget.layout = widgets.Layout(flex=f"1 1 {int(0.78 * wide)}px", max_width=f"{wide + 4}px", min_width="0")
        panel = [widgets.VBox([self.panel.widget, self.message])]
        beside, below = (panel, charts) if len(self.panes) <= 2 else ([], charts + panel)
        parts = [
            self.verdict,
            widgets.HBox([self.view.widget, *beside], layout=row),
            widgets.HBox([self.player.widget, restart], layout=row),
            widgets.HBox(below, layout=row),
        ]
        self.widget = widgets.VBox(parts)
        self.widget.add_class("adaptiveface-workbench")

    @property
    def parameters(self) -> Parameters:
        """The parameters of the current results."""
        return self.replay.parameters

    @property
    def result(self):
        """The result of the current frame."""
        return self.replay.results[self.player.index]

    def mesh(self, stage: str = "v4", heat: np.ndarray | None = None):
        """Return a stage's mesh of the current frame for pyvista.

        Parameters
        ----------
        stage : str
            "v1" to "v4".
        heat : numpy.ndarray, optional
            (N,) other values, for example ``measures.error(bench.result, frame, "v2")``. They become the array ``heat``, by
            which ``plot()`` colours the mesh.

        Returns
        -------
        pyvista.PolyData
            The mesh in mm: x points out of the face, y to the subject's left, z up. Its arrays are ``displacement`` (N, 3) from
            the actor's neutral, its length ``distance`` (N,), the correctives ``corrective 1`` ... (N, 3) that are learned up
            to this frame, each scaled to move up to 1 mm, and ``normals`` (N, 3).

        Raises
        ------
        ParameterError
            There is no such stage.
        MissingExtraError
            pyvista is not installed.
        """
        if stage not in ("v1", "v2", "v3", "v4"):
            raise ParameterError(f"stage {stage!r} is none of v1, v2, v3, v4")
        actor, vertices = self.session.actor, getattr(self.result, stage)
        learned = self.replay.model_after(self.player.index).correctives
        shapes = np.zeros((learned.shape[1], *actor.neutral.shape))
        shapes[:, actor.frontal] = learned.T.reshape(len(shapes), -1, 3)
        moved = vertices - actor.neutral
        length = np.linalg.norm(moved, axis=1)
        mesh = surface(vertices, actor.triangles, displacement=moved, distance=length, heat=heat, **correctives(shapes))
        if heat is not None:
            mesh.set_active_scalars("heat")
        return mesh

    def set(self, **values) -> None:
        """Move sliders from code: ``set(laplacian__w2=100)``."""
        self.panel.set(**values)

    def learn_live(self) -> None:
        """Forget everything. Every frame is then tracked and learned when the player reaches it."""
        self.player.pause()
        self.replay.forget()
        self._live = True
        self.player.go_to(0)
        self.show(0)
        self.player.play()

    def show(self, index: int) -> None:
        """Draw frame ``index`` of the performance."""
        if self._live:
            self.replay.track_up_to(index)
            self._live = self.replay.done < len(self.session.frames)
            # Every frame is tracked. Skipping many of them would save little and hide the learning.
            self.player.longest_step = LEARNING_STEP if self._live else None
        result, frame = self.replay.current(index), self.session.frames[index]
        if result is None:
            return
        self.message.value = "" if result.tracked else f"frame {index}: {result.reason}"
        gaze = self._eyes.see(result, frame)
        gaze = None if gaze is None else np.nan_to_num(gaze)  # straight ahead if it is unknown
        for number, pane in enumerate(self.panes):
            if isinstance(pane, TunedPane):
                vertices, heat = pane.draw(result, frame, self.replay.parameters)
            else:
                vertices, heat = pane(result, frame)
            self.view.show(number, vertices, heat, gaze=gaze)
        self.view.refresh()
        if self.extra is not None:
            self.extra(self.replay, index)
        if not self.player.button.value:
            self._show_camera(result, frame)
            self._update_charts()
        elif time.perf_counter() >= self._aside_due:
            self._show_aside(result, frame)
            self._aside_due = time.perf_counter() + 1 / ASIDES_PER_SECOND

    def _show_aside(self, result: TrackedFrame, frame: RgbdFrame) -> None:
        """Redraw one of the charts and the sensor's picture, in turn."""
        self._aside = (self._aside + 1) % (len(self.charts) + 1)
        if self._aside == len(self.charts):
            self._show_camera(result, frame)
        else:
            self._update_charts(self.charts[self._aside : self._aside + 1])

    def _show_camera(self, result: TrackedFrame, frame: RgbdFrame) -> None:
        if self.camera:
            points = result.vertices[self.session.actor.frontal][::6] if result.tracked else None
            features = model_features(self.session, result.v4, result.head_pose) if result.tracked else None
            self.camera.show(frame, points, features)

    def close(self) -> None:
        """Stop the playback and the background work, and remove the widgets."""
        self.player.close()
        self.replay.close()
        self.view.close()
        self.widget.close()

    async def settled(self) -> None:
        """Wait until the background run has tracked every frame, and raise its error if it failed."""
        await self.replay.finished()

    def _change(self, parameters: Parameters) -> None:
        self._live, self.player.longest_step = False, None
        self.replay.change(parameters, self.player.index)
        self.show(self.player.index)

    def _on_result(self, index: int) -> None:
        """React to a frame that the background run finished: redraw if it is the current one, and let the charts grow."""
        if not hasattr(self, "widget") or not self.replay.busy:
            return
        last = index == len(self.session.frames) - 1
        if index % 8 == 0 or last:
            self._update_charts()
        if index == self.player.index or (last and self.player.index != index):
            self.show(self.player.index)

    def _update_charts(self, charts: Sequence[tuple[LiveChart, ChartSource]] | None = None) -> None:
        if self.replay.done == len(self.session.frames):
            self.verdict.value = html.escape(how_many([result for result in self.replay.results if result is not None]))
            self.verdict.layout.display = None if self.verdict.value else "none"
        for chart, source in self.charts if charts is None else charts:
            chart.update(self.player.index, **source(self.replay))


def how_many(results: Sequence[TrackedFrame]) -> str:
    """Say how many frames are tracked and why the others are not; "" if all are tracked."""
    lost = Counter(result.reason for result in results if not result.tracked)
    if not lost:
        return ""
    why = ", ".join(f"{reason} ({count})" for reason, count in lost.most_common(3))
    count = f"{len(results) - lost.total()} of {len(results)} frames are tracked; the others: {why}"
    return "; ".join(filter(None, (count, verdict_of(results).replace("--neutral-frames FIRST:LAST takes", f"{NAMED} takes"))))


class SeriesCache:
    """A chart source that computes one number per frame and stage, once for every result."""

    def __init__(self, function: Callable, names: Sequence[str]) -> None:
        self._function, self._names = function, tuple(names)
        self._known: dict[int, tuple[TrackedFrame, list[float]]] = {}

    def __call__(self, replay: Replay) -> dict[str, np.ndarray]:
        """Values (F,) of each curve by its name; NaN for frames that are not tracked yet."""
        out = {name: np.full(len(replay.frames), np.nan) for name in self._names}
        for index, result in enumerate(replay.results):
            if result is None or not result.tracked:
                continue
            known = self._known.get(index)
            if known is None or known[0] is not result:
                known = (result, [self._function(result, replay.frames[index], name) for name in self._names])
                self._known[index] = known
            for name, value in zip(self._names, known[1], strict=True):
                out[name][index] = value
        return out


def error_chart(session: Session, measures: Measures, stages: Sequence[str] = ("v1", "v2", "v4"), top: float = 3.0):
    """Make a chart of the mean error of each stage over the performance.

    Parameters
    ----------
    session : Session
        The performance.
    measures : Measures
        Of the session.
    stages : sequence of str
        "v1" to "v4".
    top : float
        Upper end of the axis, mm. It is higher if the truth is not known.

    Returns
    -------
    (LiveChart, ChartSource)
        The chart and its source, for a :class:`StageExplorer`.
    """
    title = f"mean error, {measures.unit}"
    chart = LiveChart(stages, (0, len(session.frames) - 1), (0, measures.top(top)), "frame", title, measures.curve)
    return chart, SeriesCache(lambda result, frame, stage: measures.mean_error(result, frame, stage), stages)


def figure_11(session: Session, top: float = 1.5):
    """Make the paper's figure 11: the distance of v2 from both spaces, before the frame is learned from.

    Parameters
    ----------
    session : Session
        The performance.
    top : float
        Upper end of the axis, mm.

    Returns
    -------
    (LiveChart, ChartSource)
        The chart and its source, for a :class:`StageExplorer`.
    """
    names = ("to anchor space", "to adaptive space")
    chart = LiveChart(names, (0, len(session.frames) - 1), (0, top), "frame", "mean distance, mm", "figure 11: distance of v2")
    return chart, lambda replay: dict(
        zip(names, (replay.series("anchor_distance"), replay.series("adaptive_distance")), strict=True)
    )
