"""Exercise of notebook 01: one depth frame added to a truncated signed distance volume (Curless & Levoy 1996)."""

from __future__ import annotations

import numpy as np

from .grading import Case, Exercise, Mistake, Wrong, drawn, switched
from .pairs import close, packed


@drawn(seed=11, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Voxels in front of, near and behind the skin; some were never seen, some are seen at a grazing angle."""
    n, truncation = int(rng.integers(60, 200)), float(rng.uniform(3.0, 9.0))
    weight = np.where(rng.random(n) < 0.3, 0.0, rng.uniform(0.2, 8.0, n))
    distance = np.where(weight > 0, rng.uniform(-1, 1, n), 1.0)
    measured, cosine = rng.uniform(-3, 3, n) * truncation, rng.uniform(0.0, 1.0, n)
    return dict(
        distance=distance,
        weight=weight,
        measured=measured,
        cosine=cosine,
        truncation=truncation,
        min_cosine=float(rng.uniform(0.15, 0.4)),
    )


def integrate(
    distance,
    weight,
    measured,
    cosine,
    truncation,
    min_cosine,
    scale=True,
    top=True,
    skip=True,
    bottom=False,
    sign=1.0,
    angle=True,
    own=None,
    keep_mean=True,
    forget=False,
    add=True,
):
    """The package's answer, and by its switches what goes wrong."""
    d = sign * measured / (truncation if scale else 1.0)
    limit = 1.0 if scale else truncation
    use = np.ones(len(d), bool)
    if skip:
        use &= d >= -limit
    if angle:
        use &= cosine >= min_cosine
    if top:
        d = np.minimum(d, limit)
    if bottom:
        d = np.maximum(d, -limit)
    w = cosine if own is None else own(cosine)
    total = np.where(use, weight + w, weight)
    mean = (distance * weight + d * w) / np.maximum(weight + w, 1e-12) if keep_mean else 0.5 * (distance + d)
    mean = d if forget else mean
    return np.where(use, mean, distance), total if add else np.where(use, w, weight)


def parse(answer, case: Case) -> np.ndarray:
    """distance and weight, packed."""
    n = len(case["distance"])
    try:
        return packed(answer, (("distance", (n,)), ("weight", (n,))))
    except Wrong as wrong:
        if "NaN or infinite" in str(wrong):
            raise Wrong(f"{wrong}: a voxel that no frame has seen has the weight 0, by which nothing can be divided") from None
        raise


def _emptied(**case):
    """Voxels that the frame may not speak about have lost their distance and their weight."""
    distance, weight = integrate(**case)
    told = weight > case["weight"]
    return np.where(told, distance, 0.0), np.where(told, weight, 0.0)


_by = switched(integrate)
MISTAKES = (
    Mistake("the distance stays in mm: the volume holds it in units of the truncation", _by(scale=False)),
    Mistake("distances in front of the skin are not truncated at 1: far voxels outvote near ones", _by(top=False)),
    Mistake(
        "voxels far behind the skin are updated too: what lies there is hidden, and may be the other side of the head",
        _by(skip=False),
    ),
    Mistake(
        "voxels far behind the skin are set to -1 instead of left alone: thin parts such as ears vanish",
        _by(skip=False, bottom=True),
    ),
    Mistake("a voxel about which the frame may not speak is set to 0 instead of left as it was", _emptied),
    Mistake("the sign is turned: the distance is positive in front of the skin", _by(sign=-1.0)),
    Mistake("min_cosine does not enter: skin seen at a grazing angle is measured badly", _by(angle=False)),
    Mistake("every frame counts 1: its weight is the cosine of the viewing angle", _by(own=np.ones_like)),
    Mistake("the cosine is squared: the weight is the cosine itself", _by(own=np.square)),
    Mistake("old and new distance are averaged half and half: the old one counts by its weight", _by(keep_mean=False)),
    Mistake("the new distance replaces the old one: noise averages out only in a running mean", _by(forget=True)),
    Mistake("the weights are not added up: the voxel forgets how often it was seen", _by(add=False)),
    Mistake(
        "the weighted sum is not divided by the sum of the weights",
        lambda **c: (lambda d, w: (np.where(w > c["weight"], d * w, d), w))(*integrate(**c)),
    ),
)

TSDF_INTEGRATION = Exercise(
    "integrate",
    "01_neutral_scan",
    task=(
        "integrate(distance, weight, measured, cosine, truncation, min_cosine): for n voxels the running mean distance (n,) "
        "in units of the truncation, its weight (n,), the signed distance measured (n,) of this frame in mm (positive in "
        "front of the skin), the cosine (n,) of the viewing angle, and two numbers -> (distance, weight) after the frame. A "
        "voxel more than one truncation behind the skin, or seen at a cosine below min_cosine, stays as it is."
    ),
    hints=(
        "Three questions per voxel: may this frame speak about it, what does it say, and how much does it count?",
        "Divide the measured distance by the truncation and cap it at 1. Leave a voxel alone where the result is below -1 or "
        "the cosine too small. Elsewhere take the mean of old and new, weighted by the old weight and the cosine.",
        "d = min(measured / truncation, 1); where d >= -1 and cosine >= min_cosine: distance <- (weight distance + cosine d) "
        "/ (weight + cosine), weight <- weight + cosine.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=integrate,
    parse=parse,
    near=close,
)
