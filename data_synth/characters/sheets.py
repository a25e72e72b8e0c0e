"""Contact sheets of a character in every expression, to be looked at."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from adaptiveface.retargeting.character import Character
from adaptiveface.retargeting.portrait import portrait

COLUMNS, SIZE = 11, 190


def write_sheets(character: Character, folder: Path) -> None:
    """``NAME_expressions.png``: the neutral from three sides and every expression alone; ``NAME_mixed.png``: sums."""
    folder.mkdir(parents=True, exist_ok=True)
    count = len(character.expression_names)
    neutral = character.shape(np.zeros(count))
    cells = [("neutral", neutral, yaw) for yaw in (0, 40, 85)]
    for e, name in enumerate(character.expression_names):
        cells.append((name, character.shape(np.eye(count)[e]), 0))
    _write(character, cells, folder / f"{character.name}_expressions.png")
    mixed = {
        "joy": "mouthSmileLeft mouthSmileRight cheekSquintLeft cheekSquintRight jawOpen*0.4",
        "rage": "browDownLeft browDownRight noseSneerLeft noseSneerRight jawOpen*0.6 mouthUpperUpLeft",
        "fear": "browInnerUp eyeWideLeft eyeWideRight mouthStretchLeft mouthStretchRight jawOpen*0.3",
        "sleep": "eyeBlinkLeft eyeBlinkRight mouthPressLeft*0.5 mouthPressRight*0.5",
        "kiss": "mouthPucker eyeBlinkLeft browOuterUpRight",
        "shut": "jawOpen mouthClose",
        "tongue": "tongueOut jawOpen*0.4",
        "half blink": "eyeBlinkLeft*0.5 eyeBlinkRight*0.5",
        "oo": "mouthFunnel jawOpen*0.2",
    }
    cells = []
    for label, text in mixed.items():
        weights = np.zeros(count)
        for word in text.split():
            name, _, value = word.partition("*")
            weights[character.expression_names.index(name)] = float(value or 1)
        cells += [(label, character.shape(weights), yaw) for yaw in (0, 35)]
    _write(character, cells, folder / f"{character.name}_mixed.png", 6, 360)


def _write(character: Character, cells, path: Path, columns: int = COLUMNS, size: int = SIZE) -> None:
    pictures = []
    for label, vertices, yaw in cells:
        image = portrait(character, vertices, size, yaw=yaw)
        pictures.append(cv2.putText(image, label, (4, 14), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (0, 0, 0), 1, cv2.LINE_AA))
    while len(pictures) % columns:
        pictures.append(np.full_like(pictures[0], 255))
    rows = [np.hstack(pictures[i : i + columns]) for i in range(0, len(pictures), columns)]
    cv2.imwrite(str(path), np.vstack(rows)[:, :, ::-1])


def write_overview(characters: list[Character], path: Path, size: int = 260) -> None:
    """One picture: every character (row) neutral, joyful, angry, with closed eyes and open mouth."""
    moods = (
        {},
        {"mouthSmile": 1.0, "cheekSquint": 0.8, "jawOpen": 0.3},
        {"browDown": 1.0, "noseSneer": 0.8},
        {"eyeBlink": 1.0},
        {"jawOpen": 0.9, "browInnerUp": 0.8, "eyeWide": 0.7},
    )
    rows = []
    for character in characters:
        cells = []
        for number, mood in enumerate(moods):
            weights = np.zeros(len(character.expression_names))
            for name, value in mood.items():
                for side in ("", "Left", "Right"):
                    if name + side in character.expression_names:
                        weights[character.expression_names.index(name + side)] = value
            cells.append(portrait(character, character.shape(weights), size, yaw=(0, -22, 22, 0, 28)[number]))
        rows.append(np.hstack(cells))
    cv2.imwrite(str(path), np.vstack(rows)[:, :, ::-1])
