"""Commands for recordings and results: ``demo``, ``capture``, ``track``, ``export``."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

from ..export.arguments import add_actor, add_export_arguments, add_personal_actor
from ..files import check_distinct, check_folder, check_output
from ..retargeting import BUILT_IN
from ..runtime.interrupt import CtrlC
from .arguments import (
    add_command,
    add_neutral_frames,
    add_performer,
    add_settings,
    add_source,
    opened,
    parameters,
    source_name,
    whole,
)


def add_demo(commands) -> None:
    """Add the command ``demo``."""
    demo = add_command(commands, "demo")
    demo.add_argument(
        "--out", type=Path, default=Path("adaptiveface-demo"), metavar="DIR", help="folder to write to (default: %(default)s)"
    )
    add_performer(demo, seed=0)
    demo.add_argument(
        "--frames",
        type=whole(2, 10_000),
        default=120,
        metavar="N",
        help="length of each of the two performances, frames (default: %(default)s)",
    )
    demo.add_argument(
        "--character", metavar="NAME", help=f"also animate a character: {', '.join(BUILT_IN)}, or a file of your own"
    )
    add_settings(demo)
    demo.set_defaults(run=run_demo)


def run_demo(args: argparse.Namespace) -> int:
    """Run ``demo``: capture, track and score a synthetic performer, and write actor, result and report to a folder."""
    start = time.perf_counter()
    chosen = parameters(args.set)
    _check_demo(args)
    from ..evaluation import ErrorCollector, GroundTruth
    from ..evaluation.coefficients import measure_coefficients
    from ..pipeline import FrameReader, capture_source, track_to_file
    from ..synthetic.sensor import SyntheticSensor

    sensor = SyntheticSensor(args.seed, args.noise, frames=args.frames)
    args.out.mkdir(parents=True, exist_ok=True)
    with FrameReader(sensor, remember=True) as reader:
        actor = capture_source(reader, chosen, sensor.neutral_frames, progress=True)
        actor.save(args.out / "actor.npz")
        collector = ErrorCollector(GroundTruth.of(sensor), actor)
        result = track_to_file(
            reader, actor, args.out / "result.npz", chosen, progress=True, on_frame=lambda tracked, _: collector.add(tracked)
        )
    evaluation = collector.finish()
    print(result.summary())
    print(evaluation.table())
    known = measure_coefficients(sensor, actor, chosen, progress=True)
    _report(
        result,
        sensor,
        actor,
        args.out,
        evaluation=evaluation,
        known=known,
        still_frames=sensor.neutral_frames,
        character=args.character or "hag",
    )
    if args.character:
        from ..export.command import write_demo_character

        for path in write_demo_character(args.character, result, actor, sensor, args.out):
            print(f"character: {path}")
    print(f"done in {time.perf_counter() - start:.0f} s")
    return 0


def _check_demo(args: argparse.Namespace) -> None:
    """Check the outputs first, so that an error does not end the demo after the tracking."""
    inputs = [args.character]
    check_folder(args.out)
    outputs = {"actor.npz": "actor", "result.npz": "result", "report.html": "html"}
    if args.character:
        from ..export.command import demo_character_files
        from ..retargeting.loading import load_character

        outputs |= demo_character_files(load_character(args.character))
    for name, kind in outputs.items():
        if args.out.is_dir():
            check_output(args.out / name, kind, inputs)


def add_capture(commands) -> None:
    """Add the command ``capture``."""
    capture = add_command(commands, "capture")
    add_source(capture)
    capture.add_argument("--out", type=Path, required=True, metavar="actor.npz", help="file to write")
    add_neutral_frames(capture, default=None)
    add_settings(capture)
    capture.set_defaults(run=run_capture)


def run_capture(args: argparse.Namespace) -> int:
    """Run ``capture SOURCE --out actor.npz``."""
    chosen = parameters(args.set)
    check_output(args.out, "actor", [args.source])
    from ..pipeline import capture_source

    actor = capture_source(opened(source_name(args), args.fov), chosen, args.neutral_frames, progress=True)
    actor.save(args.out)
    print(
        f"{args.out}: {len(actor.neutral)} vertices, {len(actor.blendshapes)} expressions, {len(actor.scan_points)} scan points"
    )
    return 0


def add_track(commands) -> None:
    """Add the command ``track``."""
    track = add_command(commands, "track")
    add_source(track)
    track.add_argument("--out", type=Path, required=True, metavar="result.npz", help="file to write")
    add_actor(track, "captured from the leading frames")
    add_neutral_frames(track)
    track.add_argument(
        "--irises",
        action="store_true",
        help="measure the gaze: find the irises in the colour images of recordings that have features.csv without irises",
    )
    track.add_argument(
        "--keep-stages", action="store_true", help="also store the meshes of the intermediate stages: v1, v2 and v3"
    )
    add_personal_actor(track)
    track.add_argument("--report", type=Path, metavar="DIR", help="also write report.html to this folder")
    add_settings(track)
    track.set_defaults(run=run_track)


def run_track(args: argparse.Namespace) -> int:
    """Run ``track SOURCE --out result.npz``."""
    chosen = parameters(args.set)
    inputs = [args.source, args.actor]
    check_output(args.out, "result", inputs)
    if args.personal_actor:
        check_output(args.personal_actor, "actor", inputs)
        check_distinct(args.out, args.personal_actor)
    if args.report:
        check_folder(args.report)
        if args.report.is_dir():
            check_output(args.report / "report.html", "html", inputs)
    from ..model.actor import Actor
    from ..pipeline import FrameReader, TrackingInterrupted, capture_source, track_to_file
    from ..result.rows import discard, unfinished_folder

    actor = Actor.load(args.actor) if args.actor else None
    source = opened(source_name(args), args.fov)
    still_frames = 0

    def on_take(take) -> None:
        """Remember how many leading frames are neutral, because the report measures the jitter in them."""
        nonlocal still_frames
        still_frames = len(take.frames) if take.leading else 0

    try:
        with FrameReader(source, irises=args.irises, remember=actor is None) as reader:
            actor = actor or capture_source(reader, chosen, args.neutral_frames, progress=True, on_take=on_take)
            result = track_to_file(reader, actor, args.out, chosen, progress=True, keep_stages=args.keep_stages)
    except TrackingInterrupted as interruption:
        _save_partial(interruption.result, args.out)
        discard(unfinished_folder(args.out))
        raise
    print(f"{args.out}: {result.summary()}")
    if args.personal_actor:
        result.rig(actor).save(args.personal_actor)
        learned = "as they were: nothing was learned about them" if result.expressions is None else "as learned"
        print(f"{args.personal_actor}: the rig with the expressions {learned}")
    if args.report:
        _report(result, source, actor, args.report, still_frames=still_frames)
    return 0


def _save_partial(result, out: Path) -> None:
    """Save the frames up to Ctrl-C under another name, so that the result of an earlier run stays."""
    partial = out.with_name(f"{out.stem}.partial.npz")
    earlier = f"; {out} is as it was" if out.exists() else ""
    if not len(result):
        print(f"{out}: not written, no frame was tracked before the interruption{earlier}")
        return
    with CtrlC():
        result.save(partial)
    print(f"{partial}: {len(result)} frames until the interruption{earlier}")


def _report(result, source, actor, folder: Path, **options) -> None:
    from ..evaluation import truth_of
    from ..report import write_report

    path = write_report(result, source, actor, folder, truth_of(source), correctives=result.correctives, **options)
    print(f"report: {path}")


def add_export(commands) -> None:
    """Add the command ``export``."""
    export = add_command(commands, "export")
    add_export_arguments(export)
    export.set_defaults(run=run_export)


def run_export(args: argparse.Namespace) -> int:
    """Run ``export result.npz``."""
    from ..export.command import run_export as run

    return run(args)
