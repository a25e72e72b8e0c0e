"""Figure 3: from a neutral scan to the personal head, and from the generic expressions to its blendshapes."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..evaluation.metrics import neutral_alignment, surface_distance
from ..geometry.mesh import transform_points
from ..model.actor import Actor
from ..model.face_model import FaceModel, embedded_face_model
from ..neutral.capture import NeutralCapture, capture_neutral
from ..synthetic.sensor import SyntheticSensor
from .drawing import SIZE, Faces, grid, scan_picture
from .performances import NEUTRAL_FRAMES

TOP = 1.5
SHOWN = ("jawOpen", "mouthSmileLeft", "mouthPucker", "browInnerUp", "eyeBlinkLeft")


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers of the figure. ``frames`` is the number of scanned neutral frames."""
    sensor = SyntheticSensor(seed, noise, frames or NEUTRAL_FRAMES, 1, 1, colour=False)
    model = embedded_face_model()
    capture = capture_neutral([sensor.read(index) for index in range(sensor.neutral_frames)], model)
    actor, true = capture.actor, sensor.performer.neutral
    faces = Faces(actor, TOP)
    heads = {"average head": model.mean, "identity modes": capture.fit.vertices, "shrink-wrapped": capture.wrap.vertices}
    errors = {name: from_truth(head, true, actor) for name, head in heads.items()}
    pictures = [[scan_picture(actor, capture.scan.points, capture.scan.normals, SIZE), faces.plain(true)]]
    titles = [[f"scan of {len(capture.scan.frames)} frames", "the true face"]]
    for name, head in heads.items():
        pictures[0].insert(-1, faces.heat(head, errors[name]))
        titles[0].insert(-1, f"{name}\n{np.nanmedian(errors[name]):.2f} mm")
    for head, shapes in ((model.mean, model.generic_expressions), (actor.neutral, actor.blendshapes)):
        chosen = [shapes[list(actor.expression_names).index(name)] for name in SHOWN]
        pictures.append([faces.plain(head + shape) for shape in chosen])
        titles.append(list(SHOWN))
    figure = grid(pictures, titles, ["neutral face", "generic", "personal"], TOP, "distance to the true face, mm")
    caption = (
        f"{sensor.name}. Top: depth frames of the neutral face become a scan; the average head is fitted to it by the modes of "
        "identity, and shrink-wrapped onto it. Colour and number: distance of the face from the true one (the number is the "
        "median). Below: generic expressions of the average head, and the same expressions transferred to the person."
    )
    return caption, figure, _rows(errors, capture, model)


def from_truth(head: np.ndarray, true: np.ndarray, actor: Actor) -> np.ndarray:
    """Distances (N,) of a neutral head (N, 3) from the true one after rigid alignment, mm; NaN where depth is not used."""
    scored = actor.frontal & actor.depth_valid
    out = np.full(len(head), np.nan)
    out[scored] = surface_distance(transform_points(neutral_alignment(head, true, scored), head), true, actor.triangles, scored)
    return out


def _rows(errors: dict[str, np.ndarray], capture: NeutralCapture, model: FaceModel) -> list[dict]:
    """Draw neutral heads, coloured by their distance from the truth, and expressions, coloured by their displacement, mm."""
    rows = [_row("neutral", name, error) for name, error in errors.items()]
    changes = np.linalg.norm(capture.actor.blendshapes - model.generic_expressions, axis=2)[:, capture.actor.frontal]
    names = capture.actor.expression_names
    return rows + [_row("expression", str(name), change) for name, change in zip(names, changes, strict=True)]


def _row(kind: str, name: str, values: np.ndarray) -> dict:
    median, p95 = np.nanpercentile(values, [50, 95])
    return {"kind": kind, "name": name, "median_mm": float(median), "p95_mm": float(p95)}
