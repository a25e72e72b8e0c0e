"""Result files: everything a tracked performance leaves behind, frame by frame, in one ``result.npz``."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from .actor import Actor
from .errors import FileFormatError
from .npz import Field, check_indices, load_checked
from .parameters import Parameters
from .tracking.types import STAGE_NAMES, SampleState, TrackedFrame

_FIELDS = {
    "vertices": Field(("F", "N", 3)),
    "triangles": Field(("T", 3), "iu"),
    "v1": Field(("F", "N", 3), optional=True),
    "v2": Field(("F", "N", 3), optional=True),
    "v3": Field(("F", "N", 3), optional=True),
    "frontal": Field(("N",), "b"),
    "tracked": Field(("F",), "b"),
    "skipped": Field(("F",), "b", optional=True),
    "timestamps": Field(("F",)),
    "rigid": Field(("F", 4, 4)),
    "coefficients": Field(("F", "A")),
    "coefficients_initial": Field(("F", "A")),
    "expression_names": Field(("A",), "U"),
    "feature_vertices": Field((40,), "iu"),
    "feature_ids": Field((40,), "iu"),
    "corrective_updates": Field(("F",), "iu"),
    "sample_state": Field(("F",), "iu"),
    "residual": Field(("F",), optional=True),
    "anchor_distance": Field(("F",), optional=True),
    "adaptive_distance": Field(("F",), optional=True),
    "reasons": Field(("F",), "U", optional=True),
    "stage_ms": Field(("F", "S")),
    "stage_names": Field(("S",), "U"),
    "parameters": Field((), "U"),
    "correctives": Field(("K", "N", 3), optional=True),
    "colour_only": Field((), "b", optional=True),
}


#: How everything that people read calls a result that was tracked without depth.
COLOUR_ONLY = "colour only: no depth, degraded"


@dataclass(frozen=True)
class Result:
    """A tracked performance of F frames, N vertices, A expressions, S stages; one entry per frame of the source.

    vertices (F, N, 3) float32: final mesh v4 in the camera frame, mm; v1, v2, v3 likewise, or None; triangles (T, 3)
    int32; frontal (N,) bool; timestamps (F,) s; rigid (F, 4, 4) head to camera; coefficients (F, A) re-solved and
    coefficients_initial (F, A); expression_names (A,); feature_vertices, feature_ids (40,); corrective_updates (F,) PCA
    updates so far; sample_state (F,) of :class:`SampleState`; residual, anchor_distance, adaptive_distance (F,) mm;
    stage_ms (F, S), stage_names (S,); parameters: JSON of every parameter.

    tracked (F,) bool: the face was tracked; skipped (F,) bool: the frame was broken and never reached the tracker;
    reasons (F,): why a frame is not tracked, "" where it is. A frame that is not tracked repeats mesh, pose and
    coefficients of the last tracked one (before the first one: of the first one; without any: the neutral, unmoved),
    has sample state UNTRACKED, and 0 for its distances. correctives (K, N, 3) or None: the corrective shapes as learned
    at the end, orthonormal, zero outside the frontal region. colour_only: tracked without depth, a degraded mode.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    frontal: np.ndarray
    tracked: np.ndarray
    skipped: np.ndarray
    timestamps: np.ndarray
    rigid: np.ndarray
    coefficients: np.ndarray
    coefficients_initial: np.ndarray
    expression_names: tuple[str, ...]
    feature_vertices: np.ndarray
    feature_ids: np.ndarray
    corrective_updates: np.ndarray
    sample_state: np.ndarray
    residual: np.ndarray
    anchor_distance: np.ndarray
    adaptive_distance: np.ndarray
    reasons: tuple[str, ...]
    stage_ms: np.ndarray
    stage_names: tuple[str, ...]
    parameters: str
    v1: np.ndarray | None = None
    v2: np.ndarray | None = None
    v3: np.ndarray | None = None
    correctives: np.ndarray | None = None
    colour_only: bool = False

    def __len__(self) -> int:
        return len(self.vertices)

    def summary(self) -> str:
        """A few lines for people: how many frames were tracked and learned from, and the median time of each stage."""
        lost = int((~self.tracked & ~self.skipped).sum())
        learned = int((self.sample_state == SampleState.LEARNED).sum())
        lines = [
            f"{len(self)} frames: {int(self.tracked.sum())} tracked, {lost} without a face, {int(self.skipped.sum())} "
            f"broken and skipped; learned from {learned}"
        ]
        if self.colour_only:
            lines.insert(0, f"{COLOUR_ONLY} (2D features alone; size and distance assumed, nothing learned)")
        broken = [reason for reason, skipped in zip(self.reasons, self.skipped, strict=True) if skipped]
        lines += [f"  skipped: {reason}" for reason in broken[:5]]
        lines += [f"  ... and {len(broken) - 5} more"] if len(broken) > 5 else []
        if self.tracked.any():
            median = np.median(self.stage_ms[self.tracked], axis=0)
            total = np.median(self.stage_ms[self.tracked].sum(axis=1))
            stages = ", ".join(f"{name} {ms:.1f}" for name, ms in zip(self.stage_names, median, strict=True))
            lines.append(f"median ms per frame: {total:.1f} ({stages})")
        return "\n".join(lines)

    def save(self, path: str | os.PathLike) -> None:
        """Write ``result.npz`` (uncompressed: coordinates hardly shrink), whole or not at all."""
        arrays = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        temporary = f"{os.fspath(path)}.part"
        with open(temporary, "wb") as stream:
            np.savez(stream, **{name: np.asarray(value) for name, value in arrays.items() if value is not None})
        os.replace(temporary, path)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Result:
        """Read ``result.npz``; raises :class:`FileFormatError` naming the file and the array."""
        path = Path(path)
        data = load_checked(path, _FIELDS)
        n_frames, n_vertices = data["vertices"].shape[:2]
        for name in ("triangles", "feature_vertices"):
            check_indices(path, name, data[name], n_vertices)
            data[name] = data[name].astype(np.int32)
        states = [int(state) for state in SampleState]
        if not np.isin(data["sample_state"], states).all():
            raise FileFormatError(f"{path}: array 'sample_state' holds values other than {states}")
        data.setdefault("reasons", np.full(n_frames, ""))
        for name in ("expression_names", "stage_names", "reasons"):
            data[name] = tuple(str(text) for text in data[name])
        data["parameters"] = str(data["parameters"])
        data["colour_only"] = bool(data.get("colour_only", False))
        data.setdefault("skipped", np.zeros(n_frames, bool))
        for name in ("residual", "anchor_distance", "adaptive_distance"):
            data.setdefault(name, np.zeros(n_frames, np.float32))
        return cls(**data)


