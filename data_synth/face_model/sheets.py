"""Contact sheets to look at: identities, modes, units, generic expressions, close-ups, features, masks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pyvista as pv

from adaptiveface.geometry.mesh import surface_points
from adaptiveface.model.face_model import FaceModel

SKIN, EYE, INK = (0.84, 0.66, 0.56), (0.95, 0.95, 0.95), "#775544"
DISTANCE_MM = 800.0
FACE, MOUTH, LEFT_EYE = ((0, -8, 0), 95), ((0, -45, 15), 28), ((33, 27, 5), 26)  # centre, half height shown, mm


def write_sheets(model: FaceModel, folder: Path) -> None:
    """Write one PNG per subject into ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    pv.OFF_SCREEN = True
    zero = np.zeros_like(model.mean)
    rng = np.random.default_rng(5)
    heads = [("", model.neutral(c) - model.mean, model.eyes(c)) for c in rng.normal(size=(16, len(model.identity_modes)))]
    _sheet(model, heads, folder / "identities.png", 8, views=((0, 0), (45, 5)), centre=(0, 8, -40), half=125)
    modes = []
    for k, sigma in ((k, s) for k in range(8) for s in (-2, 2)):
        c = sigma * np.eye(k + 1)[k]
        modes.append((f"mode {k + 1}: {sigma:+d} sigma", model.neutral(c) - model.mean, model.eyes(c)))
    _sheet(model, modes, folder / "modes.png", 8, views=((0, 0), (60, 0)), centre=(0, 8, -40), half=125)
    units = [(n, e, None) for n, e in zip(model.expression_names, model.expressions, strict=True)]
    _sheet(model, units, folder / "units.png", 9, size=300)
    generic = [("neutral", zero, None)]
    generic += [(n, e, None) for n, e in zip(model.generic_names, model.generic_expressions, strict=True)]
    _sheet(model, generic, folder / "generic.png", 6)
    by_name = dict(zip(model.expression_names, model.expressions, strict=True))
    close = [("neutral", zero, None)] + [
        (n, by_name[n], None)
        for n in (
            "mouthRollUpper",
            "mouthRollLower",
            "mouthShrugLower",
            "mouthShrugUpper",
            "mouthPucker",
            "mouthFunnel",
            "mouthSmileLeft",
        )
    ]
    close += [("roll", by_name["mouthRollUpper"] + by_name["mouthRollLower"], None)]
    close += [("jawOpen + mouthClose", by_name["jawOpen"] + by_name["mouthClose"], None)]
    _sheet(model, close, folder / "mouth.png", 5, size=420, centre=MOUTH[0], half=MOUTH[1])
    eyes = [(f"eyeBlinkLeft {t}", t * by_name["eyeBlinkLeft"], None) for t in (0, 0.25, 0.5, 0.75, 1)]
    eyes += [
        (n, by_name[n], None) for n in ("cheekSquintLeft", "eyeSquintLeft", "eyeWideLeft", "browDownLeft", "browOuterUpLeft")
    ]
    _sheet(model, eyes, folder / "eye.png", 5, size=420, centre=LEFT_EYE[0], half=LEFT_EYE[1])
    _feature_sheet(model, folder / "features.png")
    _mask_sheet(model, folder / "masks.png")


def _poly(vertices, triangles) -> pv.PolyData:
    return pv.PolyData(np.asarray(vertices, float), np.insert(triangles, 0, 3, axis=1).ravel())


def _aim(plotter, centre, half, yaw=0.0, pitch=0.0) -> None:
    a, b = np.radians([yaw, pitch])
    direction = np.array([np.sin(a) * np.cos(b), np.sin(b), np.cos(a) * np.cos(b)])
    centre = np.asarray(centre, float)
    plotter.camera_position = [centre + DISTANCE_MM * direction, centre, (0, 1, 0)]
    plotter.camera.parallel_projection = True
    plotter.camera.parallel_scale = half
    plotter.set_background("white")


def _sheet(model, items, path: Path, columns, size=330, views=((0, 0),), centre=FACE[0], half=FACE[1]) -> None:
    """``items``: (label, displacement (V, 3), eyeballs (Q, 3) or None for the mean's)."""
    cells = [(item, view) for item in items for view in views]
    rows = -(-len(cells) // columns)
    plotter = pv.Plotter(off_screen=True, shape=(rows, columns), window_size=(size * columns, size * rows), border=False)
    shine = {"smooth_shading": True, "ambient": 0.18, "diffuse": 0.85, "specular": 0.12, "specular_power": 12}
    for number, ((label, displacement, eyes), (yaw, pitch)) in enumerate(cells):
        plotter.subplot(number // columns, number % columns)
        plotter.add_mesh(_poly(model.mean + displacement, model.triangles), color=SKIN, **shine)
        plotter.add_mesh(_poly(model.eye_mean if eyes is None else eyes, model.eye_triangles), color=EYE, **shine)
        plotter.add_text(label, font_size=9, color="black", position="upper_left")
        _aim(plotter, centre, half, yaw, pitch)
    plotter.screenshot(path)
    plotter.close()


def _feature_sheet(model, path: Path) -> None:
    plotter = pv.Plotter(off_screen=True, shape=(1, 2), window_size=(2000, 1000), border=False)
    points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    for column, (centre, half, shown) in enumerate((((0, 38, 10), 58, slice(0, 20)), ((*MOUTH[0],), 30, slice(20, 40)))):
        plotter.subplot(0, column)
        plotter.add_mesh(_poly(model.mean, model.triangles), color=SKIN, show_edges=True, edge_color=INK, line_width=0.6)
        plotter.add_mesh(_poly(model.eye_mean, model.eye_triangles), color=EYE)
        for number, point in zip(model.feature_ids[shown], points[shown], strict=True):
            plotter.add_mesh(pv.Sphere(radius=half / 100, center=point), color="red")
            plotter.add_point_labels(
                [point + [0, 0, 6]],
                [str(number)],
                font_size=16,
                text_color="black",
                shape_opacity=0.4,
                show_points=False,
                always_visible=True,
            )
        _aim(plotter, centre, half)
    plotter.screenshot(path)
    plotter.close()


def _mask_sheet(model, path: Path) -> None:
    """Grey: fixed back of the head; skin: takes depth; red: frontal without depth."""
    colour = np.full((len(model.mean), 3), (205, 205, 215), np.uint8)
    colour[model.frontal] = (200, 40, 30)
    colour[model.depth_valid] = (240, 190, 155)
    plotter = pv.Plotter(off_screen=True, shape=(1, 4), window_size=(2800, 800), border=False)
    views = [(0, 0, FACE, 0), (60, 0, ((0, -8, -20), 110), 0), (0, -30, MOUTH, 0), (0, -5, ((0, -55, 15), 45), 0.5)]
    jaw = model.expressions[model.expression_names.index("jawOpen")]
    for column, (yaw, pitch, (centre, half), opening) in enumerate(views):
        plotter.subplot(0, column)
        skin = _poly(model.mean + opening * jaw, model.triangles)
        skin["colour"] = colour
        plotter.add_mesh(skin, scalars="colour", rgb=True, show_edges=True, edge_color="#555555", line_width=0.5)
        plotter.add_mesh(_poly(model.eye_mean, model.eye_triangles), color=EYE)
        _aim(plotter, centre, half, yaw, pitch)
    plotter.screenshot(path)
    plotter.close()
