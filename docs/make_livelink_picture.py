"""The docs' picture of a phone that drives a character: ``python docs/make_livelink_picture.py TAKE.csv``.

A part of a take of Live Link Face is sent as the phone sends it, ``adaptiveface live livelink`` receives it in a process of
its own, and what it wrote drives the character.
"""

from __future__ import annotations

import argparse
import dataclasses
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np
from make_screenshots import free_port
from PIL import Image, ImageDraw

from adaptiveface.livelink import ARKIT_NAMES, LiveLinkTake, read_take, write_take
from adaptiveface.livelink.convention import rotations
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.portrait import FACING, portrait

PICTURE = Path(__file__).parent / "images" / "livelink.jpg"
SIZE, COUNT, LARGEST = 300, 5, 3  # pixels and number of portraits, curves named below each
COMMAND = [sys.executable, "-m", "adaptiveface"]


def part(take: LiveLinkTake, start: float, seconds: float) -> LiveLinkTake:
    """The rows of a take from ``start`` s on."""
    times = take.timestamps - take.timestamps[0]
    rows = np.flatnonzero((times >= start) & (times < start + seconds))
    names = [field.name for field in dataclasses.fields(take) if isinstance(getattr(take, field.name), np.ndarray)]
    return dataclasses.replace(take, **{name: getattr(take, name)[rows] for name in names})


def received(take: LiveLinkTake, folder: Path) -> LiveLinkTake:
    """What ``adaptiveface live livelink`` writes of a take that is sent to it."""
    write_take(folder / "sent.csv", take)
    port, out = free_port(), folder / "received.csv"
    seconds = round(take.timestamps[-1] - take.timestamps[0]) + 20
    receive = [*COMMAND, "live", f"livelink:127.0.0.1:{port}", "--out", str(out), "--seconds", str(seconds)]
    with subprocess.Popen(receive, stdout=subprocess.PIPE, text=True) as process:
        print(process.stdout.readline(), end="", flush=True)  # it listens
        send = [*COMMAND, "stream", str(folder / "sent.csv"), "--livelink", f"127.0.0.1:{port}"]
        subprocess.run(send, check=True, stdout=subprocess.DEVNULL)
        print(process.stdout.read().splitlines()[-1])
    return read_take(out)


def distinct(curves: np.ndarray, count: int) -> np.ndarray:
    """Rows of curves (F, 52) that differ most, in order."""
    chosen = [int(np.linalg.norm(curves - curves.mean(axis=0), axis=1).argmax())]
    while len(chosen) < count:
        chosen.append(int(np.min([np.linalg.norm(curves - curves[k], axis=1) for k in chosen], axis=0).argmax()))
    return np.sort(chosen)


def main() -> None:
    """Send, receive, draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("take", type=Path)
    parser.add_argument("--start", type=float, default=0.0, help="seconds into the take")
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--character", default="hag")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        take = received(part(read_take(args.take), args.start, args.seconds), Path(folder))
    character = load_character(args.character)
    weights, turns = character.weights(take.curves), rotations(take.head)
    sheet = Image.new("RGB", (COUNT * SIZE, SIZE + 16 * LARGEST + 8), "white")
    pen = ImageDraw.Draw(sheet)
    for column, row in enumerate(distinct(take.curves, COUNT)):
        picture = portrait(character, character.shape(weights[row]), SIZE, FACING @ turns[row], zoom=1.3)
        sheet.paste(Image.fromarray(picture), (column * SIZE, 0))
        for line, k in enumerate(np.argsort(-take.curves[row])[:LARGEST]):
            text = f"{ARKIT_NAMES[k]} {take.curves[row, k]:.2f}"
            pen.text((column * SIZE + 70, SIZE + 16 * line), text, fill=(60, 60, 60), font_size=14)
    sheet.save(PICTURE, quality=85, optimize=True)


if __name__ == "__main__":
    main()
