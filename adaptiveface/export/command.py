"""Do what ``adaptiveface export``, ``stream`` and ``demo --character`` ask for; the command line only parses their options."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..errors import ParameterError
from ..files import check_output, check_output_folder
from ..formats import UNITS
from ..livelink.take import is_take
from ..model.actor import Actor
from ..result import Result
from ..retargeting import COEFFICIENTS
from ..retargeting.arkit import arkit_weights
from ..retargeting.arkit_resolve import has_units
from ..retargeting.character import Character
from ..retargeting.correctives import carried_correctives
from ..retargeting.loading import is_gltf, load_character
from ..retargeting.retarget import coverage, driving_names, retarget
from ..runtime.timing import clean_times, increasing
from .animation import AnimatedMesh, actor_animation, character_animation, with_correctives
from .arguments import FORMATS
from .inside_parts import actor_insides, with_insides
from .writing import ExportOptions, chosen_filter, write_avatar, write_mesh


def run_export(args: argparse.Namespace) -> int:
    """``adaptiveface export``."""
    out = _output(args)
    if is_take(args.result):
        from .take import run_take_export

        return run_take_export(args, out, chosen_filter(args))
    result = _timed(Result.load(args.result), args.result)
    actor = _actor(args.actor, args.result.parent, result)
    options = ExportOptions(
        args.character, _coefficients(args, actor), chosen_filter(args), args.correctives, UNITS.get(args.unit), args.insides
    )
    if args.format == "arkit-csv":
        _write_curves(out, result, actor, options)
    elif args.format in ("mp4", "gif"):
        _write_film(out, args, result, actor, options)
    elif args.format == "glb" and options.avatar:
        table = arkit_weights(driving_names(result, options.coefficients))
        write_avatar(
            out, options, lambda: retarget(result, options.coefficients, options.smoothing, actor), lambda c: coverage(table, c)
        )
    else:
        mesh = animated(result, actor, options)
        write_mesh(out, mesh, args.format, args.out_unit, args.compact, args.meshopt)
        print(f"{out}: {mesh.description}")
    return 0


def _write_curves(out: Path, result: Result, actor: Actor | None, options: ExportOptions) -> None:
    """Write the curves as a take of Live Link Face. Prints which expressions will not show."""
    from .arkit_csv import write_arkit_csv

    performance = retarget(result, options.coefficients, options.smoothing, actor)
    if performance.unknown:
        print(f"no ARKit counterpart: {', '.join(performance.unknown)}")
    write_arkit_csv(out, performance)
    print(f"{out}: {len(performance)} frames")


def _write_film(out: Path, args: argparse.Namespace, result: Result, actor: Actor | None, options: ExportOptions) -> None:
    """Write a film of the tracked mesh, and of the source and the characters that the options ask for."""
    from ..sensors import open_source
    from ..sensors.orientation import as_tracked

    source = as_tracked(open_source(args.source, args.fov), result) if args.source else None
    if source is not None and len(source) != len(result):
        raise ParameterError(f"{source.name} has {len(source)} frames, the result {len(result)}: another recording")
    meshes = [] if args.character == "actor" else [animated(result, actor, options)]
    if args.compare and meshes:
        names = COEFFICIENTS[::-1]
        meshes = [animated(result, actor, replace(options, coefficients=name)) for name in names]
        meshes = [replace(m, name=f"{m.name}, {name}") for m, name in zip(meshes, names, strict=True)]
    write_performance_video(out, result, meshes, source, args.turntable, actor=actor, insides=args.insides)
    print(f"{out}: {len(result)} frames")


def _timed(result: Result, path: Path) -> Result:
    """The result with timestamps that suit every format. Prints what was repaired."""
    times = clean_times(result.timestamps, str(path))
    for note in times.notes:
        print(note)
    return replace(result, timestamps=times.seconds)


def _coefficients(args: argparse.Namespace, actor: Actor | None) -> str:
    """The kind of coefficients that drives characters: ARKit's shapes, unless another was asked for or the rig is missing."""
    if args.coefficients == "arkit" and args.correctives:
        raise ParameterError("--coefficients arkit: does not go with --correctives, which carry what the expressions lack")
    automatic = "arkit" if has_units(actor) and not args.correctives else "resolved"
    return args.coefficients or automatic


def _output(args: argparse.Namespace) -> Path:
    if (args.compact or args.meshopt) and (args.format != "glb" or (is_gltf(args.character) and not args.correctives)):
        what = "a character's own file, which stays as it is" if args.format == "glb" else args.format
        raise ParameterError(
            f"{'--meshopt' if args.meshopt else '--compact'}: only for .glb files that are written anew, not for {what}"
        )
    if args.meshopt:
        from .meshopt import find_gltfpack

        find_gltfpack()  # before any work
    suffix = FORMATS[args.format]
    name = "arkit" if args.format == "arkit-csv" else Path(args.character).stem
    out = args.out or args.result.with_name(f"{args.result.stem}-{name}{suffix or '-obj'}")
    inputs = [args.result, args.character, args.actor, args.source]
    if args.format == "obj":
        from .obj_sequence import is_of_sequence

        return check_output_folder(out, is_of_sequence, inputs)
    if args.format in ("mdd", "pc2"):
        check_output(out.with_suffix(".obj"), "rest-mesh", inputs)
    avatar = args.format == "glb" and is_gltf(args.character)
    return check_output(out, "avatar" if avatar else args.format, inputs)