class ResultBuilder:
    """Collects a run frame by frame; 0.09 MB per frame of 7,053 vertices, four times that with the stages.

    ``add`` or ``skip`` once per frame in order, then ``finish`` (at any time: frames not reached are left out). More
    frames than ``n_frames`` make it grow, by half of what it holds.
    """

    def __init__(
        self, actor: Actor, parameters: Parameters, n_frames: int, keep_stages: bool = False, colour_only: bool = False
    ) -> None:
        self.actor, self.parameters, self.done, self.colour_only = actor, parameters, 0, colour_only
        self._names = tuple(actor.expression_names)[: parameters.blendshapes.A]
        self._stages = ("v1", "v2", "v3") if keep_stages else ()
        self._reasons: list[str] = []
        self._updates = 0
        f, mesh, expressions = n_frames, (n_frames, len(actor.neutral), 3), (n_frames, len(self._names))
        float32 = dict.fromkeys(("vertices", *self._stages), mesh)
        float32 |= {"rigid": (f, 4, 4), "coefficients": expressions, "coefficients_initial": expressions}
        float32 |= {"residual": (f,), "anchor_distance": (f,), "adaptive_distance": (f,)}
        float32["stage_ms"] = (f, len(STAGE_NAMES))
        self._rows = {name: np.zeros(shape, np.float32) for name, shape in float32.items()}
        self._rows |= {"tracked": np.zeros(f, bool), "skipped": np.zeros(f, bool), "timestamps": np.zeros(f)}
        self._rows |= {"corrective_updates": np.zeros(f, np.int32), "sample_state": np.zeros(f, np.int8)}

    def add(self, frame: TrackedFrame) -> None:
        """Take the next frame, tracked or not."""
        row: dict[str, object] = dict(
            timestamps=frame.timestamp,
            tracked=frame.tracked,
            corrective_updates=frame.corrective_updates,
            stage_ms=[frame.stage_ms.get(name, 0.0) for name in STAGE_NAMES],
        )
        self._updates = frame.corrective_updates
        if frame.tracked:
            row |= dict(
                vertices=frame.vertices,
                rigid=frame.rigid,
                coefficients=frame.coefficients,
                coefficients_initial=frame.coefficients_initial,
                sample_state=int(frame.sample_state),
                residual=np.nan_to_num(frame.residual),
                anchor_distance=np.nan_to_num(frame.anchor_distance),
                adaptive_distance=np.nan_to_num(frame.adaptive_distance),
            )
            row |= {stage: frame.in_camera(getattr(frame, stage)) for stage in self._stages}
        self._write(row, "" if frame.tracked else frame.reason)

    def skip(self, timestamp: float, reason: str) -> None:
        """Take note of a broken frame, which was not tracked."""
        self._write(dict(timestamps=timestamp, skipped=True, corrective_updates=self._updates), reason)

    def _write(self, row: dict[str, object], reason: str) -> None:
        if self.done == len(self._rows["tracked"]):
            more = self.done // 2 + 30
            for name, array in self._rows.items():
                self._rows[name] = np.concatenate([array, np.zeros((more, *array.shape[1:]), array.dtype)])
        for name, value in row.items():
            self._rows[name][self.done] = value
        self._reasons.append(reason)
        self.done += 1

    def finish(self, correctives: np.ndarray | None = None) -> Result:
        """The frames so far; those that are not tracked repeat the last tracked one.

        ``correctives`` (3n, K): the corrective shapes over the n frontal vertices, as the tracker keeps them.
        """
        rows = {name: array[: self.done] for name, array in self._rows.items()}
        self._fill_gaps(rows)
        actor = self.actor
        return Result(
            triangles=actor.triangles.astype(np.int32),
            frontal=actor.frontal.astype(bool),
            expression_names=self._names,
            feature_vertices=actor.feature_vertices.astype(np.int32),
            feature_ids=actor.feature_ids.astype(np.int32),
            reasons=tuple(self._reasons[: self.done]),
            stage_names=STAGE_NAMES,
            parameters=self.parameters.to_json(),
            correctives=None if correctives is None else self._on_whole_mesh(correctives),
            colour_only=self.colour_only,
            **rows,
        )

    def _on_whole_mesh(self, correctives: np.ndarray) -> np.ndarray:
        shapes = np.zeros((correctives.shape[1], len(self.actor.neutral), 3), np.float32)
        shapes[:, self.actor.frontal] = correctives.T.reshape(len(shapes), int(self.actor.frontal.sum()), 3)
        return shapes

    def _fill_gaps(self, rows: dict[str, np.ndarray]) -> None:
        meshes = ("vertices", *self._stages)
        tracked = np.flatnonzero(rows["tracked"])
        if not len(tracked):
            for name in meshes:
                rows[name][:] = self.actor.neutral
            rows["rigid"][:] = np.eye(4)
            return
        last = tracked[np.maximum(np.searchsorted(tracked, np.arange(self.done), side="right") - 1, 0)]
        for index in np.flatnonzero(~rows["tracked"]):
            for name in (*meshes, "rigid", "coefficients", "coefficients_initial"):
                rows[name][index] = rows[name][last[index]]
