"""The jobs of a batch: one for each combination of a source and swept values."""

from __future__ import annotations

import hashlib
import itertools
import json
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from .. import __version__
from ..errors import FileFormatError, ParameterError
from ..files import read_text
from ..parameters import Parameters
from ..sensors.video_file import is_video

#: A list of sources is a text file; two hundred recordings need a hundredth of this.
MAX_LIST_BYTES = 4 << 20
#: A sweep over several parameters multiplies; beyond this a typing error is more likely than a plan.
MAX_JOBS = 100_000


@dataclass(frozen=True)
class Job:
    """One recording under one set of parameters.

    Attributes
    ----------
    name : str
        Path of the job's folder below the batch's output. It is unique in the batch.
    source : str
        The source that :func:`adaptiveface.open_source` opens.
    settings : tuple of (str, str)
        The swept values, such as ``("laplacian.w2", "0.5")``. They are columns of the tables.
    parameters : str
        JSON text of all parameters, including the swept ones.
    actor : str or None
        The ``actor.npz`` to track with. With None, the neutral is captured from the recording.
    neutral_frames : int
        Number of leading frames that show the neutral, if it is captured.
    formats : tuple of str
        Formats of ``adaptiveface export`` to write for the job.
    report : bool
        Whether a ``report.html`` is written.
    """

    name: str
    source: str
    settings: tuple[tuple[str, str], ...] = ()
    parameters: str = "{}"
    actor: str | None = None
    neutral_frames: int = 40
    formats: tuple[str, ...] = ()
    report: bool = True

    @property
    def fingerprint(self) -> str:
        """A value that identifies a finished job. It changes with every option and with the version."""
        content = json.dumps([asdict(self), __version__], sort_keys=True)
        return hashlib.sha256(content.encode()).hexdigest()[:16]


def find_sources(path: str | Path) -> list[str]:
    """Find the sources below a folder, or read them from a text file.

    Parameters
    ----------
    path : path-like
        A folder, one recording, or a text file. A folder may hold recordings (folders with ``intrinsic.json``), ``.r3d``
        files and videos at any depth. A text file has one source per line. Its lines that begin with ``#`` are comments.
        Relative paths in it are relative to the file. ``synthetic:SEED`` is also a source.

    Returns
    -------
    list of str
        The sources.

    Raises
    ------
    FileFormatError
        There is nothing to track. The message names ``path``.
    """
    path = Path(path)
    if path.is_file() and path.suffix.lower() in (".txt", ".list", ""):
        sources = _listed(path)
    elif path.is_dir() and not _is_source(path):
        sources = _below(path)
    elif path.exists():
        sources = [str(path)]
    else:
        raise FileFormatError(f"{path}: no such folder or list of recordings")
    if not sources:
        raise FileFormatError(f"{path}: holds no recording (a folder with intrinsic.json, an .r3d file or a video)")
    return list(dict.fromkeys(sources))


def _listed(path: Path) -> list[str]:
    lines = [line.strip() for line in read_text(path, MAX_LIST_BYTES).splitlines()]
    sources = []
    for line in lines:
        if line and not line.startswith("#"):
            known = line.partition(":")[0] == "synthetic" or Path(line).is_absolute()
            sources.append(line if known else str(path.parent / line))
    return sources


def _below(folder: Path) -> list[str]:
    found = []
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith("."):
            continue
        if _is_source(entry):
            found.append(str(entry))
        elif entry.is_dir() and not entry.is_symlink():
            found += _below(entry)
    return found


def _is_source(path: Path) -> bool:
    if path.is_dir():
        return (path / "intrinsic.json").is_file()
    return path.is_file() and (path.suffix.lower() == ".r3d" or is_video(str(path)))


def parse_sweep(texts: Sequence[str]) -> dict[str, list[str]]:
    """``["laplacian.w2=0.5,1.5"]`` -> ``{"laplacian.w2": ["0.5", "1.5"]}``.

    Names and values are checked later, by :func:`expand`.

    Raises
    ------
    ParameterError
        A text has another form.
    """
    values = {}
    for text in texts:
        name, equals, listed = text.partition("=")
        if not equals or "." not in name or not all(listed.split(",")):
            raise ParameterError(f"--sweep {text}: stage.name=value,value,... is expected, e.g. laplacian.w2=0.5,1.5,5")
        values[name] = list(dict.fromkeys(value.strip() for value in listed.split(",")))
    return values


def expand(
    sources: Sequence[str],
    parameters: Parameters | None = None,
    sweep: dict[str, list[str]] | None = None,
    **options,
) -> list[Job]:
    """Make one job for each source and each combination of swept values.

    Parameters
    ----------
    sources : sequence of str
        The sources to track.
    parameters : Parameters, optional
        The parameters that are not swept.
    sweep : dict, optional
        The values of each swept parameter, as :func:`parse_sweep` returns them.
    **options
        Other fields of :class:`Job`.

    Raises
    ------
    ParameterError
        A parameter does not exist, a value is outside its range, or there are more than ``MAX_JOBS`` jobs.
    """
    base, sweep = parameters or Parameters(), sweep or {}
    combinations = [tuple(zip(sweep, values, strict=True)) for values in itertools.product(*sweep.values())]
    if len(sources) * len(combinations) > MAX_JOBS:
        raise ParameterError(f"{len(sources)} recordings x {len(combinations)} settings are over {MAX_JOBS} jobs")
    jobs = []
    for name, source in zip(_names(sources), sources, strict=True):
        for settings in combinations:
            folder = "/".join([name, *([",".join(f"{key}={value}" for key, value in settings)] if settings else [])])
            chosen = base.replace(**dict(settings)) if settings else base
            jobs.append(Job(folder, source, settings, chosen.to_json(), **options))
    return jobs


def _names(sources: Sequence[str]) -> list[str]:
    """Return a folder name for each source.

    The name is the last part of the source. A number is added if two names would be equal on any file system.
    """
    names, taken = [], set()
    for source in sources:
        text = source if source.startswith("synthetic") else Path(source).stem or Path(source).resolve().name
        plain = re.sub(r"[^\w.+-]+", "_", text).strip("._") or "recording"
        name, number = plain, 2
        while name.casefold() in taken:
            name, number = f"{plain}-{number}", number + 1
        taken.add(name.casefold())
        names.append(name)
    return names
