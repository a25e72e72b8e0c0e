"""Exercise of notebook 06: the projection onto the adaptive space and the validity test (sections 4.3 and 5)."""

from __future__ import annotations

import numpy as np

from .grading import Case, Exercise, Mistake, drawn, switched
from .pairs import close, packed


@drawn(seed=17, count=9)
def cases(rng: np.random.Generator, number: int) -> Case:
    """Samples inside the thresholds, below and above them."""
    size, a, k = 3 * int(rng.integers(20, 60)), int(rng.integers(3, 9)), int(rng.integers(1, 6))
    basis = np.linalg.qr(rng.normal(size=(size, a + k)))[0]
    displacement = rng.normal(size=size) * (0.4, 3.0, 40.0)[number % 3] + 25 * basis @ rng.normal(size=a + k)
    return dict(displacement=displacement, anchors=basis[:, :a], correctives=basis[:, a:], low=1.0, high=600.0)


def project(
    displacement,
    anchors,
    correctives,
    low,
    high,
    unit=100.0,
    spaces="both",
    left="anchors",
    root=False,
    lower=True,
    upper=True,
    mean=False,
):
    """The package's answer, and by its switches what goes wrong."""
    in_anchors = anchors @ (anchors.T @ displacement)
    in_correctives = correctives @ (correctives.T @ displacement)
    projected = {"both": in_anchors + in_correctives, "anchors": in_anchors, "correctives": in_correctives}[spaces]
    rest = displacement - {"anchors": in_anchors, "both": in_anchors + in_correctives, "nothing": 0.0}[left]
    energy = rest @ rest / unit
    energy = np.sqrt(energy) if root else energy / len(rest) if mean else energy
    return projected, energy, (energy > low or not lower) and (energy < high or not upper)


def parse(answer, case: Case) -> np.ndarray:
    """projected, energy and valid (as 0 or a large number), packed."""
    vector = packed(answer, (("projected", case["displacement"].shape), ("energy", ()), ("valid", ())))
    vector[-1] = 1e3 * bool(vector[-1])
    return vector


_by = switched(project)
MISTAKES = (
    Mistake("the energy is in mm^2: the thresholds are meant in cm^2, 1 cm^2 is 100 mm^2", _by(unit=1.0)),
    Mistake("mm^2 were divided by 10 instead of 100: the unit is squared too", _by(unit=10.0)),
    Mistake("the norm is not squared", _by(root=True)),
    Mistake("the mean over the coordinates is taken: the paper's norm is a sum", _by(mean=True)),
    Mistake("the correctives are missing from the projection", _by(spaces="anchors")),
    Mistake("the anchors are missing from the projection", _by(spaces="correctives")),
    Mistake(
        "the energy is what both spaces leave over: then a learned expression would never be learned better", _by(left="both")
    ),
    Mistake("the energy is that of the whole displacement: a wide smile would be an outlier", _by(left="nothing")),
    Mistake("low does not enter: samples that the anchors explain would fill the buffer", _by(lower=False)),
    Mistake("high does not enter: a hand before the face would be learned", _by(upper=False)),
    Mistake("valid is inverted", lambda **c: (lambda v, e, ok: (v, e, not ok))(*project(**c))),
    Mistake(
        "the rest came back instead of the projection", lambda **c: (c["displacement"] - project(**c)[0], *project(**c)[1:])
    ),
    Mistake("nothing was projected: the displacement came back", lambda **c: (c["displacement"], *project(**c)[1:])),
)

PROJECT = Exercise(
    "project",
    "06_incremental_pca",
    task=(
        "project(displacement, anchors, correctives, low, high): displacement (3n,) mm of v2 from the neutral, anchors (3n, "
        "a) and correctives (3n, k), all columns orthonormal -> (projected (3n,), energy, valid): the projection onto both "
        "spaces together; the squared norm in cm^2 of what the anchor space alone leaves over; and whether it lies between "
        "low and high, bounds excluded."
    ),
    hints=(
        "With orthonormal columns a projection needs no solve. Which space does each of the two questions ask about?",
        "Project onto anchors and correctives and add. For the test take away the anchors' part only, and count in "
        "centimetres.",
        "v = M_A M_A^T d + M_K M_K^T d; s = d - M_A M_A^T d; energy = s.s / 100; valid = low < energy < high.",
    ),
    mistakes=MISTAKES,
    cases=cases,
    truth=project,
    parse=parse,
    near=close,
)
