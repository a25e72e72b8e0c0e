"""Match a face's shapes with ARKit's so that no movement is driven twice.

A face may have a shape as a whole and as two halves (``browInnerUp`` beside ``browInnerUpLeft`` and ``browInnerUpRight``), or
twice in two spellings. Only one of them is driven: the whole if ARKit has the whole, the halves if it has halves.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .arkit import ARKIT_NAMES, canonical_name

_SIDES = ("left", "right", "l", "r")


#: Ready Player Me's plain avatars have only these besides ``mouthSmile``.
_OTHER_NAMES = {"mouthopen": {"jawOpen": 1.0}, "eyesclosed": {"eyeBlinkLeft": 0.5, "eyeBlinkRight": 0.5}}


def arkit_row(name: str) -> np.ndarray | None:
    """(52,) weights of ARKit's shapes in a shape of that name, or None if the name corresponds to none of them.

    A whole that ARKit splits (``eyeBlink``, ``mouthSmile``) is driven by the mean of its halves.
    """
    canonical = canonical_name(name)
    mixture = {canonical: 1.0} if canonical else _OTHER_NAMES.get(letters(name)) or _of_halves(name)
    return np.array([mixture.get(arkit, 0.0) for arkit in ARKIT_NAMES]) if mixture else None


def _of_halves(name: str) -> dict[str, float]:
    left, right = (canonical_name(f"{name}{side}") for side in ("Left", "Right"))
    if left is None or right is None or left == right or left in ("jawLeft", "mouthLeft"):  # directions, not halves
        return {}
    return {left: 0.5, right: 0.5}


def letters(name: str) -> str:
    """The letters and digits of a name in lower case, because programs write the same name in many ways."""
    return "".join(c for c in name.lower() if c.isalnum())


def driven_shapes(names: Sequence[str]) -> tuple[dict[int, np.ndarray], list[str]]:
    """Choose which shapes of one mesh are driven.

    Parameters
    ----------
    names : sequence of str
        Names of the mesh's shapes.

    Returns
    -------
    chosen : dict
        The weights (52,) of ARKit's shapes by number of each shape that is driven.
    notes : list of str
        Lines about shapes that were joined or left out.
    """
    rows = {number: row for number, name in enumerate(names) if (row := arkit_row(name)) is not None}
    direct = {number: canonical_name(name) for number, name in enumerate(names)}
    chosen: dict[int, np.ndarray] = {}
    notes = []
    for arkit in ARKIT_NAMES:
        here = [n for n, name in direct.items() if name == arkit]
        wholes = [n for n in here if not _half(names[n], arkit)]
        kept = wholes[:1] or _one_of_each_side(here, names, arkit)
        chosen |= {n: rows[n] for n in kept}
        left = [names[n] for n in here if n not in kept]
        if left:
            notes.append(f"{' + '.join(names[n] for n in kept)} shows {arkit}; not driven as well: {', '.join(left)}")
        elif len(kept) > 1:
            notes.append(f"{' + '.join(names[n] for n in kept)} make {arkit}")
    covered = sum(chosen.values(), np.zeros(len(ARKIT_NAMES)))
    for number, row in rows.items():
        if direct[number]:
            continue
        if covered[row > 0].any():  # a half is there, or the same in another spelling
            notes.append(f"not driven, because others show the same: {names[number]}")
        else:
            chosen[number] = row
            covered = covered + row
    return chosen, notes


def _half(name: str, arkit: str) -> str:
    """The side ("l" or "r") that a name adds to a shape that ARKit does not split; "" for the whole."""
    keys = [letters(part) for part in (name, name.rsplit(".", 1)[-1])]
    return next((side[0] for side in _SIDES if arkit.lower() + side in keys), "")


def _one_of_each_side(numbers: list[int], names: Sequence[str], arkit: str) -> list[int]:
    first: dict[str, int] = {}
    for number in numbers:
        first.setdefault(_half(names[number], arkit), number)
    return list(first.values())
