"""Result files: everything a tracked performance leaves behind, frame by frame, in one ``result.npz``."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from .actor import Actor
from .errors import FileFormatError
from .files import blocks
from .npz import Field, check_indices, load_checked, write_npz
from .parameters import Parameters
from .renamed import renamed
from .result_access import ResultAccess
from .rows import HEAD, REASON, ROWS, FileRows, MemoryRows, read_rows, row_type
from .tracking.held_out import HeldOut, describe, warn
from .tracking.types import STAGE_NAMES, SampleState, TrackedFrame
from .tracking.verdict import face_seen, verdict

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
    "mirrored": Field((), "b", optional=True),
    "turned": Field((), "iu", optional=True),
    "gaze": Field(("F", 2, 2), optional=True),
    "gaze_known": Field(("F", 2), "b", optional=True),
    "held_out": Field(("F", "R"), optional=True),
    "held_out_regions": Field(("R",), "U", optional=True),
}

#: Meshes of every frame, which stay on the disk in long takes.
MESHES = ("vertices", "v1", "v2", "v3")
_HEAD_FIELDS = {
    name: _FIELDS[name]
    for name in (
        "triangles",
        "frontal",
        "expression_names",
        "feature_vertices",
        "feature_ids",
        "stage_names",
        "parameters",
        "colour_only",
        "held_out_regions",
    )
}
_HEAD_FIELDS |= {"neutral": Field(("N", 3)), "stages": Field((), "b")}

#: What the file calls ``head_pose``.
POSE = "rigid"

#: How everything that people read calls a result that was tracked without depth.
COLOUR_ONLY = "colour only: no depth, degraded"


@renamed
@dataclass(frozen=True, repr=False)
class Result(ResultAccess):
    """A tracked performance of F frames, N vertices, A expressions, S stages; one entry per frame of the source.

    vertices (F, N, 3) float32: final mesh v4 in the camera frame, mm; v1, v2, v3 likewise, or None; triangles (T, 3)
    int32; frontal (N,) bool; timestamps (F,) s; head_pose (F, 4, 4) head to camera; coefficients (F, A) re-solved and
    coefficients_initial (F, A); expression_names (A,); feature_vertices, feature_ids (40,); corrective_updates (F,) PCA
    updates so far; sample_state (F,) of :class:`SampleState`; residual, anchor_distance, adaptive_distance (F,) mm;
    stage_ms (F, S), stage_names (S,); parameters: JSON of every parameter.

    tracked (F,) bool: the face was tracked; skipped (F,) bool: the frame was broken and never reached the tracker;
    reasons (F,): why a frame is not tracked, "" where it is. A frame that is not tracked repeats mesh, pose and
    coefficients of the last tracked one (before the first one: of the first one; without any: the neutral, unmoved),
    has sample state UNTRACKED, and 0 for its distances. correctives (K, N, 3) or None: the corrective shapes as learned
    at the end, orthonormal, zero outside the frontal region. colour_only: tracked without depth, a degraded mode.
    held_out (F, R) or None: error of the landmarks that no fit used, by region of held_out_regions (R,), % of the eyes'
    distance, 0 where nothing was detected (:mod:`~adaptiveface.tracking.held_out`).
    gaze (F, 2, 2) or None: yaw to the subject's left and pitch upwards, rad, of the left and of the right eye, and
    gaze_known (F, 2): measured in this frame, else held (:mod:`adaptiveface.gaze`).
    mirrored, turned: the source's frames were flipped, and then turned by so many quarters anticlockwise, before they were
    tracked; :func:`~adaptiveface.sensors.orientation.as_tracked` does the same with a source.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    frontal: np.ndarray
    tracked: np.ndarray
    skipped: np.ndarray
    timestamps: np.ndarray
    head_pose: np.ndarray
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
    mirrored: bool = False
    turned: int = 0
    held_out: np.ndarray | None = None
    held_out_regions: tuple[str, ...] = ()
    gaze: np.ndarray | None = None
    gaze_known: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.vertices)

    def summary(self) -> str:
        """A few lines for people: how many frames were tracked and learned from, and the median time of each stage."""
        lost = int((~self.tracked & ~self.skipped).sum())
        seen = sum(face_seen(reason) for reason, skip in zip(self.reasons, self.skipped, strict=True) if not skip)
        learned = int((self.sample_state == SampleState.LEARNED).sum())
        lines = [
            f"{len(self)} frames: {int(self.tracked.sum())} tracked, {lost - seen} without a face, "
            + (f"{seen} with a face that was not tracked, " if seen else "")
            + f"{int(self.skipped.sum())} broken and skipped; learned from {learned}"
        ]
        if self.colour_only:
            lines.insert(0, f"{COLOUR_ONLY} (2D features alone; size and distance assumed, nothing learned)")
        if self.held_out is not None and (doubt := warn(self.held_out[self.tracked], self.held_out_regions)):
            lines.insert(0, doubt)
        if doubt := verdict(self.tracked, self.skipped, self.reasons):
            lines.insert(0, doubt)
        broken = [reason for reason, skipped in zip(self.reasons, self.skipped, strict=True) if skipped]
        lines += [f"  skipped: {reason}" for reason in broken[:5]]
        lines += [f"  ... and {len(broken) - 5} more"] if len(broken) > 5 else []
        if self.tracked.any():
            median = np.median(self.stage_ms[self.tracked], axis=0)
            total = np.median(self.stage_ms[self.tracked].sum(axis=1))
            stages = ", ".join(f"{name} {ms:.1f}" for name, ms in zip(self.stage_names, median, strict=True))
            lines.append(f"median ms per frame: {total:.1f} ({stages})")
        if self.held_out is not None and (fit := describe(self.held_out[self.tracked], self.held_out_regions)):
            lines.append(fit)
        return "\n".join(lines)

    def save(self, path: str | os.PathLike) -> None:
        """Write ``result.npz`` (uncompressed: coordinates hardly shrink), whole or not at all."""
        arrays = {entry.name: getattr(self, entry.name) for entry in fields(self)}
        arrays[POSE] = arrays.pop("head_pose")
        if self.held_out is None:
            del arrays["held_out_regions"]
        write_npz(path, {name: value for name, value in arrays.items() if value is not None})

    @classmethod
    def load(cls, path: str | os.PathLike) -> Result:
        """Read ``result.npz``, or the ``result.unfinished`` that a run left which was killed.

        Meshes of long takes stay on the disk (``vertices`` is then a read-only map of the file): walk over them with
        :func:`adaptiveface.files.blocks`. Raises :class:`FileFormatError` naming the file and the array.
        """
        path = Path(path)
        if path.is_dir():
            return _of_unfinished(path)
        data = load_checked(path, _FIELDS, mapped=MESHES)
        n_frames, n_vertices = data["vertices"].shape[:2]
        for name in ("triangles", "feature_vertices"):
            check_indices(path, name, data[name], n_vertices)
            data[name] = data[name].astype(np.int32)
        states = [int(state) for state in SampleState]
        if not np.isin(data["sample_state"], states).all():
            raise FileFormatError(f"{path}: array 'sample_state' holds values other than {states}")
        data.setdefault("reasons", np.full(n_frames, ""))
        data.setdefault("skipped", np.zeros(n_frames, bool))
        for name in ("residual", "anchor_distance", "adaptive_distance"):
            data.setdefault(name, np.zeros(n_frames, np.float32))
        return cls(**_as_attributes(data))


