"""Run a batch: skip the jobs that are done, spread the others over workers, and keep the tables up to date."""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from tqdm import tqdm

from ..errors import AdaptiveFaceError
from .index import write_index
from .jobs import Job
from .tables import write_tables
from .work import drop_unfinished, finished, run_job
from .workers import completed


class Batch:
    """Jobs, and the folder for their results.

    Parameters
    ----------
    jobs : sequence of Job
        See :func:`adaptiveface.batch.expand`.
    folder : path-like
        The folder of the output. Each job has a folder of its own in it. The folder also gets ``index.html``,
        ``recordings.csv`` with a row per job and ``frames.csv`` with a row per frame. If pyarrow is installed, both tables
        are written as ``.parquet`` as well.
    """

    def __init__(self, jobs: Sequence[Job], folder: str | os.PathLike) -> None:
        self.jobs, self.folder = list(jobs), Path(folder)
        if self.folder.exists() and not self.folder.is_dir():
            raise AdaptiveFaceError(f"{self.folder}: is a file, the name of a folder is expected")

    def run(self, client=None, processes: int | None = None, progress: bool = False) -> list[dict]:
        """Do the jobs that are not done yet.

        Parameters
        ----------
        client : dask.distributed.Client, optional
            A cluster whose workers see the recordings and ``folder`` under the same paths.
        processes : int, optional
            Number of processes at the same time without a client, by default one per processor.
        progress : bool
            Whether a bar is shown on stderr.

        Returns
        -------
        list of dict
            One record per job, in the order of the jobs.

        Notes
        -----
        A job that was finished with the same options and the same version is not done again, but a failed job is. A failing
        job does not end the batch. Its record has the ``status`` "failed" and a ``reason``.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        records = {job.name: record for job in self.jobs if (record := finished(self.folder, job))}
        left = [job for job in self.jobs if job.name not in records]
        processes = processes or min(os.cpu_count() or 1, max(len(left), 1))
        work = partial(run_job, str(self.folder.resolve()))
        bar = tqdm(
            total=len(self.jobs), initial=len(records), desc="batch", unit="recording", disable=None if progress else True
        )
        try:
            with bar:
                for job, answer in completed(work, left, client, processes):
                    records[job.name] = answer if isinstance(answer, dict) else _failed(job, answer)
                    bar.set_postfix(failed=sum(r["status"] == "failed" for r in records.values()), refresh=False)
                    bar.update()
        finally:
            self._gather(records)
        return [records[job.name] for job in self.jobs]

    def _gather(self, records: dict[str, dict]) -> None:
        for job in self.jobs:
            if job.name in records:
                drop_unfinished(self.folder, job)
        rows = [records[job.name] for job in self.jobs if job.name in records]
        if rows:
            write_tables(self.folder, rows)
            write_index(self.folder, rows, len(self.jobs))


def _failed(job: Job, error: BaseException) -> dict:
    reason = str(error) if isinstance(error, AdaptiveFaceError) else f"{type(error).__name__}: {error}"
    return {
        "recording": job.name.split("/")[0],
        "source": job.source,
        **dict(job.settings),
        "status": "failed",
        "reason": " ".join(reason.split()),
    }
