"""Write the sections of the report that show the face: animated preview, tracked frames, personal rig."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np

from ..evaluation import motion_error, neutral_alignment
from ..geometry.frame import RgbdFrame
from ..geometry.rendering import heat_map
from . import page, pictures
from .context import Context
from .moments import expressive_frames, liveliest_window

if TYPE_CHECKING:
    from markupsafe import Markup

#: Upper end of the heat maps on the final mesh, mm. They show its difference from the initial fit, and the error of motion.
HEAT_LIMIT = 4.0


def preview(context: Context, length: int = 75, step: int = 2, width: int = 300) -> Markup | str:
    """Draw an endless animation of the liveliest part: the input, the tracked mesh over it, and the mesh from the side."""
    result, actor = context.result, context.actor
    read = context.frames(k for k in liveliest_window(result, length)[::step] if result.tracked[k])
    if len(read) < 2:
        return ""
    meshes = result.vertices[[k for k, _ in read]][:, actor.frontal]
    view = pictures.face_view(read[0][1].camera, meshes, width)
    triangles = pictures.frontal_triangles(actor)
    portraits = pictures.Portraits(actor, (width, view.camera.height), whole=True)
    panels = []
    for k, frame in read:
        crop, vertices = view.crop(frame.colour, frame.depth), result.vertices[k].astype(float)
        side = portraits.draw(result[k].head_vertices, turn=40)
        over = pictures.shaded_overlay(crop, view, vertices, triangles)
        panels.append(np.hstack([crop, over, pictures.on_backdrop(side)]))
    seconds = result.timestamps[read[-1][0]] - result.timestamps[read[0][0]]
    milliseconds = int(np.clip(1000 * seconds / (len(read) - 1), 33, 200))
    text = "input, tracked mesh over it, and the mesh from the side, animated"
    return page.html().preview(page.image(page.animation_uri(panels, milliseconds), text))


def legend(low: str, high: str, text: str) -> Markup:
    """Draw the colour scale of the heat maps, with words at its ends."""
    ramp = np.repeat(heat_map(np.linspace(0, 1, 180))[None].astype(np.uint8), 12, axis=0)
    return page.html().legend(low, high, text, page.image(ramp, "colour scale"))


def tracked_frames(context: Context, count: int = 5, width: int = 250) -> Markup | str:
    """Draw input, mesh over the input, and heat maps of expressive frames that differ from each other, in one row each."""
    read = context.frames(expressive_frames(context.result, count, spacing=10))
    if not read:
        return ""
    scale = legend("0 mm", f"{HEAT_LIMIT:g} mm and more", "heat maps")
    rows = [_row(context, k, frame, width) for k, frame in read]
    return page.html().tracked_frames(scale, rows, context.truth is not None)


def _row(context: Context, k: int, frame: RgbdFrame, width: int) -> Markup:
    result, actor = context.result, context.actor
    final, triangles = result.vertices[k].astype(float), pictures.frontal_triangles(actor)
    view = pictures.face_view(frame.camera, final[actor.frontal][None], width)
    crop = view.crop(frame.colour, frame.depth)

    def heat(values: np.ndarray) -> np.ndarray:
        return pictures.heat_overlay(crop, view, final, triangles, values, (0, HEAT_LIMIT))

    panels = [
        (crop, f"frame {k}, {result.timestamps[k]:.2f} s"),
        (pictures.wire_overlay(crop, view, final, triangles), "final mesh"),
        (heat(np.linalg.norm(final - context.initial_vertices(k), axis=1)), "added to the blendshape fit"),
    ]
    if context.truth is not None:
        panels.append((heat(_motion_error(context, k, final)), "error of motion"))
    return page.html().figures("row", [page.figure(pixels, caption) for pixels, caption in panels])


def _motion_error(context: Context, k: int, final: np.ndarray) -> np.ndarray:
    actor, truth = context.actor, context.truth
    assert truth is not None  # the caller ensures it
    frame = truth[k]
    alignment = neutral_alignment(actor.neutral, truth.neutral, actor.frontal)
    error = motion_error(final, actor.neutral, frame.vertices, truth.neutral, frame.head_pose, alignment)
    return np.linalg.norm(error, axis=1)


def rig(context: Context) -> Markup:
    """Draw the personal neutral from three sides, and every personal blendshape."""
    actor = context.actor
    large, small = pictures.Portraits(actor, (230, 260), whole=True), pictures.Portraits(actor, (96, 124))
    turns = ((45, "from the right"), (0, "neutral"), (-45, "from the left"))
    views = [page.figure(large.draw(actor.neutral, turn=turn), name, 230) for turn, name in turns]
    shapes = [
        page.figure(small.draw(actor.neutral + shape), breakable(name), 96, alt=name)
        for name, shape in zip(actor.expression_names, actor.blendshapes, strict=True)
    ]
    return page.html().rig(len(actor.blendshapes), views, shapes)


def breakable(name: str) -> str:
    """Put zero-width spaces between the words of ``mouthSmileLeft``, so that narrow captions break there."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "\u200b", name)
