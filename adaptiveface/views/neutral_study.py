"""Show for notebooks 01 and 02 how the neutral scan grows, the identity modes, the shrink-wrap and the personal expressions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import ipywidgets as widgets
import numpy as np

from ..evaluation import GroundTruth
from ..geometry.mesh import vertex_normals
from ..model.actor import Actor
from ..model.face_model import FaceModel, embedded_face_model
from ..neutral.fit import IdentityFit, ScanSearch
from ..neutral.fuse import FusedScan, fuse_frames
from ..neutral.shrink_wrap import shrink_wrap
from ..parameters import FusionParameters, ShrinkWrapParameters
from ..pipeline import one_thread
from ..studies.closest import distance_to_truth
from ..studies.session import Session
from .face_view import FaceView
from .kernel import Displayed, on_main_thread, shown_errors
from .sliders import TypedNumbers, ValueSlider, linear_steps

_WIDE = widgets.Layout(width="420px")
_STYLE = {"description_width": "130px"}


class _Study(Displayed, ABC):
    """Controls beside a face view. Display its ``widget``. A change calls ``draw``, and errors are shown."""

    view: FaceView

    def _assemble(self, controls: Sequence[widgets.Widget]) -> None:
        self.message = widgets.HTML(layout=widgets.Layout(max_width=_WIDE.width))  # so that a long note is wrapped
        self._draw_on_main = on_main_thread(self._redraw)
        for control in controls:
            control.observe(lambda change: self._draw_on_main(), "value")
        column = widgets.Layout(max_height="460px", overflow="auto")
        box = widgets.VBox([*controls, self.message, TypedNumbers(controls)], layout=column)
        box.add_class("adaptiveface-numbers")
        row = widgets.HBox([box, self.view.widget], layout=widgets.Layout(flex_flow="row wrap"))
        self.box, self.widget = box, widgets.VBox([row])
        self._redraw()

    def _redraw(self) -> None:
        self.note = ""
        with shown_errors(lambda text: setattr(self.message, "value", text or self.note)), one_thread():
            self.draw()
            self.view.refresh()

    @abstractmethod
    def draw(self) -> None:
        """Update the view's panes from the controls."""

    def close(self) -> None:
        """Send nothing more. The last picture stays."""
        self.view.close()


class ScanStudy(_Study):
    """The merged scan of any number of neutral frames, with voxels of any size."""

    def __init__(self, session: Session, voxel: float = 2.0) -> None:
        self.session, self.model = session, embedded_face_model()
        # A recording may begin before the detector finds a face, but the first frame to merge must show one.
        self.neutral = [frame for frame in session.neutral if frame.features is not None] or session.neutral
        most = len(self.neutral)
        self.view = FaceView(
            self.model.mean,
            self.model.triangles,
            ("merged scan",),
            limits=(0, most),
            label="depth frames that saw the point",
            centre=self.model.mean[self.model.frontal].mean(axis=0),
            colourmap="summer",  # even its low end is bright enough to show the relief of a single frame
        )
        self.view.hide_head(0)
        self.frames = widgets.IntSlider(
            1, min=1, max=most, description="frames", style=_STYLE, layout=_WIDE, continuous_update=False
        )
        self.voxel = ValueSlider(
            linear_steps(1.5, 5, 0.5),
            voxel,
            description="voxel, mm",
            style=_STYLE,
            layout=_WIDE,
            continuous_update=False,
        )
        self._assemble([self.frames, self.voxel])

    def draw(self) -> None:
        """Fuse the chosen number of frames with the chosen voxels, and show the scan."""
        parameters = FusionParameters(voxel=self.voxel.value, passes=1, min_views=0.0)
        self.scan = fuse_frames(self.neutral[: self.frames.value], self.model, parameters)
        self.view.show_points(0, self.scan.points, self.scan.weights, self.scan.normals, 20_000, size=5)
        count = len(self.scan.frames)
        self.note = (
            f"{count} frame{'s' * (count > 1)} merged, {len(self.scan.points)} points; median distance of a "
            f"single frame to the merged surface: {np.median(self.scan.residuals):.2f} mm"
        )


class IdentityStudy(_Study):
    """The first identity modes of the face model as sliders, in standard deviations."""

    def __init__(self, model: FaceModel | None = None, modes: int = 8, start: np.ndarray | None = None) -> None:
        self.model = model or embedded_face_model()
        self.view = FaceView(
            self.model.mean,
            self.model.triangles,
            ("identity",),
            limits=(0, 25),
            label="distance from the mean head, mm",
            centre=self.model.mean[self.model.frontal].mean(axis=0),
            radius=165.0,
        )
        values = np.zeros(modes) if start is None else np.clip(start[:modes], -3, 3)
        steps, look = linear_steps(-3, 3, 0.1), dict(style=_STYLE, layout=_WIDE)
        self.sliders = [ValueSlider(steps, v, description=f"mode {k + 1}", **look) for k, v in enumerate(values)]
        self._assemble(self.sliders)

    def draw(self) -> None:
        """Show the head with the chosen identity coefficients, coloured by its distance from the mean, mm."""
        vertices = self.model.neutral(np.array([slider.value for slider in self.sliders]))
        self.view.show(0, vertices, np.linalg.norm(vertices - self.model.mean, axis=1), neutral=vertices)


