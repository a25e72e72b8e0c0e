"""Sampling plausible adult heads: MakeHuman's macro targets (origin, sex, age, weight) plus about 170 detail sliders.

A slider's standard deviation is set by a cap in millimetres on its largest displacement at one sigma, because equal
sigmas in slider units let the few large sliders rule (cone heads).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import product

import numpy as np
from tqdm import tqdm

from .makehuman import MakeHuman

ORIGINS, SEXES, AGES, LEVELS = (
    ("african", "asian", "caucasian"),
    ("female", "male"),
    ("young", "old"),
    ("min", "average", "max"),
)
SIZE = 1.05  # MakeHuman heads are about 5 % smaller than anthropometric surveys of adults
SIZE_SIGMA = 0.03
MAX_SIGMA = 0.30  # of the slider's range
MAX_SIGMAS = 2.5  # a sample's slider is clipped here
ASYMMETRY = 0.2  # sigma of left minus right, in the slider's sigma

# (folder, name pattern, mm): first match wins, 0 leaves the slider out.
CAPS_MM = [
    ("head", r"head-(trans|angle)", 0),
    ("head", r"head-age", 0.6),
    ("head", r"head-back", 2.5),
    ("head", r"head-scale-vert", 4.0),
    ("head", r"head-scale", 3.0),
    ("head", r"head-fat", 2.0),
    ("head", r"", 2.2),
    ("nose", r"nose-trans-(in|out)", 0),
    ("nose", r"nose-(point|volume)", 1.1),
    ("nose", r"nose-scale-(depth|vert)", 2.0),
    ("nose", r"", 1.1),
    ("mouth", r"mouth-trans-(in|out)", 0),
    ("mouth", r"mouth-trans", 1.6),
    ("mouth", r"mouth-angles", 0.7),
    ("mouth", r"", 1.0),
    ("eyes", r".-eye-bag", 0.6),
    ("eyes", r".-eye-trans", 1.0),
    ("eyes", r"", 0.7),
    ("ears", r".-ear-(trans|scale)", 2.0),
    ("ears", r"", 1.2),
    ("chin", r"chin-cleft", 0.4),
    ("chin", r"", 2.0),
    ("cheek", r"", 1.6),
    ("forehead", r"", 1.8),
    ("eyebrows", r"", 1.4),
    ("asym", r"asymm", 0),
    ("asym", r"", 0.45),
    ("neck", r"(neck-trans|measure|neck-scale-vert)", 0),
    ("neck", r"", 0.8),
]
OPPOSITES = [
    ("incr", "decr"),
    ("up", "down"),
    ("out", "in"),
    ("forward", "backward"),
    ("convex", "concave"),
    ("uncompress", "compress"),
]


@dataclass(frozen=True)
class Slider:
    """One detail slider: displacement (k, 3) mm towards + and towards - (None: one-sided), standard deviation.

    ``shared`` names the value that the left and the right slider of one feature have in common, or is None.
    """

    plus: np.ndarray
    minus: np.ndarray | None
    sigma: float
    shared: str | None


def sample_heads(base: MakeHuman, keep: np.ndarray, skin: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(count, k, 3) float32 mm: base vertices ``keep`` (k,) of sampled heads; the caps hold on ``skin`` (k,) bool."""
    rng = np.random.default_rng(seed)
    sliders = list(_sliders(base, keep, skin))
    macro = _MacroTargets(base, keep)
    rest = base.vertices[keep]
    heads = np.empty((count, len(keep), 3), np.float32)
    for head in tqdm(heads, desc="sampling heads"):
        shape, size = macro.sample(rng)
        head[:] = (rest + shape + _sample_details(sliders, rng)) * size
    return heads


def _cap_mm(folder: str, name: str) -> float:
    return next(cap for where, pattern, cap in CAPS_MM if where == folder and re.match(pattern, name))


def _opposite(name: str, names: set[str], folder: str) -> str | None:
    for pair in OPPOSITES:
        for this, other in (pair, pair[::-1]):
            candidate = name[: -len(this)] + other
            if name.endswith("-" + this) and candidate in names:
                return candidate
    if folder == "asym" and name[-2:] in ("-l", "-r"):
        return name[:-1] + {"l": "r", "r": "l"}[name[-1]]
    return None


def _sliders(base: MakeHuman, keep: np.ndarray, skin: np.ndarray):
    for folder in dict.fromkeys(folder for folder, _, _ in CAPS_MM):
        names, done = base.target_names(folder), set()
        for name in names:
            opposite = _opposite(name, set(names), folder)
            if name in done:
                continue
            done |= {name, opposite}
            sides = [base.target(f"{folder}/{n}")[keep] if n else None for n in (name, opposite)]
            largest = max(np.linalg.norm(side[skin], axis=1).max() for side in sides if side is not None)
            cap = _cap_mm(folder, name)
            if cap > 0 and largest > 0:
                shared = folder + name[2:] if name[:2] in ("l-", "r-") else None
                yield Slider(*sides, min(cap / largest, MAX_SIGMA), shared)


def _sample_details(sliders: list[Slider], rng: np.random.Generator) -> np.ndarray:
    shape, shared = np.zeros_like(sliders[0].plus, dtype=float), {}
    for slider in sliders:
        if slider.shared is None:
            value = rng.normal()
        else:
            if slider.shared not in shared:
                shared[slider.shared] = rng.normal()
            value = shared[slider.shared] + ASYMMETRY * rng.normal()
        value = slider.sigma * np.clip(value, 0 if slider.minus is None else -MAX_SIGMAS, MAX_SIGMAS)
        shape += value * slider.plus if value >= 0 else -value * slider.minus
    return shape


class _MacroTargets:
    """Age, sex, origin, weight and muscle of adults, blended as MakeHuman does."""

    def __init__(self, base: MakeHuman, keep: np.ndarray):
        self.origin = {key: base.target("macrodetails/{}-{}-{}".format(*key))[keep] for key in product(ORIGINS, SEXES, AGES)}
        self.build = {
            key: base.target("macrodetails/universal-{}-{}-{}muscle-{}weight".format(*key))[keep]
            for key in product(SEXES, AGES, LEVELS, LEVELS)
        }

    def sample(self, rng: np.random.Generator) -> tuple[np.ndarray, float]:
        """(k, 3) displacement of one adult and the factor of the head's size."""
        male = float(np.clip(rng.integers(2) + rng.normal(0, 0.18), 0, 1))
        old = float(np.clip(rng.beta(1.0, 2.2), 0, 0.85))
        origin = dict(zip(ORIGINS, rng.dirichlet([0.7, 0.7, 0.7]), strict=True))
        weight = _levels(float(np.clip(rng.normal(0.05, 0.38), -0.8, 0.9)))
        muscle = _levels(float(np.clip(rng.normal(0, 0.3), -0.8, 0.8)))
        size = SIZE * (1 + rng.normal(0, SIZE_SIGMA))
        sex, age = {"female": 1 - male, "male": male}, {"young": 1 - old, "old": old}
        shape = sum(origin[o] * sex[s] * age[a] * target for (o, s, a), target in self.origin.items())
        shape = shape + sum(sex[s] * age[a] * muscle[m] * weight[w] * target for (s, a, m, w), target in self.build.items())
        return shape, size


def _levels(x: float) -> dict[str, float]:
    """x in [-1, 1] as weights of the minimum, average and maximum target."""
    return {"min": max(-x, 0.0), "average": 1 - abs(x), "max": max(x, 0.0)}
