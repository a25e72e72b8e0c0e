"""Commands for sensors, and for recordings that are played back: ``record``, ``convert``, ``stream``, ``live``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import ParameterError
from ..export.arguments import add_actor, add_destinations, add_personal_actor, add_stream_arguments
from .arguments import (
    add_command,
    add_mirrored,
    add_neutral_frames,
    add_notebook_folder,
    add_settings,
    add_source,
    opened,
    parameters,
    source_name,
    whole,
)


def add_record(commands) -> None:
    """Add the command ``record``."""
    record = add_command(commands, "record")
    record.add_argument("source", metavar="SOURCE", help="a sensor (synthetic, realsense, ...) or a recording")
    record.add_argument("--out", type=Path, required=True, metavar="DIR", help="new folder to write to")
    record.add_argument(
        "--seconds", type=whole(1, 86_400), metavar="N", help="stop after this many seconds (default: at Ctrl-C)"
    )
    record.set_defaults(run=run_record)


def run_record(args: argparse.Namespace) -> int:
    """Run ``record SOURCE``."""
    from ..sensors.record import run_record as run

    return run(args)


def add_convert(commands) -> None:
    """Add the command ``convert``."""
    convert = add_command(commands, "convert")
    convert.add_argument("file", type=Path, metavar="FILE", help="recording of another program or SDK")
    convert.add_argument("--out", type=Path, required=True, metavar="DIR", help="new folder to write to")
    convert.set_defaults(run=run_convert)


def run_convert(args: argparse.Namespace) -> int:
    """Run ``convert FILE``."""
    from ..sensors.record import run_convert as run

    return run(args)


def add_stream(commands) -> None:
    """Add the command ``stream``."""
    stream = add_command(commands, "stream")
    add_source(stream)
    add_stream_arguments(stream)
    add_neutral_frames(stream)
    add_settings(stream)
    stream.set_defaults(run=run_stream)


def run_stream(args: argparse.Namespace) -> int:
    """Run ``stream SOURCE``: track and send every frame. The curves of a take or of a phone are sent as they are."""
    from ..livelink.receiver import is_livelink
    from ..livelink.take import is_take

    chosen = parameters(args.set, live=True)
    if is_livelink(args.source):
        from ..live.livelink import run_livelink_stream

        return run_livelink_stream(args)
    if is_take(args.source):
        from ..export.take import stream_take

        return stream_take(args)
    args.source = source_name(args)
    from ..sensors.catalogue import is_live

    if is_live(args.source):
        from ..live.command import run_live_stream

        if args.fov is not None:
            raise ParameterError(f"{args.source}: --fov is for videos; a webcam takes webcam:INDEX,fov=DEGREES")
        return run_live_stream(args, chosen)
    from ..export.command import run_stream as run

    return run(opened(args.source, args.fov), chosen, args)


def add_live(commands) -> None:
    """Add the command ``live``."""
    live = add_command(commands, "live")
    live.add_argument(
        "sensor",
        nargs="?",
        metavar="SENSOR",
        help="synthetic, realsense, ..., a recording, or livelink[:[HOST:]PORT] for the curves of an iPhone",
    )
    add_mirrored(live)
    live.add_argument("--headless", action="store_true", help="track in this terminal; without SENSOR, list the sensors")
    add_notebook_folder(live)
    add_actor(live, "captured first, by a guided scan")
    live.add_argument("--save-actor", type=Path, metavar="FILE", help="save the captured rig to this file")
    add_personal_actor(live)
    live.add_argument("--record", type=Path, metavar="DIR", help="also record every frame to a new folder")
    live.add_argument("--out", type=Path, metavar="result.npz", help="save the result, 3 MB a second; of livelink: take.csv")
    add_destinations(live)
    live.add_argument(
        "--seconds", type=whole(1, 86_400), metavar="N", help="stop after tracking for this many seconds (default: at Ctrl-C)"
    )
    add_settings(live)
    live.set_defaults(run=run_live)


def run_live(args: argparse.Namespace) -> int:
    """Run ``live [SENSOR]``."""
    from ..live.command import run_live as run
    from ..livelink.receiver import is_livelink

    if args.sensor is not None and not is_livelink(args.sensor):
        args.sensor = source_name(args)
    return run(args, parameters(args.set, live=True))
