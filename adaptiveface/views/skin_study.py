"""Show for notebook 05 dense skin on one frame: what the colours change, and what each sample knows."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.figure import Figure

from ..geometry.mesh import vertex_normals
from ..studies.measures import Measures
from ..studies.session import Session
from ..studies.skin import PATCH, SkinFrame, around
from .figures import inked, picture

#: Longest axis of an ellipse, px. Along an edge, nothing is known.
_LONGEST = 5.0


@inked()
def on_and_off(session: Session, measures: Measures, shown: SkinFrame):
    """Draw how the colours move v2 within the surface, ten times as long, and the errors without and with them.

    Parameters
    ----------
    session : Session
        The performance.
    measures : Measures
        Of the session.
    shown : SkinFrame
        The frame (:func:`~adaptiveface.studies.skin.track_skin`).

    Returns
    -------
    IPython.display.Image
        A PNG, which saved notebooks keep.
    """
    actor, camera = session.actor, shown.frame.camera
    front = np.flatnonzero(actor.frontal & actor.depth_valid)[::7]
    start, end = (tracked.in_camera(tracked.v2)[front] for tracked in (shown.without, shown.coloured))
    normals = vertex_normals(shown.coloured.in_camera(shown.coloured.v2), actor.triangles)[front]
    motion = end - start
    motion -= (motion * normals).sum(axis=1, keepdims=True) * normals
    start = camera.project(end)
    motion = 10.0 * (camera.project(end + motion) - start)
    figure = Figure(figsize=(8.4, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    _face(left, shown, "moved by the colours, 10 times as long")
    left.quiver(*start.T, *motion.T, color="#ffd400", angles="xy", scale_units="xy", scale=1, width=0.004)
    for name, tracked, colour in (("without colours", shown.without, "#1f77b4"), ("with colours", shown.coloured, "#ff7f0e")):
        error = np.sort(measures.error(tracked, shown.frame, "v2")[actor.frontal & actor.depth_valid])
        right.plot(error, np.linspace(0, 100, len(error)), label=f"{name}: mean {np.nanmean(error):.2f} mm", color=colour)
    right.set(xlabel="error of v2, mm", ylabel="% of the frontal vertices below", xlim=(0, 3), ylim=(0, 100))
    right.legend(loc="lower right")
    return picture(
        figure, "Arrows on the face show how colours move the mesh; a chart compares the errors without and with them."
    )


@inked()
def ellipses(shown: SkinFrame, apart: int = 12):
    """Draw as ellipses what the samples know. Alone, most know one direction; with their neighbours, most know both.

    Parameters
    ----------
    shown : SkinFrame
        The frame (:func:`~adaptiveface.studies.skin.track_skin`).
    apart : int
        Every so many-th sample of the whole face is drawn.

    Returns
    -------
    IPython.display.Image
        A PNG, which saved notebooks keep.
    """
    figure = Figure(figsize=(8.4, 4.6), layout="constrained")
    whole, close = figure.subplots(1, 2)
    pixels, information = shown.pixels(), shown.information()
    patches = around(pixels, information)
    _face(whole, shown, f"samples within {PATCH:g} px together")
    _draw(whole, pixels[::apart], patches[::apart])
    _face(close, shown, "the mouth: alone (lines) and together")
    u, v = np.nanmean(shown.frame.seen.pixels[20:], axis=0)
    near = np.flatnonzero((np.abs(pixels - [u, v]) < [38, 34]).all(axis=1))
    _draw(close, pixels[near[::3]], patches[near[::3]])
    values, vectors = np.linalg.eigh(information[near])
    known = values[:, 1] > np.percentile(values[:, 1], 50)
    along = 1.5 * vectors[known][:, :, 0]  # the direction that the sample does not know
    ends = np.stack([pixels[near[known]] - along, pixels[near[known]] + along], axis=1)
    close.add_collection(LineCollection(list(ends), colors="#ff5ad0", linewidths=0.9))
    close.set(xlim=(u - 38, u + 38), ylim=(v + 34, v - 34))
    return picture(figure, "Ellipses on the face: small on brows and lips, long along edges, large on plain skin.")


def _face(axes, shown: SkinFrame, title: str) -> None:
    pixels = shown.pixels()
    (left, top), (right, bottom) = pixels.min(axis=0) - 8, pixels.max(axis=0) + 8
    axes.imshow(shown.frame.colour)
    axes.set(xlim=(left, right), ylim=(bottom, top), title=title)
    axes.set_axis_off()


def _draw(axes, pixels: np.ndarray, information: np.ndarray) -> None:
    """Draw an ellipse for each sample. Its axes follow the eigenvectors and have the length of the deviation that remains."""
    values, vectors = np.linalg.eigh(information)
    lengths = np.minimum(1.0 / np.sqrt(np.maximum(values, 1e-9)), _LONGEST)
    angles = np.degrees(np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0]))
    known = lengths[:, 1] < _LONGEST
    colours = np.where(lengths[known, 0] < _LONGEST, "#00e5ff", "#ff5ad0")
    axes.add_collection(
        EllipseCollection(
            lengths[known, 0],
            lengths[known, 1],
            angles[known],
            units="xy",
            offsets=pixels[known],
            offset_transform=axes.transData,
            facecolors="none",
            edgecolors=list(colours),
            linewidths=0.7,
        )
    )
