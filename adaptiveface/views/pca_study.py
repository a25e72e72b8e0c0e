"""For notebook 06: the corrective shapes as heads, and the angle between the incremental and the batch PCA."""

from __future__ import annotations

import asyncio

import numpy as np
from scipy.linalg import subspace_angles

from ..tracking.adaptive_pca import AdaptiveModel
from ..tracking.types import SampleState
from .charts import LiveChart
from .face_view import FaceView
from .kernel import BackgroundTask, running_loop
from .replay import Replay
from .session import Session


class CorrectiveView:
    """The first ``count`` corrective shapes, each added to the neutral so that it moves up to ``reach`` mm.

    ``widget`` is what to display; :meth:`update` takes an :class:`AdaptiveModel`.
    """

    def __init__(self, session: Session, count: int = 4, reach: float = 4.0) -> None:
        self.actor, self.reach = session.actor, reach
        titles = [f"corrective {k + 1}" for k in range(count)]
        self.view = FaceView.of(
            session.actor, titles, limits=(0, reach), label=f"displacement (largest: {reach:g} mm), mm", pane=(200, 230)
        )
        self.widget, self._last, self._wanted = self.view.widget, None, None
        self._task = BackgroundTask()

    def update(self, model: AdaptiveModel) -> None:
        """Show a model's correctives, soon and at most 2.5 times a second: playback must not wait for these pictures."""
        self._wanted = model
        if running_loop() is None:
            self._draw(model)
        elif model.correctives is not self._last and not self._task.running:
            self._task.start(self._follow())

    async def _follow(self) -> None:
        while self._wanted.correctives is not self._last:
            self._draw(self._wanted)
            await asyncio.sleep(0.4)

    def _draw(self, model: AdaptiveModel) -> None:
        self._last = model.correctives
        for k in range(len(self.view.titles)):
            heat = np.full(len(self.actor.neutral), np.nan)
            vertices = self.actor.neutral.copy()
            if k < model.correctives.shape[1]:
                shape = model.correctives[:, k].reshape(-1, 3)
                shape = shape * (self.reach / np.linalg.norm(shape, axis=1).max())
                vertices[self.actor.frontal] += shape
                heat[self.actor.frontal] = np.linalg.norm(shape, axis=1)
            self.view.show(k, vertices, heat)
        self.view.refresh()

    def close(self) -> None:
        """Stop following and free the renderer; the last picture stays."""
        self._task.stop()
        self.view.close()


def learned_samples(replay: Replay, last: int) -> np.ndarray:
    """(s, 3n) samples learned up to frame ``last``: v2 - v1 without its part in the anchor space."""
    anchors, frontal = replay.tracker.model.anchors, replay.actor.frontal
    used = [r for r in replay.results[: last + 1] if r is not None and r.sample_state == SampleState.LEARNED]
    samples = np.array([(r.v2 - r.v1)[frontal].ravel() for r in used[-replay.parameters.adaptive_pca.S :]]).reshape(
        -1, len(anchors)
    )
    return samples - (samples @ anchors) @ anchors.T


def angle_to_batch(model: AdaptiveModel, samples: np.ndarray) -> float:
    """Mean principal angle, degrees, between the k correctives and the k leading directions of a batch PCA.

    Batch: a singular value decomposition of all ``samples`` (s, 3n) at once, through the origin as in section 5.
    """
    k = model.correctives.shape[1]
    if k == 0 or len(samples) <= k:
        return float("nan")
    _, _, directions = np.linalg.svd(samples, full_matrices=False)
    return float(np.degrees(subspace_angles(model.correctives, directions[:k].T).mean()))


def angle_chart(session: Session, every: int = 10):
    """The chart "angle to batch PCA" and its source, for a workbench."""
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
        """The curve up to where the replay is."""
        values = np.full(len(replay.frames), np.nan)
        for index in range(every - 1, replay.done, every):
            result = replay.results[index]
            if index not in known or known[index][0] is not result:
                known[index] = (result, angle_to_batch(replay.model_after(index), learned_samples(replay, index)))
            values[index] = known[index][1]
        seen = np.flatnonzero(np.isfinite(values))
        return {"angle": (seen, values[seen])}

    return chart, source
