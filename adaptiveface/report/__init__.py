"""Write the report of a run: one ``report.html`` with pictures, an animation, learning, errors and timings.

The page needs no network, display or script, because everything is inline. It follows the reader's light or dark theme.
"""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import AdaptiveFaceError
from ..evaluation import ErrorCollector, Evaluation, GroundTruth
from ..files import replacing
from ..parameters import Parameters
from ..result import Result
from ..retargeting.loading import load_character
from ..runtime.timing import clean_times
from ..sensors.orientation import as_tracked
from . import page, retargeting, scenes, sections
from .context import Context

if TYPE_CHECKING:
    from markupsafe import Markup

#: Largest number of frames, spread over the run, that are scored for the report if no evaluation is given.
MAX_SCORED = 120


def write_report(
    result,
    source,
    actor,
    out_dir: str | os.PathLike,
    truth=None,
    *,
    evaluation: Evaluation | None = None,
    correctives: np.ndarray | None = None,
    parameters: Parameters | None = None,
    known=None,
    still_frames: int = 0,
    character: str = "hag",
) -> Path:
    """Write the report of a run as one HTML page.

    Parameters
    ----------
    result : Result or iterable of TrackedFrame
        The tracked frames, one for every frame of the source.
    source
        The source of the frames, with ``read(index)`` and ``name``. None for a report without pictures of the input.
    actor : Actor
        The rig.
    out_dir : path-like
        The folder in which ``report.html`` is written.
    truth : optional
        A sensor with ``ground_truth(index)``, or the path of a ``ground_truth.npz``.
    evaluation : Evaluation, optional
        Errors that are already scored. By default, up to ``MAX_SCORED`` frames are scored here.
    correctives : (K, N, 3) or (3n, K), optional
        The corrective shapes at the end of the run, mm, over all vertices or over the frontal ones.
    parameters : Parameters, optional
        The parameters of the run, if ``result`` is an iterable of frames.
    known : KnownCoefficients, optional
        True coefficients (:mod:`adaptiveface.evaluation.coefficients`).
    still_frames : int
        Number of leading frames that show the neutral face, from which the jitter is measured.
    character : str
        The character that the section on retargeting shows.

    Returns
    -------
    pathlib.Path
        Path of ``report.html``.

    Raises
    ------
    AdaptiveFaceError
        The run is empty. If the truth cannot be read, the error is a :class:`~adaptiveface.errors.FileFormatError`.
    """
    context = _context(result, source, actor, truth, evaluation, parameters)
    note = ""
    if evaluation is None and context.truth is not None and context.result.tracked.any():
        step = -(-len(context.result) // MAX_SCORED)
        context = replace(context, evaluation=score(context, step))
        note = f"Scored here: every {_ordinal(step)} frame." if step > 1 else ""
    name = "a performance" if source is None else source.name
    about_retargeting = retargeting.section(context, load_character(character), known, still_frames)
    body = _body(context, name, note, about_retargeting, _whole_mesh(correctives, actor))
    path = Path(out_dir) / "report.html"
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path) as unfinished:
        unfinished.write_text(page.page(f"{name}: tracked performance", body), encoding="utf-8", errors="backslashreplace")
    return path


def _body(
    context: Context, name: str, note: str, about_retargeting: Markup | str, correctives: np.ndarray | None
) -> list[Markup | str]:
    """Write the sections in order."""
    return [
        sections.heading(name, context.result.colour_only),
        sections.doubt(context),
        scenes.preview(context),
        sections.tiles(context),
        sections.losses(context),
        sections.fit(context),
        scenes.tracked_frames(context),
        scenes.rig(context),
        sections.coefficients(context),
        about_retargeting,
        sections.learning(context, correctives),
        sections.errors(context, note),
        sections.timings(context),
        sections.parameters(context),
        sections.footer(),
    ]


def _context(result, source, actor, truth, evaluation: Evaluation | None, parameters: Parameters | None) -> Context:
    """Collect what the sections share: a result with an even clock, its source as the tracker saw it, and the truth."""
    if not isinstance(result, Result):
        result = Result.of_frames(result, actor, parameters, keep_stages=True)
    if not len(result):
        raise AdaptiveFaceError("the run holds no frame, so there is nothing to report")
    return Context(
        replace(result, timestamps=clean_times(result.timestamps).seconds),
        parameters or Parameters.from_json(result.parameters),
        as_tracked(source, result),
        result.rig(actor),
        None if truth is None else GroundTruth.of(truth),
        evaluation,
    )


def score(context: Context, step: int = 1) -> Evaluation:
    """Score the errors of v1 and v4 at every ``step``-th frame. ``context`` must have a truth."""
    result = context.result
    assert context.truth is not None  # the caller ensures it
    collector = ErrorCollector(context.truth, context.actor, ("v1", "v4"))
    for k in range(0, len(result), step):
        if result.tracked[k]:
            meshes = {"v1": context.initial_vertices(k), "v4": result.vertices[k].astype(float)}
            collector.score(k, result.head_pose[k], meshes, result.anchor_distance[k], result.adaptive_distance[k])
        else:
            collector.lose(k)
    return collector.finish()


def _whole_mesh(correctives: np.ndarray | None, actor) -> np.ndarray | None:
    """Return correctives (K, N, 3), from that shape or from the tracker's (3n, K) columns over the n frontal vertices."""
    if correctives is None or correctives.ndim == 3:
        return correctives
    out = np.zeros((correctives.shape[1], len(actor.neutral), 3))
    out[:, actor.frontal] = correctives.T.reshape(len(out), int(actor.frontal.sum()), 3)
    return out


def _ordinal(number: int) -> str:
    return {2: "second", 3: "third"}.get(number, f"{number}th")


__all__ = ["MAX_SCORED", "write_report"]
