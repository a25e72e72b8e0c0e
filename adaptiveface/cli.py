"""The command line: ``adaptiveface demo | capture | track | bench | lab``.

Thin: every command is a few calls of the package. Anything the user can act on ends as one line on stderr and exit
status 2; Ctrl-C ends with 130 after saving what was done.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from . import __version__
from .errors import SYSTEM_LIBRARIES_HINT, AdaptiveFaceError, ParameterError
from .export.arguments import add_export_arguments, add_stream_arguments
from .retargeting import BUILT_IN

EXIT_ERROR, EXIT_INTERRUPTED = 2, 130


def main(argv: list[str] | None = None) -> int:
    """Run a command of ``argv`` (default: the process's arguments) and return the exit status."""
    args = _parser().parse_args(argv)
    try:
        return args.run(args)
    except AdaptiveFaceError as error:
        return _fail(str(error))
    except ImportError as error:
        return _fail(f"{error} ({SYSTEM_LIBRARIES_HINT})")
    except (OSError, MemoryError) as error:
        return _fail(str(error) or "out of memory")
    except KeyboardInterrupt:
        print("adaptiveface: interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _fail(message: str) -> int:
    print(f"adaptiveface: error: {' '.join(message.split())}", file=sys.stderr)
    return EXIT_ERROR


class _Parser(argparse.ArgumentParser):
    """Reports a bad command line in one line, without the usage text."""

    def error(self, message: str) -> None:
        self.exit(_fail(f"{message} (see {self.prog} --help)"))


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="adaptiveface", description="Facial performance capture with on-the-fly correctives.")
    parser.add_argument("--version", action="version", version=f"adaptiveface {__version__}")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    demo = commands.add_parser("demo", help="no hardware, no network: synthetic sensor, whole pipeline, report")
    demo.add_argument("--out", type=Path, default=Path("adaptiveface-demo"), metavar="DIR", help="default: %(default)s")
    demo.add_argument("--seed", type=_whole(0, 10**9), default=0, help="which performer (default: %(default)s)")
    demo.add_argument("--noise", default="structured-light", help="structured-light, truedepth or none")
    demo.add_argument("--frames", type=_whole(2, 10_000), default=120, help="frames of one of the two performances")
    demo.add_argument("--character", metavar="NAME", help=f"also animate {', '.join(BUILT_IN)}, or your own character")
    _add_settings(demo)
    demo.set_defaults(run=run_demo)

    capture = commands.add_parser("capture", help="neutral scan -> personal model")
    _add_source(capture)
    capture.add_argument("--out", type=Path, required=True, metavar="actor.npz")
    capture.add_argument("--neutral-frames", type=_whole(1, 99_999), metavar="N", help="only the leading N with a face")
    _add_settings(capture)
    capture.set_defaults(run=run_capture)

    track = commands.add_parser("track", help="track every frame of a recording")
    _add_source(track)
    track.add_argument("--out", type=Path, required=True, metavar="result.npz")
    track.add_argument("--actor", type=Path, metavar="actor.npz", help="default: captured from the leading frames")
    track.add_argument("--neutral-frames", type=_whole(1, 99_999), default=40, metavar="N", help="default: %(default)s")
    track.add_argument("--keep-stages", action="store_true", help="also store v1, v2 and v3")
    track.add_argument("--report", type=Path, metavar="DIR", help="write report.html there")
    _add_settings(track)
    track.set_defaults(run=run_track)

    record = commands.add_parser("record", help="record a sensor into a folder that track and capture read")
    record.add_argument("source", metavar="SOURCE", help="a sensor (synthetic, realsense, ...) or a recording")
    record.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    record.add_argument("--seconds", type=_whole(1, 86_400), metavar="N", help="default: until Ctrl-C")
    record.set_defaults(run=run_record)

    convert = commands.add_parser("convert", help="a vendor's recording into a folder that track and capture read")
    convert.add_argument("file", type=Path, metavar="FILE", help="a recording of another program or SDK")
    convert.add_argument("--out", type=Path, required=True, metavar="DIR", help="a new folder")
    convert.set_defaults(run=run_convert)

    export = commands.add_parser("export", help="a tracked result as an animated character, curves or a video")
    add_export_arguments(export)
    export.set_defaults(run=run_export)

    stream = commands.add_parser("stream", help="track and send blendshapes and head motion while tracking")
    _add_source(stream)
    add_stream_arguments(stream)
    stream.add_argument("--neutral-frames", type=_whole(1, 99_999), default=40, metavar="N", help="default: %(default)s")
    _add_settings(stream)
    stream.set_defaults(run=run_stream)

    live = commands.add_parser("live", help="a sensor, the neutral scan, and the tracked face: in the notebook or here")
    live.add_argument("sensor", nargs="?", metavar="SENSOR", help="synthetic, realsense, ... or a recording")
    live.add_argument("--headless", action="store_true", help="in the terminal; without SENSOR: which ones there are")
    live.add_argument("--dir", type=Path, default=Path("adaptiveface-notebooks"), metavar="DIR", help="of the notebooks")
    live.add_argument("--actor", type=Path, metavar="actor.npz", help="default: captured first, by a guided scan")
    live.add_argument("--save-actor", type=Path, metavar="FILE", help="where to keep the captured actor")
    live.add_argument("--record", type=Path, metavar="DIR", help="also record every frame to a new folder")
    live.add_argument("--out", type=Path, metavar="result.npz", help="the result, 3 MB a second")
    live.add_argument("--vmc", nargs="?", const="", metavar="HOST:PORT", help="send VMC messages while tracking")
    live.add_argument("--osc", nargs="?", const="", metavar="HOST:PORT", help="send OSC messages while tracking")
    live.add_argument("--seconds", type=_whole(1, 86_400), metavar="N", help="of tracking; default: until Ctrl-C")
    _add_settings(live)
    live.set_defaults(run=run_live)

    bench = commands.add_parser("bench", help="the per-stage timing table, with its peers where they are installed")
    bench.add_argument("--frames", type=_whole(10, 10_000), metavar="N", help="synthetic frames to time")
    bench.add_argument("--live", action="store_true", help="instead: latency and lost frames of the live chain")
    bench.add_argument("--seconds", type=_whole(1, 86_400), default=60, metavar="N", help="of --live: %(default)s")
    bench.add_argument("--soak", type=_whole(1, 10_000), metavar="MINUTES", help="instead: does the live chain grow?")
    bench.add_argument("--json", action="store_true", help="of --live and --soak: one line of JSON")
    bench.set_defaults(run=run_bench)

    lab = commands.add_parser("lab", help="JupyterLab on a copy of the notebooks, on this machine only")
    lab.add_argument("--dir", type=Path, default=Path("adaptiveface-notebooks"), metavar="DIR", help="%(default)s")
    lab.add_argument("--port", type=_whole(1, 65_535), metavar="N", help="default: 8888, or the next free one")
    lab.add_argument("--no-browser", action="store_true", help="only print the address")
    lab.set_defaults(run=run_lab)
    return parser


def _add_source(command: argparse.ArgumentParser) -> None:
    text = "a recording folder, a video (colour only), or synthetic[:SEED[:NOISE]]"
    command.add_argument("source", metavar="SOURCE", help=text)


def _add_settings(command: argparse.ArgumentParser) -> None:
    command.add_argument(
        "--set", nargs="+", action="extend", default=[], metavar="stage.name=value", help="e.g. laplacian.w1=0.2"
    )


def _whole(low: int, high: int):
    def whole_number(text: str) -> int:
        if not (text.isascii() and text.isdecimal() and low <= int(text[:12]) <= high and len(text) <= 12):
            raise argparse.ArgumentTypeError(f"{text!r} is not a whole number between {low} and {high}")
        return int(text)

    return whole_number


def _parameters(settings: list[str]):
    from .parameters import Parameters

    values = {}
    for setting in settings:
        name, equals, value = setting.partition("=")
        if not equals or "." not in name:
            raise ParameterError(f"--set {setting}: stage.name=value is expected, e.g. laplacian.w1=0.2")
        values[name] = value
    return Parameters().set(**values)


def _check_output(path: Path, suffix: str = ".npz") -> None:
    """Refuse an output path that cannot be written before an hour of work, not after it."""
    if path.suffix != suffix:
        raise AdaptiveFaceError(f"{path}: the output's name must end in {suffix}")
    if path.is_dir():
        raise AdaptiveFaceError(f"{path}: is a folder, the name of a file is expected")
    if not path.resolve().parent.is_dir():
        raise AdaptiveFaceError(f"{path}: the folder {path.resolve().parent} does not exist")


def run_capture(args: argparse.Namespace) -> int:
    """``capture SOURCE --out actor.npz``."""
    parameters = _parameters(args.set)
    _check_output(args.out)
    from .pipeline import capture_from
    from .sensors import open_source

    actor = capture_from(open_source(args.source), parameters, args.neutral_frames, progress=True)
    actor.save(args.out)
    print(f"{args.out}: {len(actor.neutral)} vertices, {len(actor.blendshapes)} expressions, "
          f"{len(actor.scan_points)} scan points")  # fmt: skip
    return 0


def run_track(args: argparse.Namespace) -> int:
    """``track SOURCE --out result.npz``."""
    parameters = _parameters(args.set)
    _check_output(args.out)
    from .actor import Actor
    from .pipeline import TrackingInterrupted, capture_from, track_source
    from .sensors import open_source

    actor = Actor.load(args.actor) if args.actor else None
    source = open_source(args.source)
    if actor is None:
        actor = capture_from(source, parameters, args.neutral_frames, progress=True)
    try:
        result = track_source(source, actor, parameters, progress=True, keep_stages=args.keep_stages)
    except TrackingInterrupted as interruption:
        interruption.result.save(args.out)
        print(f"{args.out}: {len(interruption.result)} frames until the interruption")
        raise
    result.save(args.out)
    print(result.summary())
    if args.report:
        _report(result, source, actor, args.report, still_frames=0 if args.actor else args.neutral_frames)
    return 0


def run_demo(args: argparse.Namespace) -> int:
    """``demo``: capture, track and score a synthetic performer, and write actor, result and report to a folder."""
    start = time.perf_counter()
    parameters = _parameters(args.set)
    if args.character:
        from .retargeting.character import load_character

        load_character(args.character)  # a wrong name ends here, not after the tracking
    from .evaluation import ErrorCollector
    from .evaluation.coefficients import measure_coefficients
    from .pipeline import capture_from, track_source
    from .synthetic.sensor import SyntheticSensor

    sensor = SyntheticSensor(args.seed, args.noise, frames=args.frames)
    args.out.mkdir(parents=True, exist_ok=True)
    actor = capture_from(sensor, parameters, sensor.neutral_frames, progress=True)
    actor.save(args.out / "actor.npz")
    collector = ErrorCollector(sensor, actor)
    result = track_source(sensor, actor, parameters, progress=True, on_frame=lambda tracked, _: collector.add(tracked))
    result.save(args.out / "result.npz")
    evaluation = collector.finish()
    print(result.summary())
    print(evaluation.table())
    known = measure_coefficients(sensor, actor, parameters, progress=True)
    _report(result, sensor, actor, args.out, evaluation=evaluation, known=known, still_frames=sensor.neutral_frames,
            character=args.character or "hag")  # fmt: skip
    if args.character:
        from .export.command import write_demo_character

        for path in write_demo_character(args.character, result, actor, sensor, args.out):
            print(f"character: {path}")
    print(f"done in {time.perf_counter() - start:.0f} s")
    return 0


def run_record(args: argparse.Namespace) -> int:
    """``record SOURCE``."""
    from .sensors.record import run_record as run

    return run(args)


def run_convert(args: argparse.Namespace) -> int:
    """``convert FILE``."""
    from .sensors.record import run_convert as run

    return run(args)


def run_lab(args: argparse.Namespace) -> int:
    """``lab``."""
    from .lab import open_lab

    return open_lab(args.dir, args.port, not args.no_browser)


def run_export(args: argparse.Namespace) -> int:
    """``export result.npz``."""
    from .export.command import run_export as run

    return run(args)


def run_stream(args: argparse.Namespace) -> int:
    """``stream SOURCE``: track, and send every frame."""
    parameters = _parameters(args.set)
    from .sensors import open_source
    from .sensors.catalogue import is_live

    if is_live(args.source):
        from .live.command import run_live_stream

        return run_live_stream(args, parameters)
    from .export.command import run_stream as run

    return run(open_source(args.source), parameters, args)


def run_live(args: argparse.Namespace) -> int:
    """``live [SENSOR]``."""
    from .live.command import run_live as run

    return run(args, _parameters(args.set))


def run_bench(args: argparse.Namespace) -> int:
    """``bench``: time every stage on a synthetic performance, beside the paper's figures and other libraries."""
    from .bench import run_bench as run

    return run(args)


def _report(result, source, actor, folder: Path, **options) -> None:
    from .report import write_report

    truth = source if hasattr(source, "ground_truth") else None
    recorded = getattr(source, "path", Path("/nowhere")) / "ground_truth.npz"
    if truth is None and recorded.is_file():
        truth = recorded
    path = write_report(result, source, actor, folder, truth, correctives=result.correctives, **options)
    print(f"report: {path}")
