"""Declare the options of ``export`` and ``stream``, apart from the exporters, so that the command line starts fast."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..formats import UNITS
from ..retargeting import BUILT_IN, DRIVERS

#: Suffix of the output by format. "" stands for a folder.
FORMATS = {
    "glb": ".glb",
    "arkit-csv": ".csv",
    "obj": "",
    "mdd": ".mdd",
    "pc2": ".pc2",
    "usd": ".usdc",
    "usdz": ".usdz",
    "mp4": ".mp4",
    "gif": ".gif",
}


def add_personal_actor(command: argparse.ArgumentParser) -> None:
    """Add the option of ``track`` and ``live`` that saves what was learned about the person's expressions."""
    command.add_argument(
        "--personal-actor",
        type=Path,
        metavar="FILE",
        help="also save the rig with the expressions as this performance taught them; give it to the next one as --actor",
    )


def add_export_arguments(command: argparse.ArgumentParser) -> None:
    """Add the options of ``adaptiveface export``."""
    command.add_argument(
        "result",
        type=Path,
        metavar="result.npz",
        help="result to export, or a take of Live Link Face (.csv) that drives --character",
    )
    command.add_argument(
        "--character",
        default="actor",
        metavar="NAME",
        help=f"what performs: actor (the tracked mesh itself), {', '.join(BUILT_IN)}, a .glb, .vrm or .npz file, or a "
        "folder of OBJ files with ARKit names (default: %(default)s)",
    )
    command.add_argument(
        "--unit",
        choices=tuple(UNITS),
        help="unit of length of the character's file (default: metres for .glb, .gltf and .vrm; told from "
        "the size of the head for OBJ files)",
    )
    command.add_argument("--format", choices=tuple(FORMATS), default="glb", help="what to write (default: %(default)s)")
    command.add_argument(
        "--out", type=Path, metavar="FILE", help="file to write, or folder of obj (default: beside the result)"
    )
    command.add_argument("--compact", action="store_true", help="glb: store 16-bit coordinates, for less than half the size")
    command.add_argument(
        "--meshopt",
        action="store_true",
        help="glb: compress to an eighth of the size with gltfpack, for three.js and others that can decode it",
    )
    command.add_argument(
        "--no-insides", dest="insides", action="store_false", help="leave out the actor's eyes, teeth and tongue"
    )
    command.add_argument(
        "--out-unit",
        choices=tuple(UNITS),
        default="m",
        help="obj, mdd, pc2: unit of length to write, m for Blender, cm for Maya (default: %(default)s)",
    )
    command.add_argument(
        "--coefficients",
        choices=DRIVERS,
        help="what drives the character: arkit, ARKit's shapes with their halves, solved from the final mesh; resolved, the "
        "tracked expressions, solved from the final mesh; initial, those of the first fit (default: arkit where actor.npz "
        "is there)",
    )
    _add_smoothing(command)
    command.add_argument(
        "--correctives",
        action="store_true",
        help="also carry what the blendshapes lack (v4 - v1) to a character with the actor's mesh",
    )
    add_actor(command, "the one beside the result")
    _add_film(command)


def _add_film(command: argparse.ArgumentParser) -> None:
    """Add the options of films: what they show beside the mesh, and from which side."""
    command.add_argument("--source", metavar="SOURCE", help="mp4, gif: show the recording's pictures beside the meshes")
    add_field_of_view(command)
    command.add_argument(
        "--compare",
        action="store_true",
        help="mp4, gif: show the character driven by the initial and by the re-solved coefficients (figure 8)",
    )
    command.add_argument("--turntable", action="store_true", help="mp4, gif: let the camera circle the character")


def add_actor(command: argparse.ArgumentParser, default: str) -> None:
    """Add ``--actor``. ``default`` tells its users what is used without it."""
    command.add_argument("--actor", type=Path, metavar="actor.npz", help=f"the person's rig (default: {default})")


def add_field_of_view(command: argparse.ArgumentParser) -> None:
    """``--fov``, the field of view of a video."""
    command.add_argument(
        "--fov",
        type=degrees,
        metavar="DEGREES",
        help="field of view of a video, across its longer side (default: from an intrinsic.json beside it, else 60)",
    )


def degrees(text: str) -> float:
    """The argparse type of a field of view."""
    from ..geometry.camera import FIELD_OF_VIEW_RANGE

    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    low, high = FIELD_OF_VIEW_RANGE
    if not low <= value <= high:
        raise argparse.ArgumentTypeError(f"{text!r} is not a field of view between {low:g} and {high:g} degrees")
    return value


def add_stream_arguments(command: argparse.ArgumentParser) -> None:
    """Options of ``adaptiveface stream`` besides the source and the parameters."""
    add_destinations(command)
    add_actor(command, "captured from the leading frames")
    _add_smoothing(command)
    command.add_argument(
        "--fast", action="store_true", help="send as fast as possible instead of at the speed of the recording"
    )


def add_destinations(command: argparse.ArgumentParser) -> None:
    """Options that say where to send. The default HOST is this machine."""
    command.add_argument(
        "--vmc", nargs="?", const="", metavar="HOST:PORT", help="send VMC messages to an avatar (default: 127.0.0.1:39539)"
    )
    command.add_argument(
        "--osc",
        nargs="?",
        const="",
        metavar="HOST:PORT",
        help="send plain OSC messages and those of Face Cap (default: 127.0.0.1:9000)",
    )
    command.add_argument(
        "--livelink",
        nargs="?",
        const="",
        metavar="HOST:PORT",
        help="send what Live Link Face sends to Unreal (default: 127.0.0.1:11111)",
    )
    command.add_argument(
        "--vmc-avatar",
        type=Path,
        metavar="FILE",
        help=".vrm or .glb of the avatar that receives VMC, so that its bones keep their places",
    )
    command.add_argument("--vmc-root", action="store_true", help="let the avatar follow the head through the room")


def _add_smoothing(command: argparse.ArgumentParser) -> None:
    command.add_argument("--smooth", action="store_true", help="smooth the curves")
    command.add_argument("--filter", choices=("one-euro", "kalman"), help="how to smooth (default: one-euro)")
