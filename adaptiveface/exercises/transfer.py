"""Exercise of notebook 02: how a triangle changes, the heart of deformation transfer (Sumner & Popovic 2004)."""

from __future__ import annotations

import numpy as np

from ..model.blendshapes import deformation_gradients
from .grading import Case, Exercise, Mistake, as_array, drawn
from .pairs import close


@drawn(seed=21, count=6)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Triangles of a few millimetres, stretched, sheared and turned."""
    t = int(rng.integers(4, 30))
    neutral = 3.0 * rng.normal(size=(t, 3, 3)) + 40 * rng.normal(size=(t, 1, 3))
    turn = np.linalg.qr(rng.normal(size=(t, 3, 3)))[0]
    deformed = (neutral + 0.5 * rng.normal(size=neutral.shape)) @ turn + 5 * rng.normal(size=(t, 1, 3))
    return dict(neutral=neutral, deformed=deformed)


def truth(neutral, deformed):
    """The package's answer."""
    corners = np.arange(3 * len(neutral)).reshape(-1, 3)
    return deformation_gradients(neutral.reshape(-1, 3), deformed.reshape(-1, 3), corners)


def frames(corners, power=0.5, edges=True, flip=1.0, order=(0, 1, 2), together=False):
    """V (T, 3, 3): two edges and the normal over its length to a power, as columns; by the switches, what goes wrong."""
    a, b, c = (corners[:, k] for k in order)
    u, v = (b - a, c - a) if edges else (b, c)
    normal = flip * np.cross(u, v)
    length = np.linalg.norm(normal) if together else np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([u, v, normal / length**power], axis=2)


def parse(answer, case: Case) -> np.ndarray:
    """(T, 3, 3)."""
    return as_array(answer, case["neutral"].shape, "S")


def _of(**switches):
    return lambda neutral, deformed: frames(deformed, **switches) @ np.linalg.inv(frames(neutral, **switches))


def _without_normal(neutral, deformed):
    v, w = frames(neutral)[:, :, :2], frames(deformed)[:, :, :2]
    return w @ np.linalg.pinv(v)


MISTAKES = (
    Mistake("S is transposed: the frames hold the edges as columns", lambda **c: truth(**c).transpose(0, 2, 1)),
    Mistake("S is the inverse: it must take the neutral triangle to the deformed one", lambda **c: np.linalg.inv(truth(**c))),
    Mistake(
        "the factors are in the wrong order: S V = V' gives S = V' V^-1",
        lambda neutral, deformed: np.linalg.inv(frames(neutral)) @ frames(deformed),
    ),
    Mistake(
        "the frame is not inverted but transposed: its columns are not orthonormal",
        lambda neutral, deformed: frames(deformed) @ frames(neutral).transpose(0, 2, 1),
    ),
    Mistake("the normal has length 1: divided by the root of its length it scales as the triangle does", _of(power=1.0)),
    Mistake("the normal is not divided at all: it grows with the area, not with the length", _of(power=0.0)),
    Mistake("one length is taken of all normals together: each triangle has its own (axis=1)", _of(together=True)),
    Mistake("the corners themselves are used: only edges do not depend on where the triangle is", _of(edges=False)),
    Mistake(
        "the normal is left out and a pseudo-inverse taken: then S flattens everything off the triangle's plane",
        _without_normal,
    ),
    Mistake("I was subtracted: S itself is asked for", lambda **c: truth(**c) - np.eye(3)),
    Mistake(
        "the deformed triangle's normal points to the other side",
        lambda neutral, deformed: frames(deformed, flip=-1.0) @ np.linalg.inv(frames(neutral)),
    ),
    Mistake(
        "the corners of the deformed triangle are taken in another order than those of the neutral one",
        lambda neutral, deformed: frames(deformed, order=(1, 2, 0)) @ np.linalg.inv(frames(neutral)),
    ),
    Mistake("nothing changes: the identity came back", lambda **c: np.broadcast_to(np.eye(3), c["neutral"].shape)),
)

DEFORMATION_GRADIENT = Exercise(
    "deformation_gradient",
    "02_blendshapes",
    task=(
        "deformation_gradient(neutral, deformed): the corners (T, 3, 3) of T triangles before and after, one corner per row "
        "-> (T, 3, 3) the affine maps S with S V = V', where the columns of V are the edges b - a, c - a and the normal (b - "
        "a) x (c - a) divided by the root of its length, and V' the same of the deformed triangle."
    ),
    hints=(
        "An affine map of space is known by what it does with three directions. A triangle has two edges. Where is the third?",
        "Build a (3, 3) frame of each triangle: two edges and a normal that scales as a length does. S takes one frame to the "
        "other.",
        "n = (b - a) x (c - a), V = [b - a, c - a, n / sqrt(|n|)] as columns, S = V' V^-1.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=truth,
    parse=parse,
    near=close,
)
