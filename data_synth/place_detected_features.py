"""Where the model's 40 features lie on MediaPipe's face mesh: makes adaptiveface/assets/mediapipe_features.npz.

    python data_synth/place_detected_features.py                     # 14 development performers, about ten minutes
    python data_synth/place_detected_features.py --cache /tmp/places  # keeps what was found in the pictures

MediaPipe's landmarks and the model's features of the same name lie up to 2 mm apart, alike on every performer. Each
feature becomes an affine combination of its landmark and the landmarks next to it: least squares against the exact
pixels over neutral and expressive frames, the same for both sides of the face, with a ridge towards the landmark alone.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from mediapipe.tasks.python import vision
from observe import gather
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from adaptiveface.geometry.frame import FEATURE_IDS, MEDIAPIPE_INDICES
from adaptiveface.synthetic.sensor import SyntheticSensor

#: Tuned on performers 2000 and 2012 only; results are reported on 1000 and above, which are none of these.
SEEDS = (*range(2003, 2012), *range(2015, 2020))
OUT = Path(__file__).parents[1] / "adaptiveface" / "assets" / "mediapipe_features.npz"
#: Ridge on the neighbours' shares, in squared hundredths of the distance between the outer eye corners.
RIDGE = 0.3
#: MediaPipe's points on the skin; the irises follow them.
SKIN, OUTER_EYE_CORNERS = 468, (33, 263)
#: Landmarks on the upper and lower lip that part when the mouth opens.
MOUTH = (13, 14)


def observe(seed: int, cache: Path | None) -> dict[str, np.ndarray]:
    """mesh (F, 478, 3) px, exact (F, 40, 2) px, NaN where hidden, neutral (F,) bool of every second frame of a performer."""
    kept = None if cache is None else cache / f"{seed}.npz"
    data = gather(
        lambda: SyntheticSensor(seed, "none", 40, 300, repeats=1, feature_noise=0.0),
        range(0, 340, 2),
        ("index", "mesh", "exact", "conf"),
        lambda frame, face: (frame.index, face.mesh, frame.features.pixels, frame.features.confidence),
        kept,
    )
    exact = np.where(data["conf"][..., None] > 0, data["exact"], np.nan)
    return dict(mesh=data["mesh"], exact=exact, neutral=data["index"] < 40)


def unit(mesh: np.ndarray) -> np.ndarray:
    """(F,) px: a hundredth of the distance between the outer eye corners."""
    left, right = OUTER_EYE_CORNERS
    return np.linalg.norm(mesh[:, left, :2] - mesh[:, right, :2], axis=1) / 100.0


def mirrored_features() -> np.ndarray:
    """(40,) the feature on the other side of the face."""
    pairs = [(18 + k, 25 - k) for k in range(8)]
    pairs += [(36, 45), (37, 44), (38, 43), (39, 42), (40, 47), (41, 46), (48, 54), (49, 53), (50, 52), (55, 59), (56, 58)]
    pairs += [(60, 64), (61, 63), (65, 67)]
    other = {a: b for a, b in pairs} | {b: a for a, b in pairs}
    order = FEATURE_IDS.tolist()
    return np.array([order.index(other.get(number, number)) for number in order])


def mirrored_landmarks(performers: list[dict]) -> np.ndarray:
    """(468,) the landmark on the other side, from the mean face with its mouth open: with closed lips two lie on each other."""
    faces = []
    for performer in performers:
        mesh = performer["mesh"][:, :SKIN] / unit(performer["mesh"])[:, None, None]
        opening = mesh[:, MOUTH[1], 1] - mesh[:, MOUTH[0], 1]
        across = mesh[:, OUTER_EYE_CORNERS[1], :2] - mesh[:, OUTER_EYE_CORNERS[0], :2]
        level = np.abs(across[:, 1]) < 10.0  # a rolled head is no mirror
        chosen = level & (opening > np.percentile(opening[level], 90))
        faces.append((mesh[chosen] - mesh[chosen].mean(axis=1, keepdims=True)).mean(axis=0))
    face = np.mean(faces, axis=0)
    pairs = linear_sum_assignment(cdist(face * [-1, 1, 1], face) ** 2)[1]
    if (pairs[pairs] != np.arange(SKIN)).any():
        raise RuntimeError("the landmarks do not pair up: more performers are needed")
    return pairs


def neighbours() -> dict[int, set[int]]:
    """The landmarks that share a triangle of MediaPipe's mesh with each landmark."""
    edges = vision.FaceLandmarksConnections.FACE_LANDMARKS_TESSELATION
    near: dict[int, set[int]] = {}
    for a, b in ((edge.start, edge.end) for edge in edges):
        near.setdefault(a, set()).add(b)
        near.setdefault(b, set()).add(a)
    return near


def place(feature: int, performers: list[dict], mirror: tuple[np.ndarray, np.ndarray], near: list[int]) -> np.ndarray:
    """(n,) shares of the landmarks ``near`` the feature's own one; its own share is one minus their sum."""
    features, landmarks = mirror
    home, h, b = MEDIAPIPE_INDICES[feature], RIDGE * np.eye(len(near)), np.zeros(len(near))
    for performer in performers:
        for f, start, ids in ((feature, home, near), (features[feature], landmarks[home], landmarks[near])):
            scale = unit(performer["mesh"])[:, None]
            from_home = performer["mesh"][..., :2] - performer["mesh"][:, [start], :2]
            x, y = from_home[:, ids] / scale[..., None], (performer["exact"][:, f] - performer["mesh"][:, start, :2]) / scale
            seen = np.isfinite(y[:, 0])
            neutral = performer["neutral"]
            weight = np.where(neutral, 0.5 / neutral.sum(), 0.5 / (~neutral).sum())[seen] / (2 * len(performers))
            h += np.einsum("t,tkc,tlc->kl", weight, x[seen], x[seen])
            b += np.einsum("t,tkc,tc->k", weight, x[seen], y[seen])
    return np.linalg.solve(h, b)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS))
    parser.add_argument("--cache", type=Path, help="folder that keeps the landmarks of every performer")
    args = parser.parse_args()
    performers = [observe(seed, args.cache) for seed in args.seeds]
    mirror, around = (mirrored_features(), mirrored_landmarks(performers)), neighbours()
    weights = np.zeros((len(FEATURE_IDS), SKIN), np.float32)
    for feature, home in enumerate(MEDIAPIPE_INDICES):
        near = sorted(around[int(home)])
        shares = place(feature, performers, mirror, near)
        weights[feature, near], weights[feature, home] = shares, 1.0 - shares.sum()
    np.savez_compressed(OUT, weights=weights)
    print(f"{OUT.name}: {OUT.stat().st_size} bytes, {np.count_nonzero(weights)} shares")


if __name__ == "__main__":
    main()
