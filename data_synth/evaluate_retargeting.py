"""Measure retargeting against truth on synthetic performers, and print one table per question.

    python data_synth/evaluate_retargeting.py --seeds 1000 1001 1002 1003 1004 --frames 120

1. Coefficients: performers who perform known coefficients of the 23 generic expressions; how far are the initial ones
   (section 4.2) and the re-solved ones (section 6) from them?
2. Correctives: a performer A and a performer B with the same way of moving (personal units, folds, interactions) on
   another head. A is tracked, B's true frames are known: how far from them is B driven by A's coefficients alone, and
   with the transfer of v4 - v1?
3. Smoothing: jitter on a still face, and lag on a step.
4. ARKit's curves of the performer's own performance: by the 23 expressions, and by ARKit's shapes with their halves.

Seeds 0 to 99 are for development; report on seeds from 1000 on.
"""

from __future__ import annotations

import argparse

import numpy as np

from adaptiveface.evaluation.coefficients import compare_coefficients, known_performance
from adaptiveface.livelink import ARKIT_NAMES
from adaptiveface.model.blendshapes import deformation_transfer
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.pipeline import capture_source, track_source
from adaptiveface.retargeting.arkit import arkit_weights
from adaptiveface.retargeting.arkit_resolve import unit_names
from adaptiveface.retargeting.correctives import transferred_correctives
from adaptiveface.retargeting.retarget import driving_coefficients, retarget
from adaptiveface.retargeting.smoothing import SmoothingCost, smoothing_costs
from adaptiveface.synthetic.performer import Performer
from adaptiveface.synthetic.sensor import SyntheticSensor


class SameStyle(Performer):
    """The performer of ``seed`` on another head: same personal motion, other identity coefficients."""

    def __init__(self, seed: int, identity: np.ndarray) -> None:
        self._other = identity
        super().__init__(seed)

    def _draw_skin(self, rng, detail, variation) -> None:
        self.identity = self._other
        super()._draw_skin(rng, detail, variation)


def performances(seed: int, frames: int, noise: str):
    """The performer's own performance and one of known coefficients, with one captured actor: (sensor, result) each."""
    sensor = SyntheticSensor(seed, noise, neutral_frames=24, frames=frames, repeats=1, colour=False)
    actor = capture_source(sensor, None, 24)
    known, truth = known_performance(sensor, frames)
    return actor, (sensor, track_source(sensor, actor)), (known, track_source(known, actor)), truth


def coefficient_errors(sensor, truth, result, actor) -> dict[str, float]:
    """Root mean square error over the performance: initial, re-solved by the plain fit, re-solved sparsely."""
    compared = compare_coefficients(sensor, truth, result, actor)
    return {name: compared.rms(name) for name in compared.found}


def transfer_errors(sensor, actor, result, step: int = 3) -> dict[str, tuple[float, float]]:
    """Active share and rms error (mm) on B: coefficients alone, with transferred v4 - v1, and with A's true frames.

    The active share is the error over the vertices that truly move by more than 2 mm, as a share of their motion. The
    last row is v4 on A itself: what the tracker sees of the motion bounds what can be carried over.
    """
    model, a = sensor.performer.model, sensor.performer
    other = np.clip(np.random.default_rng([sensor.seed, 7]).normal(0, 0.9, len(a.identity)), -2.2, 2.2)
    b = SameStyle(sensor.seed, other)
    frames = np.arange(0, sensor.frames, step)
    truth = np.stack([b.shape(sensor.script[f]) for f in frames]) - b.neutral
    source = np.stack([a.shape(sensor.script[f]) for f in frames])
    blendshapes = deformation_transfer(model.mean, b.neutral, model.triangles, model.generic_expressions)
    own = deformation_transfer(model.mean, a.neutral, model.triangles, model.generic_expressions)
    rows = sensor.neutral_frames + frames
    x = driving_coefficients(result, "resolved", actor)[rows]
    alone = np.tensordot(x, blendshapes, axes=1)
    v1, v4 = actor.neutral + np.tensordot(x, actor.blendshapes, axes=1), result.head_vertices[rows]
    exact = a.neutral + np.tensordot(x, own, axes=1)
    tracked = transferred_correctives(actor.neutral, v1, v4, b.neutral, model.triangles)
    true = transferred_correctives(a.neutral, exact, source, b.neutral, model.triangles)
    return {
        "coefficients alone": motion_errors(alone, truth, actor.frontal),
        "with tracked v4 - v1": motion_errors(alone + tracked, truth, actor.frontal),
        "with A's true frames": motion_errors(alone + true, truth, actor.frontal),
        "v1 on A itself": motion_errors(v1 - actor.neutral, source - a.neutral, actor.frontal),
        "v4 on A itself": motion_errors(v4 - actor.neutral, source - a.neutral, actor.frontal),
    }


