"""Figure 4: one frame on its way through the pipeline, stage by stage."""

from __future__ import annotations

import cv2
import numpy as np
from matplotlib.figure import Figure

from ..errors import TrackingError
from ..geometry.frame import RgbdFrame
from ..report.pictures import depth_picture, face_view, frontal_triangles, shaded_overlay
from ..synthetic.sensor import SyntheticSensor
from .drawing import SIZE, Faces, grid
from .performances import NEUTRAL_FRAMES, Take, track

TOP = 2.0
FRAMES = 60
#: What each stage adds: the later mesh and the earlier one.
STEPS = {"v2 - v1": ("v2", "v1"), "v3 - v1": ("v3", "v1"), "v2 - v3": ("v2", "v3"), "v4 - v3": ("v4", "v3")}
_WORDS = {
    "v2 - v1": "Laplacian deformation,\nv2 - v1",
    "v3 - v1": "in the adaptive space,\nv3 - v1",
    "v2 - v3": "out of it, to learn from,\nv2 - v3",
    "v4 - v3": "out of it, output,\nv4 - v3",
}


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers."""
    take = Take.of(SyntheticSensor(seed, noise, NEUTRAL_FRAMES, frames or FRAMES, 2))
    shown = take.liveliest(1)[0] + take.sensor.frames  # in the repeat
    faces, rows, found = Faces(take.actor, TOP), [], {}
    for name, result, _ in track(take):
        if not result.tracked:
            continue
        medians = {f"{stage}_mm": float(np.nanmedian(take.distance(result, stage))) for stage in ("v1", "v2", "v3", "v4")}
        means = {f"{a}_from_{b}_mm": float(np.nanmean(_change(take, result, step))) for step, (a, b) in STEPS.items()}
        rows.append({"parameters": name, "frame": result.index, **medians, **means})
        if result.index == shown:
            found[name] = result
    frame = take.sensor.read(shown)
    pictures: list[list[np.ndarray | None]] = []
    titles: list[list[str]] = []
    if not found:
        raise TrackingError(f"{take.sensor.name}: frame {shown} was lost; another seed, or more frames")
    for result in found.values():
        pictures += [
            [*_input(take, frame, result), *(faces.plain(getattr(result, stage)) for stage in ("v1", "v2", "v3", "v4"))],
            [
                None,
                None,
                None,
                *(faces.heat(getattr(result, later), _change(take, result, step)) for step, (later, _) in STEPS.items()),
            ],
        ]
        titles += [
            ["colour, 2D features", "depth", "rigid motion: neutral", "v1: blendshapes", "v2", "v3: adaptive space", "v4"],
            ["", "", "", *(_WORDS[step] for step in STEPS)],
        ]
    labels = [label for name in found for label in (name, "")]
    figure = grid(pictures, titles, labels, TOP, "what a step adds, mm")
    caption = (
        f"{take.sensor.name}, frame {shown}. Above: input, the neutral face where the rigid motion puts it, and the mesh after "
        "each stage. Below: how far one mesh lies from another, which is what the paper colours: what the adaptive space adds "
        "to the blendshape fit, and what is deformed out of it, to learn from and for the output."
    )
    return caption, figure, rows


def _change(take: Take, result, step: str) -> np.ndarray:
    """(N,) distance between the two meshes of a step, mm; NaN outside the frontal region."""
    later, earlier = (getattr(result, stage) for stage in STEPS[step])
    return np.where(take.actor.frontal, np.linalg.norm(later - earlier, axis=1), np.nan)


def _input(take: Take, frame: RgbdFrame, result) -> list[np.ndarray]:
    """Crops of colour with the features, depth, and the neutral face at the tracked pose; all of the same size."""
    mesh = result.in_camera(take.actor.neutral)
    view = face_view(frame.camera, mesh[None, take.actor.frontal], SIZE[0], SIZE[1] / SIZE[0])
    colour = view.crop(frame.colour, frame.depth)
    left, top, right, _ = view.window
    dots, scale = colour.copy(), view.camera.width / (right - left)
    for u, v in frame.seen.pixels[frame.seen.valid]:
        cv2.circle(dots, (round((u - left) * scale), round((v - top) * scale)), 2, (40, 230, 90), -1, cv2.LINE_AA)
    posed = shaded_overlay(colour, view, mesh, frontal_triangles(take.actor))
    return [dots, view.crop(depth_picture(frame.depth), frame.depth), posed]
