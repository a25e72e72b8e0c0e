"""What the report needs of a tracked performance, from the tracker's frames or from a result with the same arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import AdaptiveFaceError
from ..parameters import Parameters
from ..runtime.timing import clean_times
from ..tracking.held_out import warn
from ..tracking.types import STAGE_NAMES
from ..tracking.verdict import verdict


@dataclass(frozen=True)
class RunRecord:
    """One entry per frame of the source, as in ``result.npz``; F frames, N vertices, A expressions, S timed stages.

    index (F,) number in the source; vertices (F, N, 3) float32 final mesh v4 in the camera frame, mm; head_pose (F, 4, 4);
    tracked (F,) bool; timestamps (F,) s; coefficients, coefficients_initial (F, A); corrective_updates (F,);
    sample_state (F,); stage_ms (F, S) with stage_names (S,); anchor_distance, adaptive_distance (F,) mm, NaN where
    unknown; reasons (F,) why a frame is not tracked, "" where it is; parameters of the run;
    colour_only: tracked without depth; skipped (F,) bool: broken frames, None where there are none;
    held_out (F, R) error of the landmarks that no fit used, %, by region of held_out_regions (R,), or None.
    """

    index: np.ndarray
    vertices: np.ndarray
    head_pose: np.ndarray
    tracked: np.ndarray
    timestamps: np.ndarray
    coefficients: np.ndarray
    coefficients_initial: np.ndarray
    corrective_updates: np.ndarray
    sample_state: np.ndarray
    stage_ms: np.ndarray
    stage_names: tuple[str, ...]
    anchor_distance: np.ndarray
    adaptive_distance: np.ndarray
    reasons: tuple[str, ...]
    parameters: Parameters
    colour_only: bool = False
    skipped: np.ndarray | None = None
    held_out: np.ndarray | None = None
    held_out_regions: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.tracked)

    @classmethod
    def of(cls, result, parameters: Parameters | None = None) -> RunRecord:
        """From an object with the arrays of ``result.npz`` as attributes, or from an iterable of ``TrackedFrame``.

        ``parameters`` of the run: by default the result's own, or the package's defaults. Raises
        :class:`AdaptiveFaceError` for an empty run.
        """
        if isinstance(result, cls):
            return result
        build = cls._of_arrays if hasattr(result, "vertices") else cls._of_frames
        record = build(result, parameters)
        if not len(record):
            raise AdaptiveFaceError("the run holds no frame, so there is nothing to report")
        return record

    @classmethod
    def _of_arrays(cls, result, parameters: Parameters | None) -> RunRecord:
        count = len(result.tracked)
        unknown = np.full(count, np.nan)
        if parameters is None:
            text = getattr(result, "parameters", None)
            parameters = text if isinstance(text, Parameters) else Parameters.from_json(str(text or "{}"))
        reasons = getattr(result, "reasons", None)
        return cls(
            np.arange(count),
            result.vertices,
            result.head_pose,
            np.asarray(result.tracked, bool),
            clean_times(result.timestamps).seconds,
            result.coefficients,
            result.coefficients_initial,
            result.corrective_updates,
            result.sample_state,
            result.stage_ms,
            tuple(str(name) for name in result.stage_names),
            getattr(result, "anchor_distance", unknown),
            getattr(result, "adaptive_distance", unknown),
            tuple(map(str, reasons)) if reasons is not None else ("",) * count,
            parameters,
            bool(getattr(result, "colour_only", False)),
            getattr(result, "skipped", None),
            getattr(result, "held_out", None),
            tuple(getattr(result, "held_out_regions", ())),
        )

    @classmethod
    def _of_frames(cls, frames, parameters: Parameters | None) -> RunRecord:
        frames = list(frames)
        # A lost frame may have stopped before a stage ran: its time there is unknown, not zero.
        stage_ms = [[frame.stage_ms.get(name, np.nan) for name in STAGE_NAMES] for frame in frames]

        def column(name: str, kind=float) -> np.ndarray:
            return np.array([getattr(frame, name) for frame in frames], kind)

        return cls(
            column("index", int),
            column("vertices", np.float32),
            column("head_pose"),
            column("tracked", bool),
            clean_times(column("timestamp")).seconds,
            column("coefficients"),
            column("coefficients_initial"),
            column("corrective_updates", int),
            column("sample_state", int),
            np.array(stage_ms),
            STAGE_NAMES,
            column("anchor_distance"),
            column("adaptive_distance"),
            tuple(frame.reason for frame in frames),
            parameters or Parameters(),
        )

    @property
    def doubt(self) -> str:
        """What has to be said first (:func:`~adaptiveface.tracking.verdict.verdict`), or ""."""
        skipped = [False] * len(self) if self.skipped is None else self.skipped
        first = verdict(self.tracked, skipped, self.reasons)
        return first or ("" if self.held_out is None else warn(self.held_out[self.tracked], self.held_out_regions))

    def initial_vertices(self, index: int, actor) -> np.ndarray:
        """(N, 3) v1 = b0 + B x of one frame in the camera frame, from its initial coefficients (section 4.2)."""
        x = self.coefficients_initial[index]
        head = actor.neutral + np.tensordot(x, actor.blendshapes[: len(x)], axes=1)
        return head @ self.head_pose[index][:3, :3].T + self.head_pose[index][:3, 3]

    def expressive_frames(self, count: int, spacing: int = 5) -> list[int]:
        """Positions of tracked frames that show much and differ, in time order: farthest points of the coefficients.

        ``spacing``: least number of frames between two of them.
        """
        candidates = np.flatnonzero(self.tracked)
        if not len(candidates):
            return []
        x = self.coefficients[candidates]
        chosen: list[int] = []
        distance = np.linalg.norm(x, axis=1)
        while len(chosen) < min(count, len(candidates)) and np.isfinite(distance).any():
            best = int(distance.argmax())
            chosen.append(best)
            distance = np.minimum(distance, np.linalg.norm(x - x[best], axis=1))
            distance[np.abs(candidates - candidates[best]) < spacing] = -np.inf
        return sorted(int(candidates[i]) for i in chosen)

    def liveliest_window(self, length: int) -> range:
        """The stretch of ``length`` frames (fewer when the run is shorter) whose coefficients change most."""
        length = min(length, len(self))
        change = np.abs(np.diff(self.coefficients, axis=0)).sum(axis=1)
        change[~(self.tracked[1:] & self.tracked[:-1])] = 0
        total = np.concatenate([[0.0], np.cumsum(change)])
        score = total[length - 1 :] - total[: len(total) - length + 1]
        start = int(score.argmax())
        return range(start, start + length)
