"""What limits projection and learning: how many bytes a learned frame moves, and how many the machine moves in a second."""

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

    Anchors and samples are read twice: for the products with the displacement, and for the combination of them that is its
    part in the adaptive space. Then the new sample takes its row. What EM works on has the size of the buffer only.
    """
    length, anchors = model.anchors.shape
    return (2 * (anchors + model.count) + 1) * length * model._samples.itemsize


def traffic_line(model: AdaptiveModel, ms: float) -> str:
    """What projection and learning move, and their time ``ms`` as a multiple of what the machine needs to move it."""
    moved, rate = learned_step_bytes(model), stream_rate()
    least = moved / rate * 1e3
    return (
        f"projection and learning move {moved / 1e6:.1f} MB a frame; this machine reads {rate / 1e9:.1f} GB/s: "
        f"{least:.2f} ms, of which they take {ms / least:.1f} times"
    )
