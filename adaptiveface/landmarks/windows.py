"""Choose the windows of a picture in which to search for a face that is too small for the detector.

MediaPipe shrinks its input to about 200 pixels. A face below about a twelfth of the longer side is lost in the whole picture.
"""

from __future__ import annotations

import numpy as np

#: A face wider than this share of the picture's longer side is found and followed in the whole picture.
LARGE = 0.14
#: Side of a face's own window, as a multiple of the face's size.
ROOM = 3.5

#: A window: u and v of its first pixel, and u and v one past its last pixel.
Window = tuple[int, int, int, int]


def search_windows(height: int, width: int) -> list[Window]:
    """Choose overlapping squares that cover a picture of ``height`` x ``width`` pixels, the middle one first.

    There are three along the longer side. If the longer side is less than 1.5 times the shorter one, there are five: the
    middle and the four corners.
    """
    long, side = max(height, width), min(height, width)
    if long < 1.5 * side:
        side = min(round(0.55 * long) + 1, side)
        places = [((width - side) // 2, (height - side) // 2)]
        places += [(u, v) for v in (0, height - side) for u in (0, width - side)]
    else:
        places = [(round(share * (width - side)), round(share * (height - side))) for share in (0.5, 0.0, 1.0)]
    return [(u, v, u + side, v + side) for u, v in places]


def own_window(mesh: np.ndarray, height: int, width: int) -> Window | None:
    """Choose the window in which to search next for a face (n, 2 or more) px, or None if the face is large enough."""
    low, high = mesh[:, :2].min(axis=0), mesh[:, :2].max(axis=0)
    size = float((high - low).max())
    if float(high[0] - low[0]) > LARGE * max(height, width):
        return None
    side = int(min(max(ROOM * size, 64), height, width))
    u, v = np.rint((low + high - side) / 2).astype(int)
    u, v = int(np.clip(u, 0, width - side)), int(np.clip(v, 0, height - side))
    return u, v, u + side, v + side
