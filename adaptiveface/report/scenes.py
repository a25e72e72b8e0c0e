"""The sections of the report that show the face: animated preview, tracked frames, the personal rig."""

from __future__ import annotations

import re

import numpy as np

from ..evaluation import motion_error, neutral_alignment
from ..geometry.frame import RgbdFrame
from ..geometry.rendering import heat_map
from . import page, pictures
from .context import Context
from .moments import expressive_frames, liveliest_window

#: Upper end of the heat maps: difference of the final mesh from the initial blendshape fit, error of its motion; mm.
HEAT_LIMIT = 4.0


def preview(context: Context, length: int = 75, step: int = 2, width: int = 300) -> str:
    """An endless animation of the liveliest stretch: the input, the tracked mesh over it, the mesh from the side."""
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
    return f'<div class="hero">{page.image(page.animation_uri(panels, milliseconds), text)}</div>'


def legend(low: str, high: str, text: str) -> str:
    """The colours of the heat maps, with their ends in words."""
    ramp = np.repeat(heat_map(np.linspace(0, 1, 180))[None].astype(np.uint8), 12, axis=0)
    return f'<div class="legend">{text}: {low} {page.image(ramp, "colour scale")} {high}</div>'


def tracked_frames(context: Context, count: int = 5, width: int = 250) -> str:
    """Rows of input, mesh over the input, and heat maps, at frames that show much and differ."""
    read = context.frames(expressive_frames(context.result, count, spacing=10))
    if not read:
        return ""
    rows = "".join(_row(context, k, frame, width) for k, frame in read)
    truth = "; the last column the error of each vertex's motion, the neutral's own error removed"
    truth = truth if context.truth is not None else ""
    return (
        "<h2>The tracked face</h2><p>Frames that show much and differ from each other. The second column is the final "
        "mesh over the input, the third what the Laplacian deformation, the adaptive model and the final deformation "
        f"add to the initial blendshape fit (sections 4.3 and 4.4){truth}.</p>"
        f'{legend("0 mm", f"{HEAT_LIMIT:g} mm and more", "heat maps")}<div class="rows">{rows}</div>'
    )


def _row(context: Context, k: int, frame: RgbdFrame, width: int) -> str:
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
    cells = "".join(page.figure(page.image(pixels, caption), caption) for pixels, caption in panels)
    return f'<div class="row">{cells}</div>'


def _motion_error(context: Context, k: int, final: np.ndarray) -> np.ndarray:
    actor, truth = context.actor, context.truth
    assert truth is not None  # asked for by the caller
    frame = truth[k]
    alignment = neutral_alignment(actor.neutral, truth.neutral, actor.frontal)
    error = motion_error(final, actor.neutral, frame.vertices, truth.neutral, frame.head_pose, alignment)
    return np.linalg.norm(error, axis=1)


def rig(context: Context) -> str:
    """The personal neutral from three sides, and every personal blendshape."""
    actor = context.actor
    large, small = pictures.Portraits(actor, (230, 260), whole=True), pictures.Portraits(actor, (96, 124))
    views = "".join(
        page.figure(page.image(large.draw(actor.neutral, turn=turn), name, 230), name)
        for turn, name in ((45, "from the right"), (0, "neutral"), (-45, "from the left"))
    )
    strip = "".join(
        page.figure(page.image(small.draw(actor.neutral + shape), name, 96), breakable(name))
        for name, shape in zip(actor.expression_names, actor.blendshapes, strict=True)
    )
    return (
        f"<h2>The personal rig</h2><p>The neutral face fitted to this person, and the {len(actor.blendshapes)} "
        "blendshapes transferred to it, at full strength (section 3).</p>"
        f'<div class="pair">{views}</div><div class="strip">{strip}</div>'
    )


def breakable(name: str) -> str:
    """``mouthSmileLeft`` -> ``mouth Smile Left`` with zero-width spaces, so that narrow captions break at the words."""
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "\u200b", name)