class ShrinkWrapStudy(_Study):
    """The fitted head before and after the shrink-wrap of any stiffness, coloured by the distance to the scan.

    Parameters
    ----------
    scan : FusedScan
        In the head frame, from :class:`~adaptiveface.neutral.capture.NeutralCapture`.
    fit : IdentityFit
        From the same capture.
    truth : GroundTruth, optional
        Of the performer.
    stiffness : float
        Where the slider begins.
    """

    def __init__(self, scan: FusedScan, fit: IdentityFit, truth: GroundTruth | None = None, stiffness: float = 0.3) -> None:
        self.truth = truth
        self.model, self.scan, self.fit, self._search = embedded_face_model(), scan, fit, ScanSearch(scan)
        self.view = FaceView(
            fit.vertices,
            self.model.triangles,
            ("after the fit", "after the shrink-wrap"),
            limits=(0, 2),
            label="distance to the scan, mm",
            centre=fit.vertices[self.model.frontal].mean(axis=0),
            pane=(330, 380),
        )
        steps = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1000.0]
        self.stiffness = widgets.SelectionSlider(
            options=[(f"{s:g}", s) for s in steps],
            value=stiffness,
            style=_STYLE,
            layout=_WIDE,
            description="rigidity at the end",
            continuous_update=False,
        )
        self._assemble([self.stiffness])

    def draw(self) -> None:
        """Wrap the fitted head onto the scan with the chosen stiffness, and show the distance of both heads to it, mm."""
        last = self.stiffness.value
        # The fine per-vertex step is left out, because it would reach the scan with any stiffness.
        parameters = ShrinkWrapParameters(rigidity_start=max(100.0, last), rigidity_end=last, detail_iterations=0)
        self.wrap = shrink_wrap(self.scan, self.model, self.fit.vertices, parameters)
        after = self.distance(self.wrap.vertices)
        self.view.show(0, self.fit.vertices, self.distance(self.fit.vertices))
        self.view.show(1, self.wrap.vertices, after, neutral=self.wrap.vertices)
        self.note = f"after the shrink-wrap: median distance to the scan {np.nanmedian(after):.2f} mm"
        if self.truth is not None:
            self.note += f", to the true face {np.median(distance_to_truth(self.wrap.vertices, self.truth)):.3f} mm"

    def distance(self, vertices: np.ndarray) -> np.ndarray:
        """(V,) point-to-plane distance to the scan, mm; NaN where the scan has no points."""
        normals = vertex_normals(vertices, self.model.triangles)
        found = self._search.correspondences(vertices, normals, self.model.frontal, 10.0, 50.0)
        out = np.full(len(vertices), np.nan)
        out[found.vertices] = np.abs(found.distances)
        return out


class ExpressionStudy(_Study):
    """Sliders for the generic expressions, with the model's average head and the actor's head side by side."""

    def __init__(self, actor: Actor, model: FaceModel | None = None, start: dict[str, float] | None = None) -> None:
        self.actor, self.model = actor, model or embedded_face_model()
        self.view = FaceView.of(
            actor, ("average head", "personal head"), limits=(0, 20), label="displacement, mm", pane=(290, 380)
        )
        self._offset = actor.neutral[actor.frontal].mean(axis=0) - self.model.mean[self.model.frontal].mean(axis=0)
        steps = linear_steps(0, 1, 0.02)
        look = dict(style={"description_width": "120px"}, layout=widgets.Layout(width="340px"))
        self.sliders = {
            name: ValueSlider(steps, (start or {}).get(name, 0.0), description=name, **look) for name in actor.expression_names
        }
        self._assemble(list(self.sliders.values()))

    def draw(self) -> None:
        """Show the chosen expression on both heads."""
        x = np.array([slider.value for slider in self.sliders.values()])
        for pane, (neutral, shapes) in enumerate(
            (
                (self.model.mean + self._offset, self.model.generic_expressions),
                (self.actor.neutral, self.actor.blendshapes),
            )
        ):
            moved = np.tensordot(x, shapes, axes=1)
            self.view.show(pane, neutral + moved, np.linalg.norm(moved, axis=1), neutral=neutral)
