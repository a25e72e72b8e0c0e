"""Drive a character by a take of Live Link Face, without tracking: ``adaptiveface export take.csv``."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ..errors import ParameterError
from ..formats import UNITS
from ..livelink import ARKIT_NAMES, LiveLinkTake, read_take
from ..retargeting import BUILT_IN
from ..retargeting.character import Character
from ..retargeting.loading import is_gltf, load_character
from ..retargeting.retarget import Performance, undriven
from ..retargeting.smoothing import Smoothing
from .animation import AnimatedMesh, character_animation
from .arkit_csv import take_performance, write_arkit_csv
from .writing import ExportOptions, chosen_filter, write_avatar, write_mesh

#: Options of ``export`` that need a tracked result, and their default values.
_OF_RESULTS = {"coefficients": None, "correctives": False, "actor": None, "source": None, "compare": False}


def run_take_export(args: argparse.Namespace, out: Path, smoothing: Smoothing | None) -> int:
    """Write a take in ``args.format`` to ``out``. Returns the exit status. Raises :class:`AdaptiveFaceError`."""
    given = [f"--{name}" for name, default in _OF_RESULTS.items() if getattr(args, name) != default]
    if given:
        raise ParameterError(f"{args.result}: it is a take of curves; {', '.join(given)} needs a tracked result.npz")
    take = read_take(args.result)
    performance = take_performance(take).smoothed(smoothing)
    _say(take)
    if args.format == "arkit-csv":
        write_arkit_csv(out, performance)
        print(f"{out}: {len(performance)} frames")
        return 0
    if args.character == "actor":
        raise ParameterError(f"{args.result}: a take has no mesh of its own; --character {', '.join(BUILT_IN)} or a file")
    unit = UNITS.get(args.unit)
    if args.format == "glb" and is_gltf(args.character):
        write_avatar(out, ExportOptions(args.character, unit=unit), lambda: performance, lambda c: take_coverage(take, c))
        return 0
    character = load_character(args.character, unit)
    for line in take_coverage(take, character):
        print(line)
    mesh = character_animation(character, performance)
    if args.format in ("mp4", "gif"):
        write_character_video(out, mesh, performance, args.turntable)
    else:
        write_mesh(out, mesh, args.format, args.out_unit, args.compact, args.meshopt)
    print(f"{out}: {mesh.description}")
    return 0


def stream_take(args: argparse.Namespace) -> int:
    """``adaptiveface stream take.csv``: send a take's curves at the speed of the take. Returns the exit status."""
    from .destinations import addresses, avatar, said
    from .messages import FaceState
    from .stream import Pace, Sender

    for name in ("actor", "mirrored"):
        if getattr(args, name):
            raise ParameterError(f"{args.source}: it is a take of curves; --{name} needs a recording")
    take = read_take(args.source)
    performance = take_performance(take).smoothed(chosen_filter(args))
    found = addresses(args, default_vmc=True)
    sender, pace = Sender(**found, avatar=avatar(args)), Pace()
    _say(take)
    print("\n".join(said(found)))
    turns = take.head_rotations()
    curves = np.clip(performance.curves, 0, 1)
    frames = zip(performance.timestamps, take.tracked, curves, turns, performance.eye_angles, strict=True)
    for time, tracked, values, turn, eyes in tqdm(frames, total=len(take), unit="frame", disable=None):
        if not args.fast:
            pace.wait(time)
        sender.send(FaceState(float(take.timestamps[0] + time), bool(tracked), values, turn, eyes=eyes))
    print(f"{sender.sent} frames sent")
    return 0


def _say(take: LiveLinkTake) -> None:
    if take.absent:
        print(f"columns that the take lacks, zero here: {', '.join(take.absent)}")
    lost = int((~take.tracked).sum())
    if lost:
        print(f"{lost} of {len(take)} rows have no face and repeat the one before")


def take_coverage(take: LiveLinkTake, character: Character) -> list[str]:
    """Lines about what will not show: moving curves that the character lacks, and shapes that nothing drives."""
    moving = {name for name, curve in zip(ARKIT_NAMES, take.curves.T, strict=True) if np.ptp(curve) > 1e-3}
    missing = [name for name in character.missing if name in moving]
    lines = [f"{character.name} lacks: {', '.join(missing)}"] if missing else []
    return lines + undriven(character) + list(character.notes)


def write_character_video(path: Path, mesh: AnimatedMesh, performance: Performance, turntable: bool = False) -> None:
    """Film the character alone, as ``.mp4`` or ``.gif``."""
    from .video import character_panel, turntable_panel, write_film

    panel = turntable_panel(mesh) if turntable else character_panel(mesh)
    write_film(path, [panel], [mesh.name], performance.timestamps)