def motion_errors(motion: np.ndarray, truth: np.ndarray, front: np.ndarray) -> tuple[float, float]:
    """Active share and rms error, mm, of displacements (F, N, 3) from the neutral."""
    error, size = (np.linalg.norm(field, axis=2)[:, front] for field in (motion - truth, truth))
    active = size > 2.0
    return float(error[active].sum() / size[active].sum()), float(np.sqrt(np.mean(error**2)))


def smoothing_rows(sensor, result, actor) -> tuple[SmoothingCost, ...]:
    """Jitter of the coefficients in the neutral frames, and lag of a step, of every filter."""
    still = driving_coefficients(result, "resolved", actor)[2 : sensor.neutral_frames]
    return smoothing_costs(still, sensor.fps)


def arkit_errors(sensor, result, actor) -> dict[str, float]:
    """Root mean square error of the curves that ARKit's units say (no gaze): those that the 23 drive, and the others."""
    part, names = slice(sensor.neutral_frames, None), sensor.performer.expression_names
    truth = np.zeros((sensor.frames, len(ARKIT_NAMES)))
    truth[:, [ARKIT_NAMES.index(name) for name in names]] = sensor.script
    asked = np.isin(ARKIT_NAMES, unit_names())
    driven = asked & (np.abs(arkit_weights(result.expression_names).matrix).max(axis=0) > 0)
    out = {}
    for way in ("resolved", "arkit"):
        error = retarget(result, way, actor=actor).curves[part] - truth
        for label, columns in (("all", asked), ("driven by the 23", driven), ("others", asked & ~driven)):
            out[f"{way}, {label}"] = float(np.sqrt(np.mean(error[:, columns] ** 2)))
    return out


def _joined(values: dict[str, float]) -> str:
    return ", ".join(f"{name} {value:.4f}" for name, value in values.items())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1000, 1001, 1002, 1003, 1004])
    parser.add_argument("--frames", type=int, default=120)
    parser.add_argument("--noise", default="structured-light")
    arguments = parser.parse_args()
    embedded_face_model()
    errors, shares, smooth, curves = [], [], [], []
    for seed in arguments.seeds:
        actor, (sensor, result), (known, known_result), truth = performances(seed, arguments.frames, arguments.noise)
        errors.append(coefficient_errors(known, truth, known_result, actor))
        shares.append(transfer_errors(sensor, actor, result))
        smooth.append(smoothing_rows(sensor, result, actor))
        curves.append(arkit_errors(sensor, result, actor))
        print(f"performer {seed}: coefficients, rms error: {_joined(errors[-1])}", flush=True)
        share = {name: values[0] for name, values in shares[-1].items()}
        print(f"performer {seed}: target, active share: {_joined(share)}", flush=True)
        print(f"performer {seed}: ARKit's curves, rms error: {_joined(curves[-1])}", flush=True)
    for name in curves[0]:
        print(f"ARKit's curves, {name}: rms error {np.mean([row[name] for row in curves]):.4f}")
    for name in errors[0]:
        print(f"coefficients, {name}: rms error {np.mean([row[name] for row in errors]):.4f}")
    for name in shares[0]:
        share, rms = np.mean([table[name] for table in shares], axis=0)
        print(f"target, {name}: active share {share:.3f}, rms {rms:.2f} mm")
    for k, row in enumerate(smooth[0]):
        print(f"smoothing {row.name}: jitter {np.mean([rows[k].jitter for rows in smooth]):.5f}, lag {row.lag:.0f} ms")


if __name__ == "__main__":
    main()
