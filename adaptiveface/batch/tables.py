"""Write the tables of a batch, a row per recording and a row per frame, as CSV and, if pyarrow is installed, as Parquet."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Sequence
from pathlib import Path

from ..files import replacing


def columns_of(rows: Sequence[dict]) -> list[str]:
    """Return all keys of the rows in the order in which they first appear."""
    return list(dict.fromkeys(key for row in rows for key in row if key != "fingerprint"))


def write_tables(folder: Path, rows: Sequence[dict]) -> list[Path]:
    """Write ``recordings`` and ``frames`` in ``folder`` and return their paths.

    ``rows`` are the records of jobs. The frames come from ``frames.csv`` in the folders of the finished jobs.
    """
    recordings, frames = folder / "recordings.csv", folder / "frames.csv"
    with replacing(recordings) as temporary, open(temporary, "w", newline="", encoding="utf-8") as stream:
        writer = csv.DictWriter(stream, columns_of(rows), restval="", extrasaction="ignore")
        writer.writeheader()
        writer.writerows(rows)
    parts = [folder / row["folder"] / "frames.csv" for row in rows if row["status"] == "done"]
    _concatenate(frames, [part for part in parts if part.is_file()])
    return [recordings, frames, *_parquet([recordings, frames])]


def _concatenate(path: Path, parts: Sequence[Path]) -> None:
    """Join several CSV files, which may have different columns, into one. A missing value is left empty."""
    headers = []
    for part in parts:
        with open(part, newline="", encoding="utf-8") as stream:
            headers.append(next(csv.reader(stream)))
    names = list(dict.fromkeys(name for header in headers for name in header))
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as out:
        csv.writer(out).writerow(names)
        for part, header in zip(parts, headers, strict=True):
            with open(part, newline="", encoding="utf-8") as stream:
                if header == names:
                    stream.readline()
                    shutil.copyfileobj(stream, out)
                else:
                    writer = csv.DictWriter(out, names, restval="")
                    writer.writerows(csv.DictReader(stream))


def _parquet(paths: Sequence[Path]) -> list[Path]:
    try:
        from pyarrow import csv as arrow_csv
        from pyarrow import parquet
    except ImportError:
        return []
    written = []
    for path in paths:
        table = arrow_csv.read_csv(path)
        if table.num_columns:
            with replacing(path.with_suffix(".parquet")) as temporary:
                parquet.write_table(table, temporary)
            written.append(path.with_suffix(".parquet"))
    return written