def _of_unfinished(folder: Path) -> Result:
    head = load_checked(folder / HEAD, _HEAD_FIELDS, max_bytes=1 << 30)
    for name in ("triangles", "feature_vertices"):
        check_indices(folder / HEAD, name, head[name], len(head["neutral"]))
    rows = read_rows(folder, _row_type(head))
    for _, block in blocks(rows):
        for name in block.dtype.names:
            if block[name].dtype.kind == "f" and not np.isfinite(block[name]).all():
                raise FileFormatError(f"{folder / ROWS}: '{name}' holds NaN or infinite values")
    return _of_rows(rows, head)


class ResultBuilder:
    """Collects a run frame by frame; 0.09 MB per frame of 7,053 vertices, four times that with the stages.

    ``add`` or ``skip`` once per frame in order, then ``finish`` (at any time: frames not reached are left out). More
    frames than ``n_frames`` make it grow. ``folder``: keep the rows in files there (see :mod:`adaptiveface.rows`), in
    bounded memory and safe from whatever ends the process; :func:`adaptiveface.rows.discard` it once the result is saved.
    """

    def __init__(
        self,
        actor: Actor,
        parameters: Parameters,
        n_frames: int,
        keep_stages: bool = False,
        colour_only: bool = False,
        folder: Path | None = None,
    ) -> None:
        self.actor, self._stages, self._updates = actor, ("v1", "v2", "v3") if keep_stages else (), 0
        self._head = {
            "triangles": actor.triangles.astype(np.int32),
            "frontal": actor.frontal.astype(bool),
            "expression_names": np.array(actor.expression_names[: parameters.blendshapes.A]),
            "feature_vertices": actor.feature_vertices.astype(np.int32),
            "feature_ids": actor.feature_ids.astype(np.int32),
            "stage_names": np.array(STAGE_NAMES),
            "parameters": np.array(parameters.to_json()),
            "colour_only": np.array(colour_only),
            "neutral": actor.neutral.astype(np.float32),
            "stages": np.array(bool(keep_stages)),
        }
        if regions := HeldOut(actor).regions:
            self._head["held_out_regions"] = np.array(regions)
        self.mirrored, self.turned = False, 0
        self._type = _row_type(self._head)
        self._rows = MemoryRows(self._type, n_frames) if folder is None else FileRows(self._type, folder, self._head)

    @property
    def done(self) -> int:
        """How many frames there are."""
        return len(self._rows)

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
                rigid=frame.head_pose,
                coefficients=frame.coefficients,
                coefficients_initial=frame.coefficients_initial,
                sample_state=int(frame.sample_state),
                residual=np.nan_to_num(frame.residual),
                anchor_distance=np.nan_to_num(frame.anchor_distance),
                adaptive_distance=np.nan_to_num(frame.adaptive_distance),
            )
            if len(frame.held_out) and "held_out" in self._type.names:
                row["held_out"] = frame.held_out
            row |= {stage: frame.in_camera(getattr(frame, stage)) for stage in self._stages}
        self._write(row, "" if frame.tracked else frame.reason)

    def skip(self, timestamp: float, reason: str) -> None:
        """Take note of a broken frame, which was not tracked."""
        self._write(dict(timestamps=timestamp, skipped=True, corrective_updates=self._updates), reason)

    def _write(self, values: dict[str, object], reason: str) -> None:
        row = np.zeros((), self._type)
        for name, value in values.items():
            row[name] = value
        row["reasons"] = reason if len(reason) <= REASON else f"{reason[: REASON - 3]}..."
        self._rows.append(row)

    def finish(self, correctives: np.ndarray | None = None) -> Result:
        """The frames so far; those that are not tracked repeat the last tracked one.

        ``correctives`` (3n, K): the corrective shapes over the n frontal vertices, as the tracker keeps them.
        """
        self._rows.close()
        head = self._head | {"mirrored": np.array(self.mirrored), "turned": np.array(self.turned)}
        return _of_rows(self._rows.all(), head, None if correctives is None else self._on_whole_mesh(correctives))

    def _on_whole_mesh(self, correctives: np.ndarray) -> np.ndarray:
        shapes = np.zeros((correctives.shape[1], len(self.actor.neutral), 3), np.float32)
        shapes[:, self.actor.frontal] = correctives.T.reshape(len(shapes), int(self.actor.frontal.sum()), 3)
        return shapes


