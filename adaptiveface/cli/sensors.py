"""Commands on sensors and recordings that play: ``record``, ``convert``, ``stream``, ``live``."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..errors import ParameterError
from ..export.arguments import add_destinations, add_stream_arguments
from .arguments import (
    add_mirrored,
    add_neutral_frames,
    add_settings,
    add_source,
    opened,
    parameters,
    source_name,
    whole,
)


def add_record(commands) -> None:
    """``record``."""
    record = commands.add_parser("record", help="record a sensor into a folder that track and capture read")
    record.add_argument("source", metavar="SOURCE", help="a sensor (synthetic, realsense, ...) or a recording")
    record.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    record.add_argument("--seconds", type=whole(1, 86_400), metavar="N", help="default: until Ctrl-C")
    record.set_defaults(run=run_record)


def run_record(args: argparse.Namespace) -> int:
    """``record SOURCE``."""
    from ..sensors.record import run_record as run

    return run(args)


def add_convert(commands) -> None:
    """``convert``."""
    convert = commands.add_parser("convert", help="a vendor's recording into a folder that track and capture read")
    convert.add_argument("file", type=Path, metavar="FILE", help="a recording of another program or SDK")
    convert.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    convert.set_defaults(run=run_convert)


def run_convert(args: argparse.Namespace) -> int:
    """``convert FILE``."""
    from ..sensors.record import run_convert as run

    return run(args)


def add_stream(commands) -> None:
    """``stream``."""
    stream = commands.add_parser("stream", help="track and send blendshapes and head motion while tracking")
    add_source(stream)
    add_stream_arguments(stream)
    add_neutral_frames(stream)
    add_settings(stream)
    stream.set_defaults(run=run_stream)


def run_stream(args: argparse.Namespace) -> int:
    """``stream SOURCE``: track, and send every frame; a take's or a phone's curves are sent as they are."""
    from ..livelink.receiver import is_livelink
    from ..livelink.take import is_take

    chosen = parameters(args.set)
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
    """``live``."""
    live = commands.add_parser("live", help="a sensor, the neutral scan, and the tracked face: in the notebook or here")
    live.add_argument(
        "sensor",
        nargs="?",
        metavar="SENSOR",
        help="synthetic, realsense, ..., a recording, or livelink[:[HOST:]PORT]: an iPhone's curves",
    )
    add_mirrored(live)
    live.add_argument("--headless", action="store_true", help="in the terminal; without SENSOR: which ones there are")
    live.add_argument("--dir", type=Path, default=Path("adaptiveface-notebooks"), metavar="DIR", help="of the notebooks")
    live.add_argument("--actor", type=Path, metavar="actor.npz", help="default: captured first, by a guided scan")
    live.add_argument("--save-actor", type=Path, metavar="FILE", help="where to keep the captured actor")
    live.add_argument("--record", type=Path, metavar="DIR", help="also record every frame to a new folder")
    live.add_argument("--out", type=Path, metavar="result.npz", help="the result, 3 MB a second; livelink: take.csv")
    add_destinations(live)
    live.add_argument("--seconds", type=whole(1, 86_400), metavar="N", help="of tracking; default: until Ctrl-C")
    add_settings(live)
    live.set_defaults(run=run_live)


def run_live(args: argparse.Namespace) -> int:
    """``live [SENSOR]``."""
    from ..live.command import run_live as run
    from ..livelink.receiver import is_livelink

    if args.sensor is not None and not is_livelink(args.sensor):
        args.sensor = source_name(args)
    return run(args, parameters(args.set))
