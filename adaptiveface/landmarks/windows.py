"""Parts of a picture in which a face is sought that is too small for the detector in the whole of it.

MediaPipe shrinks what it gets to about 200 pixels: a face below about a twelfth of the longer side is lost then.
"""

from __future__ import annotations

import numpy as np

#: A face wider than this share of the picture's longer side is found in the whole picture, and followed there.
LARGE = 0.14
#: Side of a face's own window, in sizes of the face.
ROOM = 3.5

#: A window: u, v of its first pixel, and of the one behind its last.
Window = tuple[int, int, int, int]


def search_windows(height: int, width: int) -> list[Window]:
    """Overlapping squares that cover a picture: three along its longer side, the middle one first.

    Of a picture that is less than half as long again as it is high or wide: its middle and its four corners.
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
    """The window around a face (n, 2 or more) px in which it is sought next; None where it is large enough without."""
    low, high = mesh[:, :2].min(axis=0), mesh[:, :2].max(axis=0)
    size = float((high - low).max())
    if float(high[0] - low[0]) > LARGE * max(height, width):
        return None
    side = int(min(max(ROOM * size, 64), height, width))
    u, v = np.rint((low + high - side) / 2).astype(int)
    u, v = int(np.clip(u, 0, width - side)), int(np.clip(v, 0, height - side))
    return u, v, u + side, v + side
