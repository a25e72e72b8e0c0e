"""Compare coefficients with known ones: a synthetic performer performs given coefficients of the generic expressions."""

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

#: Sources of a coefficient vector: the fit to the depth map (section 4.2), and two ways to solve for it again from v4.
INITIAL, PLAIN, RESOLVED = "initial", "plain fit to v4", "re-solved"


@dataclass(frozen=True)
class KnownCoefficients:
    """True and tracked coefficients of F frames and A expressions.

    Attributes
    ----------
    names : tuple of str
        Names of the expressions.
    timestamps : (F,)
        Times of the frames, s.
    truth : (F, A)
        The true coefficients.
    found : dict
        The tracked coefficients (F, A) by their source: ``INITIAL``, ``PLAIN`` and ``RESOLVED``.
    """

    names: tuple[str, ...]
    timestamps: np.ndarray
    truth: np.ndarray
    found: dict[str, np.ndarray]

    def rms(self, name: str) -> float:
        """Return the root mean square error of a source over all frames and expressions."""
        return float(np.sqrt(np.mean((self.found[name] - self.truth) ** 2)))

    def rms_by_expression(self, name: str) -> np.ndarray:
        """Return the root mean square error (A,) of every expression over all frames, for a source."""
        return np.sqrt(np.mean((self.found[name] - self.truth) ** 2, axis=0))


def known_performance(sensor: SyntheticSensor, frames: int, neutral_frames: int = 24) -> tuple[SyntheticSensor, np.ndarray]:
    """Let the same performer follow a script that consists only of coefficients.

    Personal motion and folds follow the coefficients as usual.

    Parameters
    ----------
    sensor : SyntheticSensor
        The sensor of the performer.
    frames : int
        Length of the performance, frames.
    neutral_frames : int
        Length of the neutral scan before it, frames.

    Returns
    -------
    sensor : SyntheticSensor
        A sensor without colour.
    truth : (frames, A)
        The coefficients of the script.
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
    """Compare the coefficients of a tracked :func:`known_performance` with the truth.

    Parameters
    ----------
    sensor : SyntheticSensor
        The sensor that was tracked.
    truth : (frames, A)
        The coefficients of the script.
    result : Result
        The result.
    actor : Actor
        The rig that was tracked.

    Returns
    -------
    KnownCoefficients
        The true and the tracked coefficients.
    """
    part = slice(sensor.neutral_frames, None)
    names = tuple(result.expression_names)
    plain = SparseResolve.of(
        result.rig(actor), names, replace(blendshape_parameters(result), sparsity=0.0, expression_prior=0.0)
    )
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
    """Track a :func:`known_performance` of the sensor's performer, and compare the coefficients with the truth.

    Parameters
    ----------
    sensor : SyntheticSensor
        The sensor of the performer.
    actor : Actor
        The performer's rig.
    parameters : Parameters, optional
        The parameters of the tracker.
    frames : int
        Length of the performance, frames.
    progress : bool
        Whether to show a progress bar.

    Returns
    -------
    KnownCoefficients
        The true and the tracked coefficients.
    """
    known, truth = known_performance(sensor, frames)
    return compare_coefficients(known, truth, track_source(known, actor, parameters, progress=progress), actor)
