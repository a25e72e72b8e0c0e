"""Print the package's warnings on the command line, one line each."""

from __future__ import annotations

import logging
import sys


class Notes(logging.Handler):
    """Prints every warning once, in one line on stderr, without tearing a progress bar."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self._said: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Print a record, unless it was printed before."""
        from tqdm import tqdm

        text = " ".join(record.getMessage().split())
        if text not in self._said:
            self._said.add(text)
            tqdm.write(f"adaptiveface: note: {text}", file=sys.stderr)

    def __enter__(self) -> Notes:
        logging.getLogger("adaptiveface").addHandler(self)
        return self

    def __exit__(self, *_) -> None:
        logging.getLogger("adaptiveface").removeHandler(self)
