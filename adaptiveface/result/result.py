"""Save and load the result of a tracked performance, frame by frame, in one ``result.npz``."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError, ParameterError
from ..files import blocks
from ..files.npz import Field, check_indices, load_checked, write_npz
from ..files.records import array, arrays, by_attribute, checks, read, record, row_dtype
from ..model.actor import Actor
from ..parameters import Parameters
from ..renamed import renamed
from ..tracking.held_out import HeldOut, describe, warn
from ..tracking.types import STAGE_NAMES, SampleState, TrackedFrame
from ..tracking.verdict import face_seen, verdict
from .access import ResultAccess
from .rows import HEAD, REASON, ROWS, FileRows, MemoryRows, read_rows

#: The name of results that were tracked without depth, in everything that people read.
COLOUR_ONLY = "colour only: no depth, degraded"


#: Meshes of every frame. In long takes they stay on the disk.
MESHES = ("vertices", "v1", "v2", "v3")
_KEPT = "camera frame, with `--keep-stages`"


@renamed
@record
@dataclass(frozen=True, repr=False)
class Result(ResultAccess):
    """A tracked performance, with one entry per frame of the source.

    Shapes: F frames, N vertices, T triangles, A expressions, S stages, K correctives, R regions of held-out landmarks.

    A frame that is not tracked repeats mesh, pose and coefficients of the last tracked frame, or of the first tracked one if
    there is none before it. Without any tracked frame, it has the neutral without motion. Its sample state is UNTRACKED, and
    its distances are 0. :func:`~adaptiveface.sensors.orientation.as_tracked` turns a source as ``mirrored`` and ``turned`` say.
    """

    vertices: np.ndarray = array("F N 3", doc="final mesh v4, camera frame", unit="mm")
    triangles: np.ndarray = array("T 3", "i4", "vertex numbers", below="N")
    frontal: np.ndarray = array("N", "b", "the deformed region")
    tracked: np.ndarray = array("F", "b", "the face was tracked")
    skipped: np.ndarray = array("F", "b", "the frame was broken and never reached the tracker", optional=True)
    timestamps: np.ndarray = array("F", "f8", "times of the frames", unit="s")
    head_pose: np.ndarray = array("F 4 4", doc="head to camera", unit="mm", name="rigid")
    coefficients: np.ndarray = array("F A", doc="re-solved from the final mesh (section 6)")
    coefficients_initial: np.ndarray = array("F A", doc="of the first fit (section 4.2)")
    expression_names: tuple[str, ...] = array("A", "U", "names of the expressions")
    feature_vertices: np.ndarray = array("40", "i4", "the vertex nearest to each feature", below="N")
    feature_ids: np.ndarray = array("40", "i4", "iBUG-68 numbers of the features")
    corrective_updates: np.ndarray = array("F", "i4", "PCA updates so far")
    sample_state: np.ndarray = array(
        "F",
        "i1",
        "0 untracked, 1 in the anchor space, 2 learned, 3 outlier, 4 not learned: too much of the face hidden or without depth",
    )
    residual: np.ndarray = array("F", doc="mean point-to-plane distance of the rigid fit", unit="mm", optional=True)
    anchor_distance: np.ndarray = array(
        "F",
        doc="mean distance of v2 from the anchor space, before the frame is learned from (figure 11)",
        unit="mm",
        optional=True,
    )
    adaptive_distance: np.ndarray = array("F", doc="the same from the adaptive space", unit="mm", optional=True)
    reasons: tuple[str, ...] = array("F", "U", "why a frame is not tracked, or empty", optional=True)
    stage_ms: np.ndarray = array("F S", doc="time per stage", unit="ms")
    stage_names: tuple[str, ...] = array("S", "U", "names of the stages")
    parameters: str = array("", "U", "JSON of every parameter")
    v1: np.ndarray | None = array("F N 3", doc=f"initial blendshapes, {_KEPT}", unit="mm", optional=True, default=None)
    v2: np.ndarray | None = array("F N 3", doc=f"Laplacian-deformed, {_KEPT}", unit="mm", optional=True, default=None)
    v3: np.ndarray | None = array(
        "F N 3", doc=f"projected on the adaptive space, {_KEPT}", unit="mm", optional=True, default=None
    )
    correctives: np.ndarray | None = array(
        "K N 3",
        doc="corrective shapes as learned at the end, orthonormal, zero outside the frontal region",
        optional=True,
        default=None,
    )
    expressions: np.ndarray | None = array(
        "A N 3",
        doc="displacements of the expressions at the end, to which the coefficients belong; absent: those of `actor.npz`",
        unit="mm",
        optional=True,
        default=None,
    )
    colour_only: bool = array("", "b", "tracked without depth, a degraded mode", optional=True, default=False)
    mirrored: bool = array("", "b", "frames were flipped (`--mirrored`) before they were tracked", optional=True, default=False)
    turned: int = array("", "i4", "then they were turned by so many quarters anticlockwise", optional=True, default=0)
    held_out: np.ndarray | None = array(
        "F R",
        doc="error of the landmarks that no fit used, % of the eyes' distance, 0 where nothing was detected",
        optional=True,
        default=None,
    )
    held_out_regions: tuple[str, ...] = array("R", "U", "their regions", optional=True, default=())
    gaze: np.ndarray | None = array(
        "F 2 2",
        doc="yaw to the subject's left and pitch upwards of the left and of the right eye, where the detector saw irises",
        unit="rad",
        optional=True,
        default=None,
    )
    gaze_known: np.ndarray | None = array(
        "F 2", "b", "the gaze was measured in this frame; otherwise it is held", optional=True, default=None
    )

    def __len__(self) -> int:
        return len(self.vertices)

    @classmethod
    def of_frames(
        cls,
        frames: Iterable[TrackedFrame],
        actor: Actor,
        parameters: Parameters | None = None,
        correctives: np.ndarray | None = None,
        expressions: np.ndarray | None = None,
        keep_stages: bool = False,
    ) -> Result:
        """Make the result of tracked frames.

        Parameters
        ----------
        frames : iterable of TrackedFrame
            One for every frame of the source, in order.
        actor : Actor
            The rig that was tracked.
        parameters : Parameters, optional
            Of the tracker; our defaults without.
        correctives : (3n, K), optional
            The tracker's corrective shapes at the end, over the n frontal vertices.
        expressions : (A, N, 3), optional
            The tracker's expressions at the end, mm; those of the actor by default.
        keep_stages : bool
            Whether to keep the meshes v1, v2 and v3, too.

        Returns
        -------
        Result
            Of all frames.

        Raises
        ------
        ParameterError
            A frame is missing or out of order.
        """
        frames = list(frames)
        builder = ResultBuilder(actor, parameters or Parameters(), len(frames), keep_stages)
        for number, frame in enumerate(frames):
            if frame.index != number:
                raise ParameterError(f"frame {frame.index} is in place {number}: a result needs every frame of its source")
            builder.add(frame)
        return builder.finish(correctives, expressions)

    @property
    def doubt(self) -> str:
        """The most important warning: too few frames are tracked, or the face does not fit; "" if there is none."""
        first = verdict(self.tracked, self.skipped, self.reasons)
        return first or ("" if self.held_out is None else warn(self.held_out[self.tracked], self.held_out_regions))

    def summary(self) -> str:
        """Describe in a few lines how many frames were tracked and learned from, and the median time of each stage."""
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
        """Write ``result.npz`` completely or not at all. It is not compressed, because coordinates hardly shrink."""
        known = arrays(self)
        if self.held_out is None:
            del known["held_out_regions"]
        write_npz(path, known)

    @classmethod
    def load(cls, path: str | os.PathLike) -> Result:
        """Read ``result.npz``, or the folder ``result.unfinished`` of a run that was killed.

        The meshes of long takes stay on the disk, and ``vertices`` is then a read-only map of the file. Read them in parts with
        :func:`adaptiveface.files.blocks`.

        Parameters
        ----------
        path : path-like
            The file or the folder.

        Returns
        -------
        Result
            The performance.

        Raises
        ------
        FileFormatError
            The message names the file and the array.
        """
        path = Path(path)
        if path.is_dir():
            return _of_unfinished(path)
        data = read(cls, path, mapped=MESHES)
        count, states = len(data["vertices"]), [int(state) for state in SampleState]
        if not np.isin(data["sample_state"], states).all():
            raise FileFormatError(f"{path}: array 'sample_state' holds values other than {states}")
        data.setdefault("reasons", ("",) * count)
        data.setdefault("skipped", np.zeros(count, bool))
        for name in ("residual", "anchor_distance", "adaptive_distance"):
            data.setdefault(name, np.zeros(count, np.float32))
        return cls(**_consistent(data))


#: Order of a row's arrays in ``rows.bin``: by their size, so that they are aligned.
_ROW: tuple[str, ...] = ("timestamps", *MESHES, "rigid", "coefficients", "coefficients_initial", "stage_ms", "residual")
_ROW += ("anchor_distance", "adaptive_distance", "held_out", "corrective_updates", "reasons")
_ROW += ("sample_state", "tracked", "skipped")
#: Arrays that are known only when the run ends.
_AT_THE_END = ("correctives", "expressions")
#: Arrays that a run writes beside its rows before it ends. Frames without a face need the neutral.
_HEAD = {name: entry for name, entry in checks(Result).items() if "F" not in entry.shape and name not in _AT_THE_END}
_HEAD |= {"neutral": Field(("N", 3)), "stages": Field((), "b")}


def _of_unfinished(folder: Path) -> Result:
    head = load_checked(folder / HEAD, _HEAD, max_bytes=1 << 30)
    for name in ("triangles", "feature_vertices"):
        check_indices(folder / HEAD, name, head[name], len(head["neutral"]))
    rows = read_rows(folder, _row_type(head))
    for _, block in blocks(rows):
        for name in block.dtype.names or ():
            if block[name].dtype.kind == "f" and not np.isfinite(block[name]).all():
                raise FileFormatError(f"{folder / ROWS}: '{name}' holds NaN or infinite values")
    return _of_rows(rows, head)


class ResultBuilder:
    """Collects a run frame by frame: 0.09 MB per frame of 7,053 vertices, and four times as much with the stages.

    Call ``add`` or ``skip`` once per frame in order, and ``finish`` at any time. Frames that were not reached are left out.

    Parameters
    ----------
    actor : Actor
        The rig that is tracked.
    parameters : Parameters
        Of the tracker.
    n_frames : int
        Expected number of frames. More frames make the builder grow.
    keep_stages : bool
        Whether to keep the meshes v1, v2 and v3, too.
    colour_only : bool
        Whether the source has no depth.
    folder : pathlib.Path, optional
        Where the rows are stored as files (:mod:`adaptiveface.result.rows`), so that memory is bounded and nothing is lost if
        the process ends. Call :func:`adaptiveface.result.rows.discard` when the result is saved.
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
        """Number of frames so far."""
        return len(self._rows)

    def add(self, frame: TrackedFrame) -> None:
        """Add the next frame, tracked or not."""
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
            if len(frame.held_out) and "held_out" in (self._type.names or ()):
                row["held_out"] = frame.held_out
            row |= {stage: frame.in_camera(getattr(frame, stage)) for stage in self._stages}
        self._write(row, "" if frame.tracked else frame.reason)

    def skip(self, timestamp: float, reason: str) -> None:
        """Add a broken frame, which was not tracked."""
        self._write(dict(timestamps=timestamp, skipped=True, corrective_updates=self._updates), reason)

    def _write(self, values: dict[str, object], reason: str) -> None:
        row = np.zeros((), self._type)
        for name, value in values.items():
            row[name] = value
        row["reasons"] = reason if len(reason) <= REASON else f"{reason[: REASON - 3]}..."
        self._rows.append(row)

    def finish(self, correctives: np.ndarray | None = None, expressions: np.ndarray | None = None) -> Result:
        """Return the frames so far, in which untracked frames repeat the last tracked one.

        Parameters
        ----------
        correctives : (3n, K), optional
            The tracker's corrective shapes over the n frontal vertices.
        expressions : (A, N, 3), optional
            The tracker's expressions at the end, mm (:attr:`.Tracker.expressions`).

        Returns
        -------
        Result
            Of these frames.
        """
        self._rows.close()
        head = self._head | {"mirrored": np.array(self.mirrored), "turned": np.array(self.turned)}
        learned = {
            "correctives": None if correctives is None else self._on_whole_mesh(correctives),
            "expressions": None if expressions is None else expressions.astype(np.float32),
        }
        return _of_rows(self._rows.all(), head, learned)

    def _on_whole_mesh(self, correctives: np.ndarray) -> np.ndarray:
        shapes = np.zeros((correctives.shape[1], len(self.actor.neutral), 3), np.float32)
        shapes[:, self.actor.frontal] = correctives.T.reshape(len(shapes), int(self.actor.frontal.sum()), 3)
        return shapes


