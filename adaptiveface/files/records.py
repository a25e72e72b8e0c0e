"""Records: dataclasses whose array fields are declared once, with shape, type, unit and meaning.

The declaration is what is checked when a file is read, what is written, the class's ``Attributes`` section, and the table
in the docs::

    @record
    @dataclass(frozen=True)
    class Scan:
        \"\"\"P points of a neutral scan.\"\"\"

        points: np.ndarray = array("P 3", doc="head frame", unit="mm")

    data = read(Scan, path)     # checked: names, shapes, types, finite values, index ranges
    scan = Scan(**data)
    write_npz(path, arrays(scan))
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Collection, Iterator
from dataclasses import MISSING, dataclass
from typing import Any, TypeVar

import numpy as np

from ..errors import FileFormatError
from .npz import MAX_BYTES, Field, check_indices, load_checked

_KEY = "array"
#: How the docs call a type, and the kinds of arrays that are accepted for it: whole numbers of any size and sign.
_TYPES = {
    "f4": ("", "f"),
    "f8": ("float64", "f"),
    "i4": ("int32", "iu"),
    "i1": ("int8", "iu"),
    "b": ("bool", "b"),
    "U": ("str", "U"),
}
AnyClass = TypeVar("AnyClass", bound=type)


@dataclass(frozen=True)
class Array:
    """How a record's field is stored.

    Parameters
    ----------
    name : str
        Of the array in the file.
    shape : tuple
        Whole numbers, and letters for sizes; equal letters must agree within a file.
    dtype : str
        Of the array as it is written: "f4", "f8", "i4", "i1", "b" or "U". Other sizes of the same kind are read too.
    doc, unit, frame : str
        What it is.
    optional : bool
        Whether a file may be without it.
    below : str or int
        For indices: the size (a letter) or number that they stay below.
    """

    name: str
    shape: tuple[int | str, ...]
    dtype: str
    doc: str
    unit: str = ""
    optional: bool = False
    below: str | int = ""

    @property
    def field(self) -> Field:
        """What :func:`adaptiveface.files.npz.load_checked` checks."""
        return Field(self.shape, _TYPES[self.dtype][1], self.optional)

    @property
    def kind(self) -> str:
        """Shape and type, for people: "(N, 3) int32"; single precision is not said."""
        sizes = ", ".join(map(str, self.shape)) + ("," if len(self.shape) == 1 else "")
        return f"({sizes}) {_TYPES[self.dtype][0]}".rstrip()

    @property
    def meaning(self) -> str:
        """The documentation with the unit."""
        return ", ".join(text for text in (self.doc, self.unit) if text)


@dataclass(frozen=True)
class Part:
    """A record within a record: its arrays are stored with ``prefix`` before their names, all of them or none.

    ``renewed``: arrays that its form of today brought. A file with none of them holds an older form, which is left out.
    """

    kind: type
    prefix: str
    renewed: tuple[str, ...] = ()


def array(
    shape: str,
    dtype: str = "f4",
    doc: str = "",
    *,
    unit: str = "",
    name: str = "",
    optional: bool = False,
    below: str | int = "",
    default: Any = MISSING,
    default_factory: Any = MISSING,
) -> Any:
    """A dataclass field that files store as an array, as :class:`Array` says.

    ``shape``: sizes with spaces between them, "F N 3"; "" for a single value. ``name``: in files, where it is another.
    """
    sizes = tuple(int(size) if size.isdecimal() else size for size in shape.split())
    stored = Array(name, sizes, dtype, doc, unit, optional, below)
    return dataclasses.field(default=default, default_factory=default_factory, metadata={_KEY: stored})


def part(kind: type, prefix: str, renewed: tuple[str, ...] = ()) -> Any:
    """A dataclass field that holds another record or None, stored as :class:`Part` says."""
    return dataclasses.field(default=None, metadata={_KEY: Part(kind, prefix, renewed)})


def declared(cls: type) -> Iterator[tuple[str, Array]]:
    """Attribute and declaration of every array of a record, in the order of its fields; without those of parts."""
    for entry in dataclasses.fields(cls):
        if isinstance(stored := entry.metadata.get(_KEY), Array):
            yield entry.name, dataclasses.replace(stored, name=stored.name or entry.name)


def parts(cls: type) -> Iterator[tuple[str, Part]]:
    """Attribute and declaration of every record within a record."""
    for entry in dataclasses.fields(cls):
        if isinstance(stored := entry.metadata.get(_KEY), Part):
            yield entry.name, stored


def stored(cls: type) -> list[Array]:
    """Every array that a file of the record may hold, those of its parts under their full names."""
    own = [entry for _, entry in declared(cls)]
    for _, inner in parts(cls):
        own += [dataclasses.replace(e, name=inner.prefix + e.name, optional=True) for _, e in declared(inner.kind)]
    return own


def checks(cls: type) -> dict[str, Field]:
    """Name in the file -> what :func:`adaptiveface.files.npz.load_checked` checks."""
    return {entry.name: entry.field for entry in stored(cls)}


def read(
    cls: type, path: str | os.PathLike, max_bytes: int = MAX_BYTES, mapped: Collection[str] = (), double: bool = False
) -> dict[str, Any]:
    """The arrays of a file by attribute, ready for ``cls(**data)``; those of a part as a dictionary, or None.

    Parameters
    ----------
    cls : type
        The record.
    path : path-like
        An npz file.
    max_bytes, mapped
        As of :func:`adaptiveface.files.npz.load_checked`.
    double : bool
        Floating-point arrays as float64, for computing.

    Returns
    -------
    dict
        Arrays of text as tuples and single values as ``str``, ``bool`` or ``int`` where the field is annotated so; indices
        as int32. Optional arrays that the file is without are left out.

    Raises
    ------
    FileFormatError
        Names the file and the array.
    """
    return by_attribute(cls, path, load_checked(path, checks(cls), max_bytes, mapped), double)


def by_attribute(cls: type, path: str | os.PathLike, data: dict[str, np.ndarray], double: bool = False) -> dict[str, Any]:
    """As :func:`read`, of checked arrays by their names in the file."""
    sizes = _sizes(cls, data)
    out = _converted(cls, path, data, sizes, double)
    for attribute, inner in parts(cls):
        own = {e.name: data[inner.prefix + e.name] for _, e in declared(inner.kind) if inner.prefix + e.name in data}
        if inner.renewed and own.keys().isdisjoint(inner.renewed):
            own = {}
        needed = (entry.name for _, entry in declared(inner.kind) if not entry.optional)
        missing = [inner.prefix + name for name in needed if name not in own]
        if own and missing:
            raise FileFormatError(f"{path}: the array {missing[0]!r} is missing beside '{inner.prefix}{next(iter(own))}'")
        out[attribute] = _converted(inner.kind, path, own, sizes, double, inner.prefix) if own else None
    return out


def _sizes(cls: type, data: dict[str, np.ndarray]) -> dict[str | int, int]:
    sizes: dict[str | int, int] = {}
    for entry in stored(cls):
        if entry.name in data:
            sizes |= {name: size for name, size in zip(entry.shape, data[entry.name].shape, strict=True)}
    return sizes


def _converted(
    cls: type, path: str | os.PathLike, data: dict[str, np.ndarray], sizes: dict[str | int, int], double: bool, prefix: str = ""
) -> dict[str, Any]:
    out: dict[str, Any] = {}
    annotations = {entry.name: str(entry.type) for entry in dataclasses.fields(cls)}
    for attribute, entry in declared(cls):
        if entry.name not in data:
            continue
        values = data[entry.name]
        if entry.below:
            limit = entry.below if isinstance(entry.below, int) else sizes.get(entry.below)
            if limit is not None:  # of a mesh that another file holds nothing is known
                check_indices(path, prefix + entry.name, values, limit)
            values = values.astype(np.int32)
        elif double and values.dtype.kind == "f":
            values = values.astype(float)
        out[attribute] = plain(values, annotations[attribute])
    return out


def plain(values: np.ndarray, annotation: str) -> Any:
    """An array as a field of that annotation has it: a tuple of text, ``str``, ``bool`` or ``int``, or as it is."""
    if annotation.startswith("tuple"):
        return tuple(str(text) for text in values)
    kind = {"str": str, "bool": bool, "int": int}.get(annotation)
    return values if kind is None else kind(values)


def arrays(instance: Any) -> dict[str, np.ndarray]:
    """What :func:`read` reads, by the names in the file: floating-point numbers as declared, None left out."""
    out = {}
    for attribute, entry in declared(type(instance)):
        if (value := getattr(instance, attribute)) is not None:
            value = np.asanyarray(value)
            out[entry.name] = value.astype(entry.dtype, copy=False) if value.dtype.kind == "f" else value
    for attribute, inner in parts(type(instance)):
        if (value := getattr(instance, attribute)) is not None:
            out |= {inner.prefix + name: values for name, values in arrays(value).items()}
    return out


def row_dtype(cls: type, names: Collection[str], sizes: dict[str, int], text: int) -> np.dtype:
    """The aligned dtype of one row of a record's arrays ``names``, whose first size counts the rows.

    ``sizes``: letter -> number, of the other sizes; ``text``: characters kept of a text.
    """
    entries = {entry.name: entry for entry in stored(cls)}
    kinds: dict[str, Any] = {"b": np.bool_, "U": f"<U{text}"}
    shapes = {name: tuple(sizes.get(str(size), size) for size in entries[name].shape[1:]) for name in names}
    fields = [(name, kinds.get(entries[name].dtype, entries[name].dtype), shapes[name]) for name in names]
    return np.dtype(fields, align=True)


def record(cls: AnyClass) -> AnyClass:
    """Class decorator over ``@dataclass``: adds the declarations to the docstring as a section ``Attributes``."""
    lines = [f"    {attribute} : {entry.kind}\n        {_sentence(entry)}" for attribute, entry in declared(cls)]
    cls.__doc__ = f"{(cls.__doc__ or '').rstrip()}\n\n    Attributes\n    ----------\n" + "\n".join(lines) + "\n    "
    return cls


def _sentence(entry: Array) -> str:
    text = entry.meaning
    return f"{text[:1].upper()}{text[1:]}." if text else "See the class."


def table(cls: type) -> str:
    """The Markdown table of a record's arrays for the docs: name, shape and type, meaning."""
    attributes = {entry.name: attribute for attribute, entry in declared(cls)}
    lines = ["| name | shape | meaning |", "|---|---|---|"]
    for entry in stored(cls):
        attribute = attributes.get(entry.name, entry.name)
        notes = ["optional"] * entry.optional + [f"in Python `{attribute}`"] * (attribute != entry.name)
        note = f" ({', '.join(notes)})" if notes else ""
        lines.append(f"| `{entry.name}` | {entry.kind} | {entry.meaning}{note} |")
    return "\n".join(lines)
