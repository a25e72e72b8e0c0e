"""Show for notebook 07 the pipeline with stages left out, side by side."""

from __future__ import annotations

from collections.abc import Sequence

import ipywidgets as widgets
import numpy as np

from ..evaluation.ablation import VARIANTS, Variant
from ..insides.gaze import GazeEstimator
from ..parameters import Parameters
from ..studies.measures import Measures
from ..studies.session import Session
from ..tracking.types import TrackedFrame
from .face_view import FaceView
from .kernel import Displayed
from .player import Player
from .replay import Replay


class AblationView(Displayed):
    """The same frame tracked by several variants of the pipeline, coloured by the error. Display its ``widget``.

    Parameters
    ----------
    session : Session
        The performance.
    variants : sequence of Variant, optional
        The first six of :data:`~adaptiveface.evaluation.ablation.VARIANTS` by default.
    parameters : Parameters, optional
        Of all variants; our defaults without.
    frames : int, optional
        Number of leading frames to track; all by default.
    start : int
        The first frame to show.
    """

    def __init__(
        self,
        session: Session,
        variants: Sequence[Variant] | None = None,
        parameters: Parameters | None = None,
        frames: int | None = None,
        start: int = 0,
    ) -> None:
        self.session, self.measures = session, Measures(session)
        self.variants = list(variants or [v for v in VARIANTS if v.fit][:6])
        self.frames, parameters = session.frames[:frames], parameters or Parameters()
        runs: dict[tuple, list[TrackedFrame]] = {}
        for variant in self.variants:
            key = tuple(variant.changes.items())
            if key not in runs:
                runs[key] = Replay(self.frames, session.actor, parameters.replace(**variant.changes)).run()
        self._runs = [runs[tuple(variant.changes.items())] for variant in self.variants]
        columns = min(3, len(self.variants))
        shape = (-(-len(self.variants) // columns), columns)
        names = (variant.name for variant in self.variants)
        self._titles = titles = [
            name.replace("without the adaptive space and the final deformation", "v2 as the output") for name in names
        ]
        self.view = FaceView.of(session.actor, titles, limits=(0, 2), label=self.measures.label, shape=shape, pane=(220, 250))
        self._eyes, self.note = GazeEstimator(session.actor), widgets.HTML()
        self.player = Player(len(self.frames), self.show)
        row = widgets.Layout(flex_flow="row wrap", align_items="flex-start")
        self.note.layout.max_width = "420px"
        self.widget = widgets.VBox(
            [widgets.HBox([widgets.VBox([self.view.widget, self.player.widget]), self.note], layout=row)]
        )
        self.player.go_to(start) if start else self.show(0)

    def show(self, index: int) -> None:
        """Draw frame ``index`` as every variant tracked it."""
        rows = []
        for pane, (variant, run, title) in enumerate(zip(self.variants, self._runs, self._titles, strict=True)):
            heat = self.measures.error(run[index], self.frames[index], variant.stage)
            gaze = self._eyes.see(run[index], self.frames[index])
            gaze = None if gaze is None else np.nan_to_num(gaze)  # straight ahead if it is unknown
            self.view.show(pane, getattr(run[index], variant.stage), heat, gaze=gaze)
            name = title if title == variant.name else f"{title} ({variant.name})"
            mean = f"<td style='white-space:nowrap'>{np.nanmean(heat):.3f} mm</td>"
            rows.append(f"<tr><td style='padding-right:1em'>{name}</td>{mean}</tr>")
        self.view.refresh()
        self.note.value = f"<table>{''.join(rows)}</table>"

    def close(self) -> None:
        """Stop the player. The last picture stays."""
        self.player.close()
        self.view.close()
