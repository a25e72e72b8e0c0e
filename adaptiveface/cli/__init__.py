"""Read the command line (``adaptiveface demo | capture | track | live | ...``) and call what it asks for.

Every command makes a few calls of the package. An error that the user can act on is a single line on stderr, and the exit
status is 2. Ctrl-C saves what was done, and the exit status is 130. SIGTERM does the same with status 143.
"""

from __future__ import annotations

import argparse
import sys
from typing import NoReturn

from .. import __version__
from ..errors import SYSTEM_LIBRARIES_HINT, AdaptiveFaceError
from ..runtime.interrupt import Terminated, end_process, orderly_end
from . import offline, sensors, studies, tools
from .notes import Notes
from .speech import speak

EXIT_ERROR, EXIT_INTERRUPTED, EXIT_PIPE, EXIT_TERMINATED = 2, 130, 141, 143
#: The functions that add the commands, in the order of the help.
COMMANDS = (
    offline.add_demo,
    offline.add_capture,
    offline.add_track,
    sensors.add_record,
    sensors.add_convert,
    offline.add_export,
    sensors.add_stream,
    sensors.add_live,
    studies.add_batch,
    studies.add_evaluate,
    studies.add_paper,
    tools.add_bench,
    tools.add_lab,
    tools.add_exercises,
    tools.add_doctor,
)


def main(argv: list[str] | None = None) -> int:
    """Run the command in ``argv`` and return the exit status. Without ``argv``, run the process's command line and exit."""
    speak()
    try:
        with orderly_end():
            status = _run(argv)
    except SystemExit as end:  # argparse has shown a help or the version, or refused the command line
        if argv is not None:
            raise
        status = int(end.code or 0)
    except KeyboardInterrupt as interruption:  # a second Ctrl-C, while the first was handled
        status = _interrupted(interruption)
    if argv is None:
        end_process(status)
    return status


def _run(argv: list[str] | None) -> int:
    try:
        args = _parser().parse_args(argv)  # writes a help, too, which is broken off with its pipe
        with Notes():
            return args.run(args)
    except AdaptiveFaceError as error:
        return _fail(str(error))
    except ImportError as error:
        return _fail(f"{error} ({SYSTEM_LIBRARIES_HINT})")
    except BrokenPipeError:  # the reader is gone, as after `| head -1`
        return EXIT_PIPE
    except OSError as error:
        name = f"{error.filename}: " if error.filename else ""
        return _fail(f"{name}{error.strerror or error}")
    except MemoryError as error:
        return _fail(str(error) or "out of memory")
    except KeyboardInterrupt as interruption:
        return _interrupted(interruption)


def _interrupted(interruption: KeyboardInterrupt) -> int:
    stopped = isinstance(interruption, Terminated) or isinstance(interruption.__cause__, Terminated)
    print(f"adaptiveface: {'ended by SIGTERM' if stopped else 'interrupted'}", file=sys.stderr)
    return EXIT_TERMINATED if stopped else EXIT_INTERRUPTED


def _fail(message: str) -> int:
    print(f"adaptiveface: error: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_ERROR


class _Parser(argparse.ArgumentParser):
    """Reports a bad command line in one line, without the usage text."""

    def error(self, message: str) -> NoReturn:
        """End the process with :data:`EXIT_ERROR` and one line."""
        self.exit(_fail(f"{message} (see {self.prog} --help)"))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(
        prog="adaptiveface",
        description="Capture facial performances with one depth camera: a neutral scan makes a personal rig, and the "
        "tracking model learns the actor's own expressions while they perform.",
        epilog="Start with: adaptiveface demo. Every command explains its options: adaptiveface track --help.",
    )
    parser.add_argument("--version", action="version", version=f"adaptiveface {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in COMMANDS:
        add(commands)
    return parser


__all__ = ["COMMANDS", "EXIT_ERROR", "EXIT_INTERRUPTED", "EXIT_TERMINATED", "main"]
