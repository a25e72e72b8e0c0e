"""Show progress bars of the pipeline."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from tqdm import tqdm


def progress_bar(progress: bool, **options) -> tqdm:
    """Make a bar on stderr if that is a terminal, so that log files stay readable. ``options`` are those of ``tqdm``."""
    return tqdm(disable=None if progress else True, **options)


@contextmanager
def capture_bar(progress: bool) -> Iterator[Callable[[str, float], None]]:
    """A bar for ``capture_actor`` that runs to 100 % in every step."""
    with progress_bar(progress, total=100, unit="%", leave=False) as bar:

        def report(step: str, share: float) -> None:
            """Move the bar to the share of this step."""
            bar.set_description(step.replace("_", " "), refresh=False)
            bar.n = int(np.clip(round(100 * share), 0, 100))
            bar.refresh()

        yield report
