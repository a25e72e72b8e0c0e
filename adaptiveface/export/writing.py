"""Write an export in the chosen format, from a tracked result or from a take of curves."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from tqdm import tqdm

from ..retargeting.character import Character
from ..retargeting.loading import is_gltf
from ..retargeting.retarget import Performance
from ..retargeting.smoothing import FILTERS, Smoothing
from .animation import AnimatedMesh, size_text


@dataclass(frozen=True)
class ExportOptions:
    """The options of an export, as in ``adaptiveface export --help``."""

    character: str = "actor"
    coefficients: str = "resolved"
    smoothing: Smoothing | None = None
    correctives: bool = False
    unit: float | None = None
    insides: bool = True

    @property
    def avatar(self) -> bool:
        """Whether a .glb export is the character's own file with an animation added."""
        return is_gltf(self.character) and not self.correctives


def chosen_filter(args: argparse.Namespace) -> Smoothing | None:
    """The filter of ``--smooth`` and ``--filter``, or None."""
    return FILTERS[args.filter or "one-euro"]() if args.smooth or args.filter else None


def write_avatar(
    out: Path, options: ExportOptions, perform: Callable[[], Performance], covered: Callable[[Character], list[str]]
) -> None:
    """Write the character's own file with a performance added. Prints what ``covered`` says, what does not move, and the size.

    ``perform()`` computes the performance, which may take seconds. It is called once the character's file has been checked.
    """
    from .avatar import Avatar

    avatar = Avatar(options.character, options.unit)
    performance = perform()
    for line in covered(avatar.character) + avatar.write(out, performance):
        print(line)
    size = size_text(avatar.character.neutral) if avatar.face else "not measured"
    print(f"{out}: {avatar.character.name}, {size}, {len(performance)} frames, {len(avatar.rig.expressions)} shapes")


def write_mesh(out: Path, mesh: AnimatedMesh, kind: str, unit: str = "m", compact: bool = False, meshopt: bool = False) -> None:
    """Write one of the mesh formats. The size of large files is printed first.

    Parameters
    ----------
    out : Path
        The file or folder to write.
    mesh : AnimatedMesh
        What to write.
    kind : str
        A key of ``FORMATS``.
    unit : str
        Unit of length of OBJ files and point caches.
    compact, meshopt : bool
        Whether to store 16-bit coordinates in a .glb, and whether to compress it with gltfpack.
    """
    if kind == "glb" and meshopt:
        from .meshopt import write_meshopt_glb

        write_meshopt_glb(out, mesh)
    elif kind == "glb":
        from .gltf import write_glb

        write_glb(out, mesh, compact)
    elif kind in ("usd", "usdz"):
        from .usd import write_usd

        write_usd(out, mesh)
    elif kind in ("mdd", "pc2"):
        from .point_cache import cache_bytes, rest_mesh, write_point_cache

        print(f"{out}: about {cache_bytes(mesh) / 1e6:.0f} MB, and {rest_mesh(out).name}; lengths in {unit}", flush=True)
        write_point_cache(out, mesh, unit, partial(tqdm, unit="frame", disable=None))
    else:
        from .obj_sequence import sequence_bytes, write_obj_sequence
        from .point_cache import cache_bytes

        other = f"; --format pc2 takes {cache_bytes(mesh) / 1e6:.0f} MB" if len(mesh) > 1 else ""
        size = f"{len(mesh)} files, about {sequence_bytes(mesh, unit) / 1e6:.0f} MB"
        print(f"{out}: {size}; lengths in {unit}{other}", flush=True)
        write_obj_sequence(out, mesh, unit, partial(tqdm, unit="frame", disable=None))
