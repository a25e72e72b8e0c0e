"""Define records: dataclasses whose array fields are declared once, with shape, type, unit and meaning.

The declaration determines the checks of a file that is read, the arrays that are written, the class's ``Attributes`` section,
and the table in the docs::

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
#: Name of each type in the docs, and the kinds of arrays accepted for it. Numbers may have any size. Signed and unsigned
#: integers are told apart only where a value of the other kind would mean something else.
_TYPES = {
    "f4": ("", "f"),
    "f8": ("float64", "f"),
    "i4": ("int32", "iu"),
    "i2": ("int16", "i"),
    "i1": ("int8", "iu"),
    "u4": ("uint32", "iu"),
    "u2": ("uint16", "u"),
    "u1": ("uint8", "u"),
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
        Name of the array in the file.
    shape : tuple
        Sizes as numbers or letters. Equal letters mean equal sizes within a file.
    dtype : str
        Type of the written array, a key of ``_TYPES``. Other sizes of the same kind can also be read.
    doc, unit : str
        Meaning and unit of the values.
    optional : bool
        Whether a file may lack the array.
    below : str or int
        For indices, their upper bound (exclusive): a letter of a size, or a number.
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
        """The requirements that :func:`adaptiveface.files.npz.load_checked` checks."""
        return Field(self.shape, _TYPES[self.dtype][1], self.optional)

    @property
    def kind(self) -> str:
        """Readable shape and type, such as "(N, 3) int32". Single precision is not mentioned."""
        sizes = ", ".join(map(str, self.shape)) + ("," if len(self.shape) == 1 else "")
        return f"({sizes}) {_TYPES[self.dtype][0]}".rstrip()

    @property
    def meaning(self) -> str:
        """The documentation with the unit."""
        return ", ".join(text for text in (self.doc, self.unit) if text)


@dataclass(frozen=True)
class Part:
    """A record within a record. Either all its arrays are stored, with ``prefix`` before their names, or none.

    ``renewed`` names the arrays that the current form introduced. A file with none of them holds an older form, which is
    ignored.
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
    """Declare a dataclass field that files store as an array. Parameters without an entry here are those of :class:`Array`.

    Parameters
    ----------
    shape : str
        Sizes separated by spaces, such as "F N 3"; "" for a single value.
    name : str
        Name in files, if it differs from the field's.
    default, default_factory
        As for :func:`dataclasses.field`.
    """
    sizes = tuple(int(size) if size.isdecimal() else size for size in shape.split())
    stored = Array(name, sizes, dtype, doc, unit, optional, below)
    return dataclasses.field(default=default, default_factory=default_factory, metadata={_KEY: stored})


def part(kind: type, prefix: str, renewed: tuple[str, ...] = ()) -> Any:
    """Declare a dataclass field that holds another record or None, stored as :class:`Part` describes."""
    return dataclasses.field(default=None, metadata={_KEY: Part(kind, prefix, renewed)})


def declared(cls: type) -> Iterator[tuple[str, Array]]:
    """Yield attribute and declaration of every array of a record, in the order of its fields, without those of its parts."""
    for entry in dataclasses.fields(cls):
        if isinstance(stored := entry.metadata.get(_KEY), Array):
            yield entry.name, dataclasses.replace(stored, name=stored.name or entry.name)


def parts(cls: type) -> Iterator[tuple[str, Part]]:
    """Yield attribute and declaration of every record within a record."""
    for entry in dataclasses.fields(cls):
        if isinstance(stored := entry.metadata.get(_KEY), Part):
            yield entry.name, stored


def stored(cls: type) -> list[Array]:
    """Every array that a file of the record may hold, including those of its parts under their full names."""
    own = [entry for _, entry in declared(cls)]
    for _, inner in parts(cls):
        own += [dataclasses.replace(e, name=inner.prefix + e.name, optional=True) for _, e in declared(inner.kind)]
    return own


def checks(cls: type) -> dict[str, Field]:
    """The requirements for :func:`adaptiveface.files.npz.load_checked`, by name in the file."""
    return {entry.name: entry.field for entry in stored(cls)}


