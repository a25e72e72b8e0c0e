"""Two figures of docs/architecture.md: ``python docs/frame_figures.py [RECORDING]``; without a recording, of the demo.

How often correspondences are searched in a frame, by stage. A search repeats another one of its frame when surface, points,
normals, pose and limits are the same bytes; such a search would be superfluous. And how far head-frame meshes that are
computed from what a result keeps (camera frame, single precision) are from the tracker's.
"""

from __future__ import annotations

import argparse
import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from unittest.mock import patch

import numpy as np

from adaptiveface.geometry.frame import RgbdFrame
from adaptiveface.parameters import Parameters
from adaptiveface.pipeline import FrameReader, capture_source
from adaptiveface.registration.association import find_correspondences
from adaptiveface.result.access import to_head
from adaptiveface.sensors import Recording
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking.tracker import FaceTracker

#: The modules of the tracker that search.
STAGES = {"rigid": "rigid ICP", "expression": "blendshape fit", "tracker": "deformation"}


@contextmanager
def counted() -> Iterator[list[tuple[str, bytes]]]:
    """Note stage and content of every search while the context is open."""
    seen: list[tuple[str, bytes]] = []

    def noting(stage: str):
        def search(surface, points, normals, limit, pose=None, max_angle=60.0):
            parts = (surface.depth, surface.gradient_u, surface.gradient_v, surface.valid, points, normals, pose)
            digest = hashlib.sha256(repr((limit, max_angle)).encode())
            for part in parts:
                digest.update(np.ascontiguousarray(part).tobytes())
            seen.append((stage, digest.digest()))
            return find_correspondences(surface, points, normals, limit, pose, max_angle)

        return search

    patches = [patch(f"adaptiveface.tracking.{name}.find_correspondences", noting(stage)) for name, stage in STAGES.items()]
    for each in patches:
        each.start()
    try:
        yield seen
    finally:
        for each in patches:
            each.stop()


def measure(frames: Iterable[RgbdFrame], tracker: FaceTracker) -> tuple[np.ndarray, int, float]:
    """Searches of every tracked frame, (F, 3) by stage; how many repeat another one; largest error of a kept mesh, mm."""
    counts, repeated, error = [], 0, 0.0
    for frame in frames:
        with counted() as seen:
            tracked = tracker.track(frame)
        if tracked.tracked:
            pose, vertices = np.float32(tracked.head_pose), np.float32(tracked.vertices)
            error = max(error, float(np.abs(to_head(pose, vertices) - tracked.v4).max()))
            by_stage = Counter(stage for stage, _ in seen)
            counts.append([by_stage[stage] for stage in STAGES.values()])
            repeated += len(seen) - len({content for _, content in seen})
    return np.array(counts), repeated, error


def main() -> None:
    """Print a table for our defaults and for the paper's values."""
    words = argparse.ArgumentParser(description=__doc__)
    words.add_argument("recording", nargs="?")
    words.add_argument("--frames", type=int, default=120)
    options = words.parse_args()
    source = Recording(options.recording) if options.recording else SyntheticSensor(0, frames=options.frames)
    print("| parameters | stage | median | mean | most |\n|---|---|---|---|---|")
    for name, parameters in (("ours", Parameters()), ("paper", Parameters.paper())):
        with FrameReader(source, remember=True) as reader:
            actor = capture_source(reader, parameters, None if options.recording else source.neutral_frames)
            reader.rewind()
            numbers = range(min(len(source), options.frames))
            counts, repeated, error = measure(map(reader.read, numbers), FaceTracker(actor, parameters))
        for stage, column in zip((*STAGES.values(), "all"), (*counts.T, counts.sum(axis=1)), strict=True):
            print(f"| {name} | {stage} | {np.median(column):.0f} | {column.mean():.1f} | {column.max()} |")
        print(f"| {name} | repeated in {len(counts)} frames | | | {repeated} |")
        print(f"| {name} | error of a kept mesh, mm | | | {error:.1e} |", flush=True)


if __name__ == "__main__":
    main()
