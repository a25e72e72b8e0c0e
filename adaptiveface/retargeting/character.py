"""Define characters: a neutral mesh with named expressions that a tracked performance drives (paper, section 6)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FileFormatError
from ..files.npz import write_npz
from ..files.records import array, arrays, read, record
from ..geometry.polydata import expression_weights, surface
from ..renamed import old_objects
from .arkit import ARKIT_NAMES, canonical_name
from .shape_names import driven_shapes

if TYPE_CHECKING:
    from ..geometry.polydata import PolyData

#: Displacements in character files are whole numbers of this many millimetres.
STEP_MM = 0.04

#: Largest number of coordinates of all expressions together, 8 bytes each.
MAX_VALUES = 100_000_000


@record
@dataclass(frozen=True)
class CharacterFile:
    """The arrays of a character's file. V vertices, T triangles, E expressions, M vertices that any of them moves."""

    neutral: np.ndarray = array("V 3", doc="neutral face, head frame", unit="mm")
    triangles: np.ndarray = array("T 3", "u4", "vertex numbers; uint16 up to 65,536 vertices", below="V")
    moving: np.ndarray = array("M", "u4", "numbers of the vertices that move; uint16 up to 65,536 vertices", below="V")
    expressions: np.ndarray = array("E M 3", "i2", "their displacements at full activation", unit=f"{STEP_MM:g} mm")
    expression_names: tuple[str, ...] = array("E", "U", "names of the expressions")
    skin: int = array(
        "", "u4", "so many leading vertices are the skin, as in the tracking mesh; 0 for another mesh", optional=True, default=0
    )
    mix: np.ndarray | None = array(
        "E 52", doc="weights of the ARKit curves in each expression; absent: its name decides", optional=True, default=None
    )
    colours: np.ndarray | None = array("V 3", "u1", "sRGB colours", optional=True, default=None)


@dataclass(frozen=True)
class Character:
    """A face to be driven, with V vertices, T triangles and E expressions.

    Attributes
    ----------
    name : str
        Name of the character.
    neutral : (V, 3)
        Neutral face in the head frame (x to the subject's left, y up, z out of the face), mm.
    triangles : (T, 3) int32
        Vertex numbers.
    expression_names : (E,)
        Names as in the file.
    expressions : (E, V, 3)
        Displacements at full activation, mm.
    colours : (V, 3) uint8 or None
        sRGB.
    skin : int
        The first ``skin`` vertices are the skin, in the order of the tracking mesh. 0 if the character has another mesh.
    notes : tuple of str
        What the loader left out or merged, one line each.
    mix : (E, 52) or None
        Weights of the ARKit curves in each expression. With None, every expression follows the curve of its name.
    parts : tuple of str
        Expressions that no curve drives directly, because they are parts of driven ones.
    """

    name: str
    neutral: np.ndarray
    triangles: np.ndarray
    expression_names: tuple[str, ...]
    expressions: np.ndarray
    colours: np.ndarray | None = None
    skin: int = 0
    notes: tuple[str, ...] = ()
    mix: np.ndarray | None = None
    parts: tuple[str, ...] = ()

    def shape(self, weights: np.ndarray) -> np.ndarray:
        """Vertices (V, 3), or (F, V, 3), in mm for weights (E,), or (F, E), of the expressions."""
        flat = self.expressions.reshape(len(self.expressions), self.neutral.size)
        return self.neutral + (weights @ flat).reshape(*np.shape(weights)[:-1], -1, 3)

    def mesh(self, **weights: float) -> PolyData:
        """The neutral face plus expressions, as in ``character.mesh(jawOpen=0.7)``.

        Parameters
        ----------
        **weights : float
            Activation of each named expression.

        Returns
        -------
        pyvista.PolyData
            In mm. The axes are x out of the face, y to the subject's left, z up. The arrays are ``displacement`` (V, 3) from
            the neutral, its length ``distance`` (V,), ``normals`` (V, 3) and, if the character has them, ``colours`` (V, 3)
            uint8.

        Raises
        ------
        ParameterError
            A name is no expression of the character.
        MissingExtraError
            pyvista is not installed.
        """
        vertices = self.shape(expression_weights(self.expression_names, weights))
        moved = vertices - self.neutral
        mesh = surface(vertices, self.triangles, displacement=moved, distance=np.linalg.norm(moved, axis=1))
        if self.colours is not None:
            mesh["colours"] = self.colours
            mesh.set_active_scalars(None)
        return mesh

    @property
    def rows(self) -> np.ndarray:
        """(E, 52) weights of the ARKit curves ``ARKIT_NAMES`` in each expression; a row of zeros: undriven."""
        if self.mix is not None:
            return self.mix
        rows = np.zeros((len(self.expression_names), len(ARKIT_NAMES)))
        for number, row in driven_shapes(self.expression_names)[0].items():
            rows[number] = row
        return rows

    @property
    def drivers(self) -> tuple[str | None, ...]:
        """(E,) name of the ARKit curve that is the weight of each expression; None for mixtures and undriven expressions."""
        return tuple(ARKIT_NAMES[row.argmax()] if row.max() == row.sum() == 1 else None for row in self.rows)

    @property
    def unknown(self) -> tuple[str, ...]:
        """Expressions that no ARKit shape drives. They stay at zero."""
        return tuple(name for name, row in zip(self.expression_names, self.rows, strict=True) if not row.any())

    @property
    def missing(self) -> tuple[str, ...]:
        """ARKit shapes that the character does not have."""
        return tuple(np.array(ARKIT_NAMES)[~(self.rows > 0).any(axis=0)].tolist())

    @property
    def size(self) -> np.ndarray:
        """(3,) width, height and depth of the neutral, mm."""
        return np.ptp(self.neutral, axis=0)

    def weights(self, curves: np.ndarray) -> np.ndarray:
        """(F, E) weights in [0, 1] of the character's expressions for ARKit curves (F, 52)."""
        return np.clip(np.asarray(curves, float) @ self.rows.T, 0.0, 1.0)

    def shares_topology(self, triangles: np.ndarray) -> bool:
        """Whether the skin is the mesh ``triangles`` (T, 3), vertex by vertex."""
        count = len(triangles)
        return self.skin > 0 and len(self.triangles) >= count and np.array_equal(self.triangles[:count], triangles)

    def save(self, path: str | os.PathLike) -> None:
        """Write the character as :class:`CharacterFile`. Displacements are rounded to ``STEP_MM``.

        Raises :class:`FileFormatError` if a displacement is too large to be stored.
        """
        moving = np.flatnonzero(np.abs(self.expressions).max(axis=(0, 2)) > STEP_MM / 2)
        steps = np.rint(self.expressions[:, moving] / STEP_MM)
        if np.abs(steps).max(initial=0) > 32767:
            raise FileFormatError(f"{path}: displacements beyond {32767 * STEP_MM:g} mm cannot be stored")
        small = np.uint16 if len(self.neutral) <= 65536 else np.uint32
        file = CharacterFile(
            self.neutral,
            self.triangles.astype(small),
            moving.astype(small),
            steps.astype(np.int16),
            self.expression_names,
            self.skin,
            self.mix,
            None if self.colours is None else self.colours.astype(np.uint8),
        )
        write_npz(path, arrays(file), compressed=True)


