"""Read and write Live Link Face's CSV: Timecode, BlendShapeCount, 52 shapes, rotations of the head and of both eyes."""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass

import numpy as np

from ..errors import FileFormatError
from ..files import read_text, replacing
from .convention import ARKIT_NAMES, ROTATIONS, rotations
from .timecode import parse, timecode, to_seconds

HEADER = ("Timecode", "BlendShapeCount", *(name[0].upper() + name[1:] for name in ARKIT_NAMES), *ROTATIONS)
#: Enough for half an hour at 60 frames per second.
MAX_BYTES, MAX_ROWS, MAX_LINE = 96 << 20, 150_000, 10_000
_VALUES = HEADER[2:]


@dataclass(frozen=True)
class LiveLinkTake:
    """A take of F frames, as it was recorded.

    Attributes
    ----------
    timestamps : (F,) array
        Seconds since midnight.
    curves : (F, 52) array
        Values of the curves ``ARKIT_NAMES``, about 0 to 1. iPhones also write values such as 1.003.
    head : (F, 3) array
        Yaw, pitch and roll of the head, rad, with the signs of :mod:`~adaptiveface.livelink.convention`.
    eyes : (F, 6) array
        Yaw, pitch and roll of the left eye and then of the right eye, rad.
    tracked : (F,) bool array
        Whether the row has values. Other rows repeat the last values.
    absent : tuple of str
        Columns that the file does not have. Their values are zero here.
    """

    timestamps: np.ndarray
    curves: np.ndarray
    head: np.ndarray
    eyes: np.ndarray
    tracked: np.ndarray
    absent: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.curves)

    def head_rotations(self) -> np.ndarray:
        """(F, 3, 3) rotations of the head frame (x to the subject's left, y up, z out of the face)."""
        return rotations(self.head)


def write_take(path: str | os.PathLike, take: LiveLinkTake) -> None:
    """Write a take with one row per frame, completely or not at all. Untracked frames get the count 0 and no values."""
    rows = np.hstack([take.curves, take.head, take.eyes])
    with replacing(path) as temporary, open(temporary, "w", encoding="utf-8", newline="\n") as stream:
        stream.write(header_line())
        for time, row, tracked in zip(take.timestamps, rows, take.tracked, strict=True):
            stream.write(row_line(time, row, tracked))


def header_line() -> str:
    """Return the first line of a take."""
    return ",".join(HEADER) + "\n"


def row_line(time: float, row: np.ndarray, tracked: bool = True) -> str:
    """Return the line of a frame at ``time`` s since midnight. ``row`` has the (61,) values in the order of the header."""
    values = f"{len(row)}," + ",".join(f"{value:.9g}" for value in row) if tracked else "0" + "," * len(row)
    return f"{timecode(time)},{values}\n"


def is_take(path: str | os.PathLike) -> bool:
    """Return whether a path has the name of a CSV file. The file is not read."""
    return os.fspath(path).lower().endswith(".csv")


def read_take(path: str | os.PathLike) -> LiveLinkTake:
    """Read a CSV of Live Link Face, or of an application that writes the same columns in any order.

    Columns are found by name, in upper or lower case. Their separators may be commas, tabs or semicolons (with decimal
    commas).

    Raises
    ------
    FileFormatError
        The message names the file, the line and the reason.
    """
    text = read_text(path, MAX_BYTES)
    if text.count("\n") + text.count("\r") > 2 * MAX_ROWS:
        raise FileFormatError(f"{path}: more than {MAX_ROWS} lines")
    lines = text.splitlines()
    if max(map(len, lines), default=0) > MAX_LINE:
        raise FileFormatError(f"{path}: a line of more than {MAX_LINE} characters")
    separator = max(",;\t", key=lines[0].count) if lines else ","
    columns = _columns(path, next(csv.reader(lines[:1], delimiter=separator), []))
    times, rows, tracked = [], [], []
    for number, words in enumerate(csv.reader(lines[1:], delimiter=separator), start=2):
        if not any(word.strip() for word in words):
            continue
        try:
            times.append(parse(words[columns["Timecode"]]))
            row = _row(words, columns, decimal_comma=separator == ";")
        except IndexError:
            raise FileFormatError(f"{path}, line {number}: {len(words)} columns instead of {columns['*']}") from None
        except ValueError:
            raise FileFormatError(f"{path}, line {number}: a timecode and numbers are expected") from None
        if row is not None and not np.isfinite(row).all():
            raise FileFormatError(f"{path}, line {number}: values that are not finite")
        tracked.append(row is not None)
        rows.append(row)
    if not any(tracked):
        raise FileFormatError(f"{path}: no rows" if not rows else f"{path}: no row has values: the face was never found")
    present = np.flatnonzero(tracked)
    last = present[np.maximum(np.searchsorted(present, np.arange(len(rows)), side="right") - 1, 0)]
    values = np.stack([rows[k] for k in last])
    absent = tuple(name for name in _VALUES if name not in columns)
    curves, head, eyes = np.split(values, [52, 55], axis=1)
    return LiveLinkTake(to_seconds(times), curves, head, eyes, np.array(tracked), absent)


def _columns(path, words: list[str]) -> dict[str, int]:
    """Map our name of each column to its number in the file, and "*" to the number of columns."""
    known = {name.lower(): name for name in HEADER}
    found = {known[key]: k for k, key in enumerate(word.strip().lower() for word in words) if key in known}
    if "Timecode" not in found or not any(name in found for name in HEADER[2 : 2 + len(ARKIT_NAMES)]):
        raise FileFormatError(f"{path}: the first line is not Live Link Face's: Timecode,BlendShapeCount,...")
    return found | {"*": len(words)}


def _row(words: list[str], columns: dict[str, int], decimal_comma: bool) -> np.ndarray | None:
    """Return the (61,) values in the order of the header.

    The result is None for a frame without a face. Its row is empty or has the count 0.
    """
    count = words[columns["BlendShapeCount"]].strip() if "BlendShapeCount" in columns else ""
    given = [word for name, k in columns.items() if name in _VALUES for word in words[k : k + 1] if word.strip()]
    if not given and (count == "0" or len(words) >= columns["*"]):
        return None
    if len(words) < columns["*"]:
        raise IndexError
    out = np.zeros(len(_VALUES))
    for k, name in enumerate(_VALUES):
        if name in columns:
            word = words[columns[name]]
            out[k] = float(word.replace(",", ".") if decimal_comma else word)
    return out
