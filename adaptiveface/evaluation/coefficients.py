"""Coefficients against known ones: a synthetic performer who performs given coefficients of the generic expressions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..model.actor import Actor
from ..parameters import Parameters
from ..pipeline import track_source
from ..retargeting.arkit import ARKIT_NAMES, arkit_weights
from ..retargeting.resolve import blendshape_parameters
from ..synthetic.sensor import SyntheticSensor
from ..tracking.resolve import SparseResolve

#: How a coefficient vector came about: the fit to the depth map (section 4.2), and two ways to solve once more from v4.
INITIAL, PLAIN, RESOLVED = "initial", "plain fit to v4", "re-solved"


@dataclass(frozen=True)
class KnownCoefficients:
    """truth (F, A) and what was found, ``found[INITIAL | PLAIN | RESOLVED]`` (F, A); names (A,), timestamps (F,) s."""

    names: tuple[str, ...]
    timestamps: np.ndarray
    truth: np.ndarray
    found: dict[str, np.ndarray]

    def rms(self, name: str) -> float:
        """Root mean square error over all frames and expressions."""
        return float(np.sqrt(np.mean((self.found[name] - self.truth) ** 2)))

    def rms_by_expression(self, name: str) -> np.ndarray:
        """(A,) root mean square error of every expression over all frames."""
        return np.sqrt(np.mean((self.found[name] - self.truth) ** 2, axis=0))


def known_performance(sensor: SyntheticSensor, frames: int, neutral_frames: int = 24) -> tuple[SyntheticSensor, np.ndarray]:
    """The same performer with a script of nothing but coefficients: (sensor without colour, truth (frames, A)).

    What a coefficient does on this face is the performer's own affair: personal motion and folds follow as always.
    """
    known = SyntheticSensor(sensor.seed, sensor.noise, neutral_frames, frames, 1, colour=False, performer=sensor.performer)
    model = sensor.performer.model
    table = arkit_weights(model.generic_names, model)
    curves = np.zeros((frames, len(ARKIT_NAMES)))
    curves[:, [ARKIT_NAMES.index(name) for name in model.expression_names]] = known.script
    truth = table.coefficients(curves)
    known.script = truth @ model.generic_weights
    return known, truth


def compare_coefficients(sensor: SyntheticSensor, truth: np.ndarray, result, actor: Actor) -> KnownCoefficients:
    """Initial and re-solved coefficients of a tracked :func:`known_performance` beside the truth (frames, A)."""
    part = slice(sensor.neutral_frames, None)
    names = tuple(result.expression_names)
    plain = SparseResolve.of(result.rig(actor), names, replace(blendshape_parameters(result), sparsity=0.0, habits=0.0))
    heads = (result[k].head_vertices for k in range(part.start, len(result)))
    found = {
        INITIAL: result.coefficients_initial[part].astype(float),
        PLAIN: np.stack([plain(v4, x) for v4, x in zip(heads, result.coefficients[part], strict=True)]),
        RESOLVED: result.coefficients[part].astype(float),
    }
    columns = [sensor.performer.model.generic_names.index(name) for name in names]
    return KnownCoefficients(names, result.timestamps[part], truth[:, columns], found)


def measure_coefficients(
    sensor: SyntheticSensor, actor: Actor, parameters: Parameters | None = None, frames: int = 60, progress: bool = False
) -> KnownCoefficients:
    """Track a :func:`known_performance` of the sensor's performer with its actor, and compare."""
    known, truth = known_performance(sensor, frames)
    return compare_coefficients(known, truth, track_source(known, actor, parameters, progress=progress), actor)
