"""What limits the incremental PCA: how many bytes a learned frame moves, and how many the machine moves in a second."""

from __future__ import annotations

import numpy as np

from ..tracking.adaptive_pca import AdaptiveModel
from .peers import cpu_clock

#: Larger than the caches of the machines that track faces, bytes.
STREAMED = 128 << 20


def stream_rate(repeats: int = 5) -> float:
    """Bytes per second of processor time that one thread reads from memory, the fastest of some passes over one array."""
    array = np.ones(STREAMED // 4, np.float32)
    best = np.inf
    for _ in range(repeats):
        start = cpu_clock()
        float(array @ array)
        best = min(best, cpu_clock() - start)
    return array.nbytes / best


def learned_step_bytes(model: AdaptiveModel) -> int:
    """Bytes that the passes of one learned frame read and write, over arrays whose size grows with the mesh.

    Two passes over the samples cannot be spared: the new sample's products with them decide the combination of them that
    the second pass makes.
    """
    length, anchors = model.anchors.shape
    correctives, samples, single, double = model.correctives.shape[1], model.count, 4, 8
    classified = 2 * anchors * single
    stored = samples * single + correctives * double
    combined = samples * single + correctives * (2 * single + double)
    cleaned = (anchors + correctives) * double + (anchors + correctives) * single + correctives * (single + 2 * double)
    orthonormal = 3 * correctives * double
    return length * (classified + stored + combined + cleaned + orthonormal)


def traffic_line(model: AdaptiveModel, ms: float) -> str:
    """What a learned frame moves, and its time ``ms`` as a multiple of what the machine needs to move it."""
    moved, rate = learned_step_bytes(model), stream_rate()
    least = moved / rate * 1e3
    return (
        f"adaptive_pca moves {moved / 1e6:.1f} MB a learned frame; this machine reads {rate / 1e9:.1f} GB/s: {least:.2f} ms, "
        f"of which it takes {ms / least:.1f} times"
    )