def _actor(path: Path | None, folder: Path, result: Result) -> Actor | None:
    if path is not None:
        return Actor.load(path)
    beside = folder / "actor.npz"
    if not beside.is_file():
        return None
    actor = Actor.load(beside)
    return actor if np.array_equal(actor.triangles, result.triangles) else None


def animated(result: Result, actor: Actor | None, options: ExportOptions) -> AnimatedMesh:
    """The animated mesh that the options ask for. Prints which shapes will not show."""
    if options.character == "actor":
        mesh = actor_animation(result, actor)
        return with_insides(mesh, result, actor) if options.insides else mesh
    character = load_character(options.character, options.unit)
    for line in coverage(arkit_weights(driving_names(result, options.coefficients)), character):
        print(line)
    return animated_character(result, actor, character, options)


def animated_character(result: Result, actor: Actor | None, character: Character, options: ExportOptions) -> AnimatedMesh:
    """A loaded character driven by a result."""
    mesh = character_animation(character, retarget(result, options.coefficients, options.smoothing, actor))
    if not options.correctives:
        return mesh
    if actor is None:
        raise ParameterError("--correctives needs the actor's rig: --actor actor.npz")
    return with_correctives(mesh, carried_correctives(result, actor, character, options.coefficients))


def write_performance_video(
    path: Path,
    result: Result,
    meshes: list[AnimatedMesh],
    source=None,
    turntable: bool = False,
    step: int = 1,
    actor: Actor | None = None,
    insides: bool = True,
) -> None:
    """Film every ``step``-th frame: the input if there is a source, the tracked mesh and animated characters, side by side.

    With ``insides``, the tracked mesh has eyes, teeth and a tongue, which are fitted to ``actor`` if it is given.
    """
    from .video import character_panel, input_panel, tracked_panel, turntable_panel, write_film

    panels, labels = [tracked_panel(result, actor_insides(result, actor) if insides else None)], ["tracked"]
    if source is not None:
        panels, labels = [input_panel(source, result), *panels], ["input", *labels]
    for mesh in meshes:
        panels.append(turntable_panel(mesh) if turntable else character_panel(mesh))
        labels.append(mesh.name)
    write_film(path, panels, labels, increasing(result.timestamps), step)


def demo_character_files(character: Character) -> dict[str, str]:
    """Name -> kind of the files that :func:`write_demo_character` writes."""
    return {f"{character.name}.glb": "glb", f"{character.name}.mp4": "mp4"}


def write_demo_character(name: str, result: Result, actor: Actor, source, folder: Path) -> list[Path]:
    """``demo --character``: write NAME.glb and NAME.mp4 (with half of the frames) beside the report.

    A character that comes from a .glb keeps its own file. Others get the actor's correctives if they can be transferred.
    """
    from .gltf import write_glb

    character = load_character(name)
    options = ExportOptions(name, correctives=character.shares_topology(actor.triangles))
    paths = [folder / file for file in demo_character_files(character)]
    mesh = animated_character(result, actor, character, options)
    if options.avatar:
        write_avatar(paths[0], options, lambda: retarget(result, actor=actor), lambda c: list(c.notes))
    else:
        write_glb(paths[0], mesh)
    write_performance_video(paths[1], result, [mesh], source, step=2, actor=actor)
    return paths


def run_stream(source, parameters, args: argparse.Namespace) -> int:
    """``adaptiveface stream``: track ``source`` and send every frame."""
    from ..pipeline import FrameReader, capture_source, track_source
    from .destinations import addresses, avatar, said
    from .stream import Pace, Streamer

    found, receiver = addresses(args, default_vmc=True), avatar(args)  # errors must be raised before the capture
    with FrameReader(source, remember=not args.actor) as reader:
        if args.actor:
            actor = Actor.load(args.actor)
        else:
            actor = capture_source(reader, parameters, args.neutral_frames, progress=True)
        streamer = Streamer(
            actor,
            parameters.blendshapes.A,
            smoothing=chosen_filter(args),
            avatar=receiver,
            halves=has_units(actor),
            parameters=parameters.blendshapes,
            **found,
        )
        if streamer.unknown:
            print(f"no ARKit counterpart: {', '.join(streamer.unknown)}")
        print("\n".join(said(found)))
        pace = Pace()

        def on_frame(tracked, frame):
            """Send every frame, at the speed of the recording by default."""
            if not args.fast:
                pace.wait(tracked.timestamp)
            streamer.send(tracked, frame)

        result = track_source(reader, actor, parameters, progress=True, on_frame=on_frame)
    print(result.summary())
    print(f"{streamer.sent} frames sent")
    return 0