def _row_type(head: dict[str, np.ndarray]) -> np.dtype:
    sizes = {"N": len(head["neutral"]), "A": len(head["expression_names"]), "S": len(head["stage_names"])}
    sizes["R"] = len(head.get("held_out_regions", ()))
    left_out = {*(() if head["stages"] else MESHES[1:]), *(() if sizes["R"] else ("held_out",))}
    return row_dtype(Result, [name for name in _ROW if name not in left_out], sizes, REASON)


def _of_rows(rows: np.ndarray, head: dict[str, np.ndarray], learned: dict[str, Any] | None = None) -> Result:
    """Make the result of rows (F,), and fill in the untracked frames. ``learned`` are the arrays known at the end."""
    every = rows.dtype.names or ()
    names = [name for name in every if name not in MESHES]
    small = {name: np.empty((len(rows), *rows.dtype[name].shape), rows.dtype[name].base) for name in names}
    for part, block in blocks(rows):
        for name in names:
            small[name][part] = block[name]
    meshes = {name: rows[name] for name in MESHES if name in every}
    _fill_gaps(small, meshes, head["neutral"])
    shared = {name: value for name, value in head.items() if name not in ("neutral", "stages")}
    data = by_attribute(Result, "the rows", shared | small | meshes)
    return Result(**_consistent(data), **learned or {})


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


def _consistent(data: dict[str, Any]) -> dict[str, Any]:
    """Remove attributes of a :class:`Result` that have no meaning alone."""
    if not data.get("held_out_regions"):
        data.pop("held_out", None)
    data["turned"] = data.get("turned", 0) % 4
    return data
