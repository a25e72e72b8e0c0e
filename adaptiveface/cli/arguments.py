"""Add and check the arguments that several commands share."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from pathlib import Path

from ..errors import ParameterError
from ..export.arguments import add_field_of_view
from .texts import TEXTS


def add_command(commands, name: str) -> argparse.ArgumentParser:
    """Add the parser of a command, with its :data:`~adaptiveface.cli.texts.TEXTS`."""
    what, more, example = TEXTS[name]
    text = f"{what[0].upper()}{what[1:]}. {more}"
    return commands.add_parser(name, help=what, description=text, epilog=f"Example: {example}" if example else None)


def add_source(command: argparse.ArgumentParser) -> None:
    """Add ``SOURCE``, which has numbered frames, and the options that say how to read its pictures."""
    text = "folder of a recording, a video (colour only), or synthetic[:SEED[:NOISE]][@take.csv]"
    command.add_argument("source", metavar="SOURCE", help=text)
    add_field_of_view(command)
    add_mirrored(command)


def add_mirrored(command: argparse.ArgumentParser) -> None:
    """Add ``--mirrored``, which :func:`source_name` reads."""
    command.add_argument(
        "--mirrored", action="store_true", help="flip the pictures: they were recorded as in a mirror, like selfie videos"
    )


def source_name(args: argparse.Namespace) -> str:
    """Return the name under which the source or sensor is opened."""
    from ..sensors.orientation import MIRRORED

    name = args.source if hasattr(args, "source") else args.sensor
    return name + MIRRORED if args.mirrored and MIRRORED not in name else name


def opened(text: str, field_of_view: float | None = None):
    """Open the source named by ``text``, and print a line for each thing that it converted or repaired."""
    from ..geometry.source import Abilities
    from ..sensors import open_source

    source = open_source(text, field_of_view)
    for note in Abilities.of(source).notes:
        print(note)
    return source


def add_performer(command: argparse.ArgumentParser, seed: int) -> None:
    """Add ``--seed`` and ``--noise`` of a synthetic performance."""
    number = "number of the performer (default: %(default)s)"
    command.add_argument("--seed", type=whole(0, 10**9), default=seed, metavar="N", help=number)
    noise = "noise of the depth camera: structured-light, truedepth or none (default: %(default)s)"
    command.add_argument("--noise", default="structured-light", metavar="NAME", help=noise)


def add_notebook_folder(command: argparse.ArgumentParser) -> None:
    """Add ``--dir``."""
    text = "folder of the notebooks (default: %(default)s)"
    command.add_argument("--dir", type=Path, default=Path("adaptiveface-notebooks"), metavar="DIR", help=text)


def add_settings(command: argparse.ArgumentParser) -> None:
    """Add ``--set stage.name=value``, which :func:`parameters` reads."""
    command.add_argument(
        "--set",
        nargs="+",
        action="extend",
        default=[],
        metavar="stage.name=value",
        help="set parameters of the method, such as laplacian.w1=0.2 (docs: parameters)",
    )


def whole(low: int, high: int) -> Callable[[str], int]:
    """Make the argparse type of a whole number between ``low`` and ``high``."""

    def whole_number(text: str) -> int:
        """Return the number, or raise argparse's error."""
        if not (text.isascii() and text.isdecimal() and low <= int(text[:12]) <= high and len(text) <= 12):
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number between {low} and {high}")
        return int(text)

    return whole_number


def neutral_frames(text: str) -> int | range:
    """Read the value of ``--neutral-frames``: a number such as ``40``, or a range such as ``100:140`` (without 140)."""
    first, colon, last = text.partition(":")
    if not colon:
        return whole(1, 99_999)(text)
    numbers = range(whole(0, 999_999)(first or "0"), whole(1, 999_999)(last))
    if not len(numbers):
        raise argparse.ArgumentTypeError(f"{text!r} holds no frame; FIRST:LAST is expected, counted from 0")
    return numbers


def add_neutral_frames(command: argparse.ArgumentParser, default: int | None = 40) -> None:
    """Add ``--neutral-frames N`` or ``FIRST:LAST``."""
    text = "frames that show the resting face: the first N, or those of a range (default: %(default)s); a video needs none"
    command.add_argument(
        "--neutral-frames",
        type=neutral_frames,
        default=default,
        metavar="N|FIRST:LAST",
        help=text if default else text.replace("%(default)s", "all"),
    )


def parameters(settings: list[str], live: bool = False):
    """Make the :class:`~adaptiveface.parameters.Parameters` that ``--set`` asks for, from the defaults or from the live ones.

    Raises :class:`ParameterError`.
    """
    from ..parameters import Parameters

    values = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or "." not in name:
            raise ParameterError(f"--set {setting}: stage.name=value is expected, e.g. laplacian.w1=0.2")
        values[name] = value
    return (Parameters.live() if live else Parameters()).replace(**values)


def several(low: int, high: int) -> Callable[[str], list[int]]:
    """Make the argparse type of two or more ascending whole numbers between ``low`` and ``high``, separated by commas."""

    def whole_numbers(text: str) -> list[int]:
        """Return the numbers, or raise argparse's error."""
        numbers = [whole(low, high)(part) for part in text.split(",")]
        if len(numbers) < 2 or numbers != sorted(set(numbers)):
            raise argparse.ArgumentTypeError(f"{text!r} is not two or more ascending numbers")
        return numbers

    return whole_numbers
