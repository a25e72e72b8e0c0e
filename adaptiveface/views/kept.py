"""Keep the results of a whole performance in little memory. Their meshes are rebuilt only when needed."""

from __future__ import annotations

import mmap
import sys
from dataclasses import fields

import numpy as np

from ..model.actor import Actor
from ..tracking.types import TrackedFrame

MESHES = ("v1", "v2", "v3", "v4")
#: How many frames' meshes are held ready: the one on show, and what a preview needs beside it.
READY = 3


def in_own_pages(array: np.ndarray) -> np.ndarray:
    """A copy in pages that go back to the system when it is dropped: hundreds of these would leave holes in the heap."""
    if array.nbytes == 0:
        return array.copy()
    private = {} if sys.platform == "win32" else {"flags": mmap.MAP_PRIVATE | mmap.MAP_ANONYMOUS}
    copy = np.frombuffer(mmap.mmap(-1, array.nbytes, **private), array.dtype).reshape(array.shape)
    copy[...] = array
    return copy


class KeptFrame(TrackedFrame):
    """A tracked frame as it was, with meshes (N, 3) in single precision that :class:`Keeper` makes on demand.

    A copy with changes (``dataclasses.replace``) holds its meshes itself.
    """

    _keeper: Keeper
    _change: np.ndarray | None
    _parts: list[tuple[int, np.ndarray]]

    @classmethod
    def of(cls, result: TrackedFrame, keeper: Keeper, change: np.ndarray | None) -> KeptFrame:
        """The frame ``result`` as its ``keeper`` keeps it; ``change`` as in :meth:`Keeper.keep`."""
        kept = cls.__new__(cls)
        for entry in fields(TrackedFrame):
            if entry.name not in MESHES:
                object.__setattr__(kept, entry.name, getattr(result, entry.name))
        object.__setattr__(kept, "_keeper", keeper)
        object.__setattr__(kept, "_change", change)
        object.__setattr__(kept, "_parts", keeper.parts(result, change))
        return kept

    def __getattr__(self, name: str) -> np.ndarray:
        if name not in MESHES:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        return self._keeper.meshes(self)[MESHES.index(name)]


class Keeper:
    """Holds the data that all frames of one actor share.

    v1 is made of its coefficients where that gives the same numbers. Of the other meshes those vertices are kept that differ
    from the mesh before: the frontal region, or all that an expression moves.
    """

    def __init__(self, actor: Actor) -> None:
        self._neutral = actor.neutral
        self._basis, self._frontal = actor.blendshapes.astype(np.float32), actor.frontal
        self._changed: tuple[np.ndarray | None, np.ndarray] = None, self._basis  # the last change, and the basis with it
        moving = actor.frontal | (actor.blendshapes != 0).any(axis=(0, 2))
        everywhere = np.ones(len(moving), bool)
        self._rows = [
            (np.flatnonzero(~some), np.flatnonzero(some)) for some in (moving & False, actor.frontal, moving, everywhere)
        ]
        self._ready: list[tuple[KeptFrame, tuple[np.ndarray, ...]]] = []

    def keep(self, result: TrackedFrame, change: np.ndarray | None = None) -> KeptFrame:
        """Return a result in the form to keep. The meshes of the last few need no rebuilding.

        ``change`` (A, n, 3): what personal blendshapes had changed in the expressions, mm; another one costs memory only.
        """
        return result if isinstance(result, KeptFrame) else KeptFrame.of(result, self, change)

    def parts(self, result: TrackedFrame, change: np.ndarray | None) -> list[tuple[int, np.ndarray]]:
        """For every mesh, the rows that differ from the previous mesh, and their values in float32."""
        before, out = self._shape(result.coefficients_initial, change), []
        for name in MESHES:
            mesh = getattr(result, name).astype(np.float32)
            which = next(k for k, (same, _) in enumerate(self._rows) if np.array_equal(mesh[same], before[same]))
            out.append((which, in_own_pages(mesh[self._rows[which][1]])))
            before = mesh
        return out

    def meshes(self, kept: KeptFrame) -> tuple[np.ndarray, ...]:
        """v1 to v4 of a frame, (N, 3) float32."""
        for known, meshes in self._ready:
            if known is kept:
                return meshes
        mesh, out = self._shape(kept.coefficients_initial, kept._change), []
        for which, rows in kept._parts:
            if len(rows):
                mesh = mesh.copy()
                mesh[self._rows[which][1]] = rows
            out.append(mesh)
        for mesh in out:
            mesh.flags.writeable = False  # equal ones are one
        self._ready = [(kept, tuple(out)), *self._ready[: READY - 1]]
        return self._ready[0][1]

    def _shape(self, x: np.ndarray, change: np.ndarray | None) -> np.ndarray:
        """b0 + B x as the tracker computes it (:meth:`~adaptiveface.tracking.expression.BlendshapeFit.shape`)."""
        if change is not self._changed[0]:
            basis = self._basis
            if change is not None:
                basis = basis[: len(change)].copy()
                basis[:, self._frontal] += change
            self._changed = change, basis
        basis = self._changed[1][: len(x)]
        moved = (x.astype(np.float32) @ basis.reshape(len(x), -1)).reshape(-1, 3)
        return (self._neutral + moved).astype(np.float32)