def load_character_npz(path: str | os.PathLike, name: str | None = None) -> Character:
    """Read a file of :meth:`Character.save`.

    Parameters
    ----------
    path : path-like
        The file.
    name : str, optional
        Name of the character, by default that of the file.

    Raises
    ------
    FileFormatError
        The message names the file and what is wrong.
    """
    file = CharacterFile(**read(CharacterFile, path, max_bytes=256 << 20))
    n = len(file.neutral)
    if 3 * n * len(file.expressions) > MAX_VALUES:
        raise FileFormatError(f"{path}: {len(file.expressions)} expressions of {n} vertices are too many")
    if not 0 <= file.skin <= n:
        raise FileFormatError(f"{path}: 'skin' = {file.skin}, but there are {n} vertices")
    expressions = np.zeros((len(file.expressions), n, 3))
    expressions[:, file.moving] = file.expressions * STEP_MM
    return Character(
        name or Path(path).stem,
        file.neutral.astype(float),
        file.triangles,
        file.expression_names,
        expressions,
        file.colours,
        file.skin,
        mix=file.mix,
    )


def make_character(
    name: str,
    neutral: np.ndarray,
    triangles: np.ndarray,
    shapes: Sequence[tuple[str, np.ndarray]],
    notes: Sequence[str] = (),
) -> Character:
    """Make a character of shapes.

    Halves of a shape that ARKit does not split (ICT-FaceKit's ``browInnerUp_L`` and ``_R``) are joined, unless the whole shape
    is also there (:func:`adaptiveface.retargeting.shape_names.driven_shapes`). The character's ``notes`` tell what was joined.

    Parameters
    ----------
    name : str
        Name of the character.
    neutral : (V, 3)
        In mm.
    triangles : (T, 3)
        Vertex numbers.
    shapes : sequence of (str, (V, 3))
        Name and displacement, mm, of each shape. No name occurs twice.
    notes : sequence of str
        Notes of the loader, which come first.
    """
    names = [shape for shape, _ in shapes]
    chosen, merged_notes = driven_shapes(names)
    merged: dict[str, list[int]] = {}
    for number, shape in enumerate(names):
        key = f"driven {chosen[number].nonzero()[0].tolist()}" if number in chosen else shape
        merged.setdefault(key, []).append(number)
    parts = list(merged.values())
    expressions = np.zeros((len(parts), *np.shape(neutral)))
    for out, numbers in zip(expressions, parts, strict=True):
        out += sum(shapes[number][1] for number in numbers)
    labels = tuple(names[n[0]] if len(n) == 1 else canonical_name(names[n[0]]) or names[n[0]] for n in parts)
    mix = np.array([chosen.get(n[0], np.zeros(len(ARKIT_NAMES))) for n in parts]).reshape(-1, len(ARKIT_NAMES))
    return Character(name, neutral, triangles, labels, expressions, notes=(*notes, *merged_notes), mix=mix)


__getattr__ = old_objects(__name__)
