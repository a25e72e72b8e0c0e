"""Options of ``adaptiveface export`` and ``stream``; apart from the work, so that the command line starts fast."""

from __future__ import annotations

import argparse
from pathlib import Path

from ..retargeting import BUILT_IN, DRIVERS, UNITS

#: format -> what the output's name ends in ("": a folder).
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


def add_export_arguments(command: argparse.ArgumentParser) -> None:
    """Options of ``adaptiveface export``."""
    command.add_argument(
        "result",
        type=Path,
        metavar="result.npz",
        help="a tracked result, or a take of Live Link Face (.csv), which drives --character",
    )
    command.add_argument(
        "--character",
        default="actor",
        metavar="NAME",
        help=f"actor (the tracked mesh itself), {', '.join(BUILT_IN)}, or a .glb, .vrm, .npz file or "
        "folder of OBJ files with ARKit names (default: %(default)s)",
    )
    command.add_argument(
        "--unit",
        choices=tuple(UNITS),
        help="unit of length of the character's file (default: metres for .glb, .gltf and .vrm; told from "
        "the size of the head for OBJ files)",
    )
    command.add_argument("--format", choices=tuple(FORMATS), default="glb", help="default: %(default)s")
    command.add_argument("--out", type=Path, metavar="FILE", help="default: beside the result; obj: a folder")
    command.add_argument("--compact", action="store_true", help="glb: 16-bit coordinates, under half the size")
    command.add_argument(
        "--meshopt",
        action="store_true",
        help="glb: compressed to an eighth by gltfpack, for three.js and others with a decoder",
    )
    command.add_argument(
        "--no-insides", dest="insides", action="store_false", help="leave out the actor's eyes, teeth and tongue"
    )
    command.add_argument(
        "--out-unit",
        choices=tuple(UNITS),
        default="m",
        help="obj, mdd, pc2: unit of length, m for Blender, cm for Maya (default: %(default)s)",
    )
    command.add_argument(
        "--coefficients",
        choices=DRIVERS,
        help="arkit: ARKit's shapes with their halves, solved from v4; resolved: the tracked expressions, "
        "solved from v4; initial: of the first fit (default: arkit where actor.npz is there)",
    )
    _add_smoothing(command)
    command.add_argument("--correctives", action="store_true", help="also carry v4 - v1 to a character of the actor's topology")
    command.add_argument("--actor", type=Path, metavar="actor.npz", help="default: the one beside the result, if any")
    command.add_argument("--source", metavar="SOURCE", help="mp4, gif: show the recording's pictures beside the meshes")
    add_field_of_view(command)
    command.add_argument(
        "--compare", action="store_true", help="mp4, gif: the character by initial and by re-solved coefficients (figure 8)"
    )
    command.add_argument("--turntable", action="store_true", help="mp4, gif: the camera circles the character")


def add_field_of_view(command: argparse.ArgumentParser) -> None:
    """``--fov``, of a video."""
    command.add_argument(
        "--fov",
        type=degrees,
        metavar="DEGREES",
        help="of a video: what its camera saw across the longer side (default: by an intrinsic.json beside it, else 60)",
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
    command.add_argument("--actor", type=Path, metavar="actor.npz", help="default: captured from the leading frames")
    _add_smoothing(command)
    command.add_argument("--fast", action="store_true", help="do not hold a recording back to its own speed")


def add_destinations(command: argparse.ArgumentParser) -> None:
    """Where to send; every HOST is this machine unless it is named."""
    command.add_argument(
        "--vmc", nargs="?", const="", metavar="HOST:PORT", help="VMC messages to avatars (default: 127.0.0.1:39539)"
    )
    command.add_argument(
        "--osc", nargs="?", const="", metavar="HOST:PORT", help="plain OSC messages, and Face Cap's (default: 127.0.0.1:9000)"
    )
    command.add_argument(
        "--livelink",
        nargs="?",
        const="",
        metavar="HOST:PORT",
        help="as Live Link Face sends to Unreal (default: 127.0.0.1:11111)",
    )
    command.add_argument(
        "--vmc-avatar", type=Path, metavar="FILE", help="the .vrm or .glb that receives VMC: its bones keep their places"
    )
    command.add_argument("--vmc-root", action="store_true", help="the avatar follows the head through the room")


def _add_smoothing(command: argparse.ArgumentParser) -> None:
    command.add_argument("--smooth", action="store_true", help="filter the curves")
    command.add_argument("--filter", choices=("one-euro", "kalman"), help="smooth with it (default: one-euro)")
