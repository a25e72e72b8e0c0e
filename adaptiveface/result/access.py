"""Read a result in Python frame by frame, by name, and as tables."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Self, cast, overload

import numpy as np

from ..errors import FileFormatError, MissingExtraError, ParameterError
from ..files import release
from ..files.records import declared
from ..geometry.mesh import transform_points
from ..geometry.polydata import correctives, surface
from ..renamed import renamed

if TYPE_CHECKING:
    from pandas import DataFrame

    from ..geometry.polydata import PolyData
    from ..model.actor import Actor


@renamed
@dataclass(frozen=True, repr=False)
class ResultFrame:
    """One frame of a result, ``result[index]``.

    The arrays of a frame that is not tracked are those of the last tracked one.

    Attributes
    ----------
    index : int
        Number of the frame.
    timestamp : float
        Seconds.
    tracked : bool
        Whether the face was tracked in this frame.
    reason : str
        Why it was not, or "".
    head_pose : (4, 4)
        Head frame to camera frame, mm.
    camera_vertices : (N, 3)
        The final mesh v4 in the camera frame (x right, y down, z forward), mm.
    coefficients : (A,)
        Of the expressions ``expression_names``.
    """

    index: int
    timestamp: float
    tracked: bool
    reason: str
    head_pose: np.ndarray
    camera_vertices: np.ndarray
    triangles: np.ndarray
    coefficients: np.ndarray
    expression_names: tuple[str, ...]

    @property
    def head_vertices(self) -> np.ndarray:
        """v4 (N, 3) float64 in the head frame (x to the subject's left, y up, z out of the face), mm."""
        return to_head(self.head_pose, self.camera_vertices)

    @property
    def curves(self) -> dict[str, float]:
        """The re-solved coefficient of each expression by its name, 0 to 1."""
        return dict(zip(self.expression_names, self.coefficients.astype(float).tolist(), strict=True))

    def __repr__(self) -> str:
        state = "tracked" if self.tracked else f"not tracked: {self.reason}" if self.reason else "not tracked"
        return f"ResultFrame({self.index}, {self.timestamp:.3f} s, {state})"


def to_head(head_pose: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Turn camera-frame vertices (N, 3) into the head frame, float64 mm. ``head_pose`` (4, 4) is head to camera."""
    return transform_points(np.linalg.inv(np.asarray(head_pose, float)), np.asarray(vertices, float))


class ResultAccess:
    """Access to the frames of a :class:`~adaptiveface.result.Result`, besides its arrays."""

    if TYPE_CHECKING:  # the fields of Result that are used here
        timestamps: np.ndarray
        tracked: np.ndarray
        reasons: tuple[str, ...]
        head_pose: np.ndarray
        vertices: np.ndarray
        triangles: np.ndarray
        coefficients: np.ndarray
        coefficients_initial: np.ndarray
        expression_names: tuple[str, ...]
        frontal: np.ndarray
        correctives: np.ndarray | None
        expressions: np.ndarray | None
        v1: np.ndarray | None
        v2: np.ndarray | None
        v3: np.ndarray | None

        def __len__(self) -> int: ...

    @overload
    def __getitem__(self, key: int) -> ResultFrame: ...

    @overload
    def __getitem__(self, key: slice) -> Self: ...

    def __getitem__(self, key: int | slice) -> ResultFrame | Self:
        """Return frame ``key`` (negative: from the end), or the result of a slice. Raises :class:`IndexError`."""
        if isinstance(key, slice):
            result = cast(Any, self)
            rows = {name: getattr(self, name) for name, entry in declared(type(result)) if entry.shape[:1] == ("F",)}
            return replace(result, **{name: value[key] for name, value in rows.items() if value is not None})
        index = range(len(self))[key]
        return ResultFrame(
            index,
            float(self.timestamps[index]),
            bool(self.tracked[index]),
            self.reasons[index],
            self.head_pose[index],
            self.vertices[index],
            self.triangles,
            self.coefficients[index],
            self.expression_names,
        )

    def __iter__(self) -> Iterator[ResultFrame]:
        """Yield the frames in order."""
        return (self[index] for index in range(len(self)))

    def __repr__(self) -> str:
        seconds = float(self.timestamps[-1] - self.timestamps[0]) if len(self) else 0.0
        return (
            f"Result({len(self)} frames, {int(self.tracked.sum())} tracked, {seconds:.2f} s, "
            f"{len(self.frontal)} vertices, {len(self.expression_names)} expressions)"
        )

    @property
    def camera_vertices(self) -> np.ndarray:
        """The final meshes v4 (F, N, 3) float32 in the camera frame, mm: another name of the array ``vertices``."""
        return self.vertices

    @property
    def head_vertices(self) -> np.ndarray:
        """The final meshes v4 (F, N, 3) float64 in the head frame, in which the head does not move, mm.

        All frames are computed at once. For a long take, use ``result[i].head_vertices`` or :meth:`head_blocks`.
        """
        return self.head_meshes(np.arange(len(self)))

    def head_meshes(self, frames: np.ndarray) -> np.ndarray:
        """The final meshes v4 (f, N, 3) float64 of the frames with numbers (f,) in the head frame, mm."""
        meshes = np.empty((len(frames), *self.vertices.shape[1:]))
        for mesh, frame in zip(meshes, frames, strict=True):
            mesh[:] = to_head(self.head_pose[frame], self.vertices[frame])
        release(self.vertices)
        return meshes

    def head_blocks(self, size: int = 64) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield ``size`` frames at a time: their slice, and their meshes v4 (f, N, 3) float64 in the head frame, mm."""
        for start in range(0, len(self), size):
            part = slice(start, min(start + size, len(self)))
            yield part, self.head_meshes(np.arange(part.start, part.stop))

    def rig(self, actor: Actor) -> Actor:
        """Return the tracked actor with the expressions to which the coefficients of this result belong.

        Parameters
        ----------
        actor : Actor
            The rig that was tracked. Personal blendshapes started from its expressions.

        Returns
        -------
        Actor
            With the expressions at the end of the run; ``actor`` itself if none were learned.

        Raises
        ------
        FileFormatError
            The actor has another mesh, or lacks an expression.
        """
        if not np.array_equal(actor.triangles, self.triangles):
            raise FileFormatError("actor.npz and result.npz have different meshes: they do not belong together")
        missing = [name for name in self.expression_names if name not in actor.expression_names]
        if missing:
            raise FileFormatError(f"the actor lacks the expressions {', '.join(missing)[:200]}: it is not the result's")
        if self.expressions is None:
            return actor
        blendshapes = actor.blendshapes.copy()
        blendshapes[[actor.expression_names.index(name) for name in self.expression_names]] = self.expressions
        return replace(actor, blendshapes=blendshapes)

    def mesh(self, frame: int, stage: str = "v4", reference: np.ndarray | str = "v1") -> PolyData:
        """Return the mesh of one frame for pyvista.

        Parameters
        ----------
        frame : int
            Its number; negative numbers count from the end.
        stage : str
            "v1" to "v4". All except v4 are only in results with ``--keep-stages``.
        reference : numpy.ndarray or str
            The origin of the displacement: (N, 3) mm in the head frame, such as ``actor.neutral``, or a stage. The
            default is the blendshape fit v1. If v1 was not kept, there is no displacement.

        Returns
        -------
        pyvista.PolyData
            The mesh in mm, with the head at rest: x points out of the face, y to the subject's left, z up. Its arrays are
            ``displacement`` (N, 3) from the reference, its length ``distance`` (N,), the correctives ``corrective 1`` ...
            (N, 3) at the end, each scaled to move up to 1 mm, and ``normals`` (N, 3).

        Raises
        ------
        IndexError
            There is no such frame.
        ParameterError
            There is no such stage, or it was not kept.
        MissingExtraError
            pyvista is not installed.
        """
        index = range(len(self))[frame]
        vertices = self._stage(index, stage)
        if isinstance(reference, str):
            missing = reference == "v1" and self.v1 is None
            origin = None if missing else self._stage(index, reference)
        else:
            origin = reference
        moved = None if origin is None else vertices - origin
        length = None if moved is None else np.linalg.norm(moved, axis=1)
        arrays = correctives(self.correctives)
        return surface(vertices, self.triangles, displacement=moved, distance=length, **arrays)

    def _stage(self, index: int, stage: str) -> np.ndarray:
        """A stage's mesh (N, 3) of a frame in the head frame, mm."""
        meshes = {"v1": self.v1, "v2": self.v2, "v3": self.v3, "v4": self.vertices}
        if stage not in meshes:
            raise ParameterError(f"stage {stage!r} is none of {', '.join(meshes)}")
        mesh = meshes[stage]
        if mesh is None:
            raise ParameterError(f"stage {stage!r} is not in this result: track with --keep-stages")
        return to_head(self.head_pose[index], mesh[index])

    def curves(self, initial: bool = False, gaps: bool = False) -> DataFrame:
        """Return the coefficients as a table with a row per frame, a column per expression, and the time as index.

        Parameters
        ----------
        initial : bool
            Whether to return those of the first fit (section 4.2) instead of those re-solved from the final mesh (section 6).
        gaps : bool
            Whether frames without a tracked face are NaN instead of the last values.

        Returns
        -------
        pandas.DataFrame
            (F, A) float64, 0 to 1. The index is a ``TimedeltaIndex`` named "time", from the source's timestamps.

        Raises
        ------
        MissingExtraError
            pandas is not installed (the extra ``pandas``).
        """
        values = self.coefficients_initial if initial else self.coefficients
        table = time_table(values, self.timestamps, self.expression_names)
        return table.where(np.broadcast_to(self.tracked[:, None], table.shape)) if gaps else table


def time_table(values: np.ndarray, timestamps: np.ndarray, names: tuple[str, ...]) -> DataFrame:
    """Make a ``DataFrame`` of values (F, A) with columns ``names`` and the times (F,) s as index.

    Raises :class:`MissingExtraError` if pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise MissingExtraError("tables need pandas: python -m pip install 'adaptiveface[pandas]'") from None
    index = pandas.to_timedelta(np.asarray(timestamps, float), unit="s").rename("time")
    return pandas.DataFrame(np.asarray(values, float), index=index, columns=list(names))