def read(
    cls: type, path: str | os.PathLike, max_bytes: int = MAX_BYTES, mapped: Collection[str] = (), double: bool = False
) -> dict[str, Any]:
    """Read the arrays of a file by attribute, ready for ``cls(**data)``.

    Parameters
    ----------
    cls : type
        The record.
    path : path-like
        An npz file.
    max_bytes, mapped
        As for :func:`adaptiveface.files.npz.load_checked`.
    double : bool
        Whether to convert floating-point arrays to float64 for computing.

    Returns
    -------
    dict
        Indices are int32. Arrays of text are tuples and single values are ``str``, ``bool`` or ``int`` if the field is
        annotated so. The arrays of a part are a dictionary, or None. Optional arrays that the file lacks are left out.

    Raises
    ------
    FileFormatError
        The message names the file and the array.
    """
    return by_attribute(cls, path, load_checked(path, checks(cls), max_bytes, mapped), double)


def by_attribute(cls: type, path: str | os.PathLike, data: dict[str, np.ndarray], double: bool = False) -> dict[str, Any]:
    """Do as :func:`read` does with arrays that are already checked, given by their names in the file."""
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
            if limit is not None:  # otherwise another file holds the mesh, and its size is unknown
                check_indices(path, prefix + entry.name, values, limit)
            values = values.astype(np.int32)
        elif double and values.dtype.kind == "f":
            values = values.astype(float)
        out[attribute] = plain(values, annotations[attribute])
    return out


def plain(values: np.ndarray, annotation: str) -> Any:
    """Convert an array to the type of a field's annotation: a tuple of text, ``str``, ``bool``, ``int``, or unchanged."""
    if annotation.startswith("tuple"):
        return tuple(str(text) for text in values)
    kind = {"str": str, "bool": bool, "int": int}.get(annotation)
    return values if kind is None else kind(values)


def arrays(instance: Any) -> dict[str, np.ndarray]:
    """The arrays of a record by name in the file, for :func:`read`.

    Floats and single integers have the declared type. None is left out.
    """
    out = {}
    for attribute, entry in declared(type(instance)):
        if (value := getattr(instance, attribute)) is not None:
            values = np.asanyarray(value)
            cast = values.dtype.kind == "f" or type(value) is int
            out[entry.name] = values.astype(entry.dtype, copy=False) if cast else values
    for attribute, inner in parts(type(instance)):
        if (value := getattr(instance, attribute)) is not None:
            out |= {inner.prefix + name: values for name, values in arrays(value).items()}
    return out


def row_dtype(cls: type, names: Collection[str], sizes: dict[str, int], text: int) -> np.dtype:
    """The aligned dtype of one row of several arrays of a record.

    Parameters
    ----------
    cls : type
        The record.
    names : collection of str
        The arrays. Their first size is the number of rows.
    sizes : dict
        The other sizes by letter.
    text : int
        Number of characters to keep of a text.

    Returns
    -------
    numpy.dtype
        A structured dtype with one field per array.
    """
    entries = {entry.name: entry for entry in stored(cls)}
    kinds: dict[str, Any] = {"b": np.bool_, "U": f"<U{text}"}
    shapes = {name: tuple(sizes.get(str(size), size) for size in entries[name].shape[1:]) for name in names}
    fields = [(name, kinds.get(entries[name].dtype, entries[name].dtype), shapes[name]) for name in names]
    return np.dtype(fields, align=True)


def record(cls: AnyClass) -> AnyClass:
    """Class decorator above ``@dataclass`` that adds the declarations to the docstring as a section ``Attributes``."""
    lines = [f"    {attribute} : {entry.kind}\n        {_sentence(entry)}" for attribute, entry in declared(cls)]
    cls.__doc__ = f"{(cls.__doc__ or '').rstrip()}\n\n    Attributes\n    ----------\n" + "\n".join(lines) + "\n    "
    return cls


def _sentence(entry: Array) -> str:
    text = entry.meaning
    return f"{text[:1].upper()}{text[1:]}." if text else "See the class."


def table(cls: type) -> str:
    """A Markdown table of a record's arrays for the docs: name, shape with type, meaning."""
    attributes = {entry.name: attribute for attribute, entry in declared(cls)}
    lines = ["| name | shape | meaning |", "|---|---|---|"]
    for entry in stored(cls):
        attribute = attributes.get(entry.name, entry.name)
        notes = ["optional"] * entry.optional + [f"in Python `{attribute}`"] * (attribute != entry.name)
        note = f" ({', '.join(notes)})" if notes else ""
        lines.append(f"| `{entry.name}` | {entry.kind} | {entry.meaning}{note} |")
    return "\n".join(lines)
