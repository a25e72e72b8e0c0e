"""Write ``index.html`` of a batch: the figures and the report of each recording, and the failures with their reasons."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from urllib.parse import quote

from ..files import replacing
from ..report.page import Link, html, page
from .tables import columns_of

#: Columns of the index, where the rows have them; the tables hold everything.
_SHOWN = (
    ("frames", "{:d}"),
    ("tracked", "{:d}"),
    ("broken", "{:d}"),
    ("learned", "{:d}"),
    ("ms_median", "{:.1f}"),
    ("residual", "{:.2f}"),
    ("v4_surface_p95", "{:.2f}"),
    ("v4_active_share", "{:.3f}"),
    ("seconds", "{:.0f}"),
)
_TITLES = {
    "ms_median": "ms a frame",
    "residual": "depth residual, mm",
    "v4_surface_p95": "surface error, 95 %, mm",
    "v4_active_share": "active share",
}
_FIXED = ("recording", "source", "status", "reason", "folder")


def write_index(folder: Path, rows: Sequence[dict], jobs: int) -> Path:
    """Write ``index.html`` for a batch.

    Parameters
    ----------
    folder : Path
        The batch's output folder.
    rows : sequence of dict
        The records of jobs.
    jobs : int
        Number of jobs in the batch.

    Returns
    -------
    Path
        Path of the page.
    """
    done = [row for row in rows if row["status"] == "done"]
    failed = [row for row in rows if row["status"] != "done"]
    columns = columns_of(rows)
    swept = [name for name in columns if "." in name and name not in _FIXED]
    shown = [(name, form) for name, form in _SHOWN if name in columns]
    files = [f"{name}{suffix}" for suffix in (".csv", ".parquet") for name in ("recordings", "frames")]
    files = [name for name in files if (folder / name).exists()]
    waiting = jobs - len(rows)
    summary = f"{len(done)} of {jobs} done, {len(failed)} failed" + (f", {waiting} not reached" if waiting else "")
    body = html().batch(summary, files, _failures(failed, swept), _results(folder, done, swept, shown))
    path = folder / "index.html"
    with replacing(path) as temporary:
        temporary.write_text(page("Batch of recordings", [body]), encoding="utf-8")
    return path


def _failures(rows: Sequence[dict], swept: Sequence[str]) -> str:
    if not rows:
        return ""
    lines = [[row["recording"], *(str(row.get(name, "")) for name in swept), row["reason"]] for row in rows]
    return html().table(["recording", *swept, "reason"], lines, kind="text")


def _results(folder: Path, rows: Sequence[dict], swept: Sequence[str], shown) -> str:
    if not rows:
        return ""
    lines = []
    for row in rows:
        name, report = row["recording"], f"{row['folder']}/report.html"
        if (folder / report).is_file():
            name = Link(name, quote(report))
        values = [form.format(row[key]) if row.get(key) not in (None, "") else "" for key, form in shown]
        lines.append([name, *(str(row.get(key, "")) for key in swept), *values])
    heads = ["recording", *swept, *(_TITLES.get(name, name) for name, _ in shown)]
    return html().table(heads, lines)
