"""Find what limits projection and learning: the bytes that a learned frame moves, and those that the machine can move."""

from __future__ import annotations

import numpy as np

from ..tracking.adaptive_pca import AdaptiveModel
from .peers import cpu_clock

#: Size of the array that is read, bytes. It is larger than the caches of the machines that track faces.
STREAMED = 128 << 20


def stream_rate(repeats: int = 5) -> float:
    """Measure the bytes per second of processor time that one thread reads from memory. The fastest of some passes counts."""
    array = np.ones(STREAMED // 4, np.float32)
    best = np.inf
    for _ in range(repeats):
        start = cpu_clock()
        float(array @ array)
        best = min(best, cpu_clock() - start)
    return array.nbytes / best


def learned_step_bytes(model: AdaptiveModel) -> int:
    """Count the bytes that one learned frame reads and writes in arrays whose size grows with the mesh.

    Anchors and samples are read twice: for their products with the displacement, and for the combination of them that is the
    displacement's part in the adaptive space. Then the new sample is written to its row. EM works on arrays whose size
    depends only on the buffer.
    """
    length, anchors = model.anchors.shape
    return (2 * (anchors + model.count) + 1) * length * model._samples.itemsize


def traffic_line(model: AdaptiveModel, ms: float) -> str:
    """Say what projection and learning move, and compare their time ``ms`` with the time that the machine needs to move it."""
    moved, rate = learned_step_bytes(model), stream_rate()
    least = moved / rate * 1e3
    return (
        f"projection and learning move {moved / 1e6:.1f} MB a frame; this machine reads {rate / 1e9:.1f} GB/s: "
        f"{least:.2f} ms, of which they take {ms / least:.1f} times"
    )
