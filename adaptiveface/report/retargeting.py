"""Write the section on section 6 of the paper: coefficients that drive another face, and the cost of smoothing."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..evaluation.coefficients import INITIAL, PLAIN, RESOLVED, KnownCoefficients
from ..retargeting.arkit import arkit_weights
from ..retargeting.character import Character
from ..retargeting.correctives import transferred_correctives
from ..retargeting.portrait import portrait
from ..retargeting.smoothing import smoothing_costs
from ..runtime.timing import frame_rate
from . import charts, page, pictures
from .context import Context
from .moments import expressive_frames

if TYPE_CHECKING:
    from markupsafe import Markup

_BACKDROP, _SIZE, _YAW = (52, 58, 68), 230, 14.0
#: Number of leading frames in which pose and coefficients still settle, and smallest number of frames to measure jitter.
_SETTLING, _FEWEST_STILL = 2, 8


def section(context: Context, character: Character, known: KnownCoefficients | None, still_frames: int) -> Markup | str:
    """Write figure 8 on a character, the error of the coefficients if they are known, and jitter and lag of each smoothing.

    ``still_frames`` is the number of leading frames that show a still face, or 0 if it is unknown.
    """
    if not context.result.tracked.any():
        return ""
    return page.html().retargeting([_faces(context, character), _errors(known), _smoothing(context, still_frames)])


def _faces(context: Context, character: Character, count: int = 3) -> Markup:
    result, actor = context.result, context.actor
    candidates = expressive_frames(result, 3 * count, spacing=6)
    differ = np.abs(result.coefficients - result.coefficients_initial).sum(axis=1)
    chosen = sorted(sorted(candidates, key=lambda k: -differ[k])[:count])
    portraits = pictures.Portraits(actor, (_SIZE, _SIZE), whole=True)
    rows = []
    for k in chosen:
        v4 = result[k].head_vertices
        mesh = pictures.on_backdrop(portraits.draw(v4, turn=_YAW), _BACKDROP)
        images = [(mesh, f"actor, {result.timestamps[k]:.2f} s")]
        for shape, text in _driven(result, actor, character, k, v4):
            images.append((portrait(character, shape, _SIZE, yaw=_YAW, background=_BACKDROP), text))
        cells = [page.figure(pixels, text, alt=f"{character.name}: {text}") for pixels, text in images]
        rows.append(page.html().figures("row", cells))
    return page.html().driven_faces(character.name, character.shares_topology(actor.triangles), rows)


def _driven(result, actor, character: Character, k: int, v4: np.ndarray) -> list[tuple[np.ndarray, str]]:
    """Drive the character with initial and re-solved coefficients and, if it has the actor's topology, with correctives.

    Returns the vertices (V, 3) of each version with its caption.
    """
    x = result.coefficients[k]
    table = arkit_weights(actor.expression_names[: len(x)])
    initial, resolved = character.shape(character.weights(table.curves(np.stack([result.coefficients_initial[k], x]))))
    out = [(initial, INITIAL), (resolved, RESOLVED)]
    if character.shares_topology(actor.triangles):
        v1 = actor.neutral + np.tensordot(x, actor.blendshapes[: len(x)], axes=1)
        rich, skin = resolved.copy(), character.neutral[: len(v1)]
        rich[: len(v1)] += transferred_correctives(actor.neutral, v1[None], v4[None], skin, actor.triangles)[0]
        out.append((rich, "re-solved, with correctives"))
    return out


def _errors(known: KnownCoefficients | None) -> Markup | str:
    if known is None:
        return ""
    initial, resolved = known.rms(INITIAL), known.rms(RESOLVED)
    better = int((known.rms_by_expression(RESOLVED) < known.rms_by_expression(INITIAL)).sum())
    change = f"{abs(1 - resolved / initial):.0%} {'lower' if resolved < initial else 'higher'}"
    rows = [[name, f"{known.rms(name):.4f}"] for name in (INITIAL, PLAIN, RESOLVED)]
    table = page.html().table(("coefficients", "rms error"), rows, (2,))
    drawn = charts.coefficient_errors(known), charts.known_curves(known)
    return page.html().known_coefficients(known, initial, resolved, change, better, table, drawn)


def _smoothing(context: Context, still_frames: int) -> Markup | str:
    result = context.result
    still = [k for k in range(_SETTLING, min(still_frames, len(result))) if result.tracked[k]]
    if len(still) < _FEWEST_STILL:
        return ""
    fps = frame_rate(result.timestamps)
    costs = smoothing_costs(result.coefficients[still].astype(float), fps)
    rows = [[c.name, f"{c.jitter:.4f}", f"{c.lag:.0f} ms", f"{c.overshoot:.0%}"] for c in costs]
    table = page.html().table(("filter", "jitter", "lag", "overshoot"), rows)
    return page.html().smoothing(len(still), table, charts.step_responses(fps))
