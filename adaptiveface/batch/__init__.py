"""Process many recordings at once: capture, track, score and export each of them, and collect the results in tables.

    from adaptiveface.batch import Batch, find_sources
    Batch(find_sources("recordings"), "results").run()

:mod:`.jobs` says what there is to do, :mod:`.work` does one job, :mod:`.workers` spreads jobs over processes or a Dask
cluster, :mod:`.tables` and :mod:`.index` gather what came out.
"""

from .jobs import Job, expand, find_sources, parse_sweep
from .run import Batch
from .workers import WorkerLost, completed, dask_client

__all__ = ["Batch", "Job", "WorkerLost", "completed", "dask_client", "expand", "find_sources", "parse_sweep"]