def _row_type(head: dict[str, np.ndarray]) -> np.dtype:
    meshes = MESHES if head["stages"] else MESHES[:1]
    regions = len(head.get("held_out_regions", ()))
    return row_type(len(head["neutral"]), len(head["expression_names"]), len(head["stage_names"]), meshes, regions)


def _of_rows(rows: np.ndarray, head: dict[str, np.ndarray], correctives: np.ndarray | None = None) -> Result:
    """The result of rows (F,), in which frames that are not tracked are filled in."""
    names = [name for name in rows.dtype.names if name not in MESHES]
    small = {name: np.empty((len(rows), *rows.dtype[name].shape), rows.dtype[name].base) for name in names}
    for part, block in blocks(rows):
        for name in names:
            small[name][part] = block[name]
    meshes = {name: rows[name] for name in MESHES if name in rows.dtype.names}
    _fill_gaps(small, meshes, head["neutral"])
    shared = {name: value for name, value in head.items() if name not in ("neutral", "stages")}
    return Result(**_as_attributes(shared | small | meshes), correctives=correctives)


def _fill_gaps(small: dict[str, np.ndarray], meshes: dict[str, np.ndarray], neutral: np.ndarray) -> None:
    tracked, count = np.flatnonzero(small["tracked"]), len(small["tracked"])
    if not len(tracked):
        for mesh in meshes.values():
            mesh[:] = neutral
        small["rigid"][:] = np.eye(4)
        return
    last = tracked[np.maximum(np.searchsorted(tracked, np.arange(count), side="right") - 1, 0)]
    for name in ("rigid", "coefficients", "coefficients_initial"):
        small[name][:] = small[name][last]
    for index in np.flatnonzero(~small["tracked"]):
        for mesh in meshes.values():
            mesh[index] = mesh[last[index]]


def _as_attributes(data: dict) -> dict:
    """Arrays of text as the attributes of a :class:`Result`."""
    for name in ("expression_names", "stage_names", "reasons", "held_out_regions"):
        data[name] = tuple(str(text) for text in data.get(name, ()))
    if not data["held_out_regions"]:
        data.pop("held_out", None)
    data["head_pose"] = data.pop(POSE)
    data["parameters"] = str(data["parameters"])
    data["colour_only"], data["mirrored"] = (bool(data.get(name, False)) for name in ("colour_only", "mirrored"))
    data["turned"] = int(data.get("turned", 0)) % 4
    return data
