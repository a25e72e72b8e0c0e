"""Figure 6: the deformation of the output, to 2D features only, and of the samples to learn from, to depth as well."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from ..geometry.mesh import adjacency
from .drawing import Faces, grid
from .performances import PARAMETER_SETS, Take, track

TOP = 1.5
FRAMES = 60


class Roughness:
    """Measures how much a displacement of the frontal vertices varies from vertex to vertex."""

    def __init__(self, take: Take) -> None:
        actor = take.actor
        inside = np.flatnonzero(actor.frontal)
        neighbours = adjacency(actor.triangles, len(actor.neutral)).astype(float).tocsr()[inside][:, inside]
        self._inside, self._neighbours = inside, neighbours
        self._count = np.maximum(np.asarray(neighbours.sum(axis=1)), 1.0)

    def __call__(self, displacement: np.ndarray) -> float:
        """Root mean square over the vertices of a displacement (N, 3) minus its neighbours' mean, mm."""
        own = displacement[self._inside]
        return float(np.sqrt((((own - self._neighbours @ own / self._count) ** 2).sum(axis=1)).mean()))


def draw(seed: int, noise: str, frames: int | None) -> tuple[str, Figure, list[dict]]:
    """Caption, drawing and numbers of the figure."""
    take = Take.performed(seed, noise, frames or FRAMES, 1)
    faces, roughness = Faces(take.actor, TOP), Roughness(take)
    shown, rows, found = take.liveliest(1)[0], [], {}
    for name, result, _ in track(take):
        if not result.tracked:
            continue
        row = {"parameters": name, "frame": result.index}
        for label, displacement in (("output", result.v4 - result.v3), ("sample", result.v2 - result.v3)):
            length = np.linalg.norm(displacement[take.actor.frontal], axis=1)
            row |= {f"{label}_mean_mm": float(length.mean()), f"{label}_roughness_mm": roughness(displacement)}
        rows.append(row)
        if result.index == shown:
            found[name] = result
    pictures, titles = [], []
    for name in PARAMETER_SETS:
        result, own = found[name], [row for row in rows if row["parameters"] == name]
        pictures.append([faces.plain(result.v3)])
        titles.append(["v3: in the adaptive space"])
        for mesh, label, words in ((result.v4, "output", "v4, output"), (result.v2, "sample", "v2, to be learned")):
            values = np.where(take.actor.frontal, np.linalg.norm(mesh - result.v3, axis=1), np.nan)
            mean, rough = (np.mean([row[f"{label}_{what}_mm"] for row in own]) for what in ("mean", "roughness"))
            pictures[-1] += [faces.plain(mesh), faces.heat(mesh, values)]
            titles[-1] += [words, f"its distance from v3\nmean {mean:.2f}, roughness {rough:.3f}"]
    figure = grid(pictures, titles, list(PARAMETER_SETS), TOP, "distance from v3, mm")
    caption = (
        f"{take.sensor.name}, frame {shown}. v4 deforms v3 to the 2D features only, and v2 follows the depth map as well. "
        "Colour: the distance of each from v3. The numbers are the mean over the performance, and the roughness: by how much a "
        "vertex's displacement differs from its neighbours' mean (root mean square), mm."
    )
    return caption, figure, rows
