"""Every case of ``shared/cases/README.md``, run as a user would, with the value it prints: ``python tests/case_table.py``.

A row is (file, what is right, what came out). The exit status is 1 when a row is wrong.
"""

from __future__ import annotations

import contextlib
import io
import re
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

CASES = Path(__file__).resolve().parents[2] / "shared" / "cases"
SIZE = re.compile(r"(\d+) x (\d+) x (\d+) mm")

#: Character file -> what its export must say: the size, or a text.
CHARACTERS = {
    "plain.glb": "159 x 220 x 179 mm",
    "skin_cm_zup.glb": "159 x 220 x 179 mm",
    "default_weights.glb": "239 x 220 x 179 mm",
    "whole_and_halves.glb": "browInnerUp moves 9.8 mm; the note names what is not driven",
    "other_scene.glb": "159 x 220 x 179 mm",
    "strip.glb": "159 x 220 x 179 mm",
    "cm_no_scale.glb": "one line: how large the head is, and --unit",
    "vrm1_presets.vrm": "driven as VRM presets",
}
VIDEO = "0.800 s and 2.280 s"


def export(result: Path, character: Path, out: Path) -> str:
    """What ``adaptiveface export`` prints for a character; a failure is the text of its error."""
    from adaptiveface import cli

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
        cli.main(["export", str(result), "--character", str(character), "--out", str(out)])
    return printed.getvalue()


def brow(path: Path) -> float:
    """mm that browInnerUp at 1 moves the vertex that it moves most."""
    from adaptiveface.retargeting.arkit import ARKIT_NAMES
    from adaptiveface.retargeting.loading import load_character

    character = load_character(path)
    curves = np.zeros((2, len(ARKIT_NAMES)))
    curves[1, ARKIT_NAMES.index("browInnerUp")] = 1.0
    rest, moved = character.shape(character.weights(curves))
    return float(np.linalg.norm(moved - rest, axis=1).max())


def character_row(name: str, result: Path, folder: Path) -> tuple[str, bool]:
    """(what came out, whether it is right) for one character file."""
    path = CASES / "characters" / name
    text = export(result, path, folder / f"{Path(name).stem}.glb")
    lines = text.splitlines()
    if name == "whole_and_halves.glb":
        moved = brow(path)
        note = next((line for line in lines if "not driven" in line), "no note")
        return f"{moved:.1f} mm; {note}", abs(moved - 9.8) < 0.1 and "browInnerUp_L" in note
    if name == "cm_no_scale.glb":
        note = next((line for line in lines if "--unit" in line), "no word")
        return note[note.find("the head") :], "22 m high" in note
    if name == "vrm1_presets.vrm":
        note = next((line for line in lines if "VRM presets" in line), lines[-1] if lines else "")
        return note, {"aa", "blinkLeft", "blinkRight", "happy"} <= {*re.findall(r"\w+", note)}
    size = SIZE.search(text)
    return size.group(0) if size else lines[-1] if lines else "", bool(size) and size.group(0) == CHARACTERS[name]


def video_row(folder: Path) -> tuple[str, bool]:
    """(times of frames 20 and 40 of the tracked video, whether they are right)."""
    from adaptiveface import Result, cli

    out = folder / "v.npz"
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        cli.main(["track", str(CASES / "videos" / "vfr.mp4"), "--neutral-frames", "20", "--out", str(out)])
    times = Result.load(out).timestamps
    return f"{times[20]:.3f} s and {times[40]:.3f} s", bool(np.allclose(times[[20, 40]], [0.8, 2.28], atol=1e-3))


def rows(result: Path, folder: Path) -> Iterator[tuple[str, str, str, bool]]:
    """(file, right, what came out, whether it is right) of every case."""
    for name, right in CHARACTERS.items():
        yield (f"characters/{name}", right, *character_row(name, result, folder))
    yield ("videos/vfr.mp4", VIDEO, *video_row(folder))


def main() -> int:
    """Print the table; needs no tracked result of one's own."""
    from export_scene import tracked_result

    if not CASES.is_dir():
        print(f"no cases at {CASES}")
        return 1
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        actor, result, _ = tracked_result()
        actor.save(folder / "actor.npz")
        result.save(folder / "result.npz")
        table = [*rows(folder / "result.npz", folder)]
    for file, right, came, good in table:
        print(f"{'right' if good else 'WRONG':<6} {file:<34} {came}   [{right}]")
    return 0 if all(good for *_, good in table) else 1


if __name__ == "__main__":
    sys.exit(main())
