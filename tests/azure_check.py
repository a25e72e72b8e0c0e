"""Lens distortion and two cameras against the SDK's own calibration: ``python azure_check.py FOLDER`` prints JSON.

Runs where NumPy < 2 and pyk4a-bundle are installed. A slanted plane is seen through the depth camera's lens, pixel by
pixel with the SDK's ray, and recorded with a picture whose colours say where they are. From the driver's frame:
``plane``: rms distance of its points from the plane, mm; ``bent``: the same without taking care of the lens;
``picture``: how far the colours lie from where the SDK sees the points, pixels of the picture, worst and mean of a grid.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pyk4a
from azure_mkv import calibration, write

from adaptiveface.sensors import open_sensor

#: fx, fy, cx, cy, k1 to k6, p2, p1 of the kind that real devices have.
DEPTH_LENS = [504.2, 503.9, 322.1, 330.6, 5.28, 3.67, 0.19, 5.61, 5.26, 0.98, -6e-5, -9e-5]
COLOUR_LENS = [609.4, 608.8, 638.2, 365.7, 0.46, -2.52, 1.49, 0.34, -2.34, 1.42, -2e-4, 5e-4]
#: The plane: z = 600 + 0.4 x - 0.2 y mm.
Z0, SLOPE = 600.0, (0.4, -0.2)
DEPTH, COLOUR = pyk4a.CalibrationType.DEPTH, pyk4a.CalibrationType.COLOR


def plane_seen(sdk: pyk4a.Calibration) -> np.ndarray:
    """(576, 640) uint16 mm; 0 where the SDK has no ray."""
    depth = np.zeros((576, 640))
    for v in range(576):
        for u in range(640):
            try:
                x, y, _ = sdk.convert_2d_to_3d((u, v), 1.0, DEPTH)
            except ValueError:
                continue
            depth[v, u] = Z0 / (1 - SLOPE[0] * x - SLOPE[1] * y)
    return np.rint(depth).astype(np.uint16)


def off_plane(camera, depth: np.ndarray) -> float:
    """Root mean square distance of the points of ``depth`` from the plane, mm."""
    x, y, z = (camera.rays() * depth[..., None])[depth > 0].T
    distance = (z - Z0 - SLOPE[0] * x - SLOPE[1] * y) / np.sqrt(1 + SLOPE[0] ** 2 + SLOPE[1] ** 2)
    return float(np.sqrt((distance**2).mean()))


def to_and_fro(pixel):
    """A colour that changes by 1 per pixel: 255 down to 0 and up again."""
    return np.abs(pixel % 510 - 255)


def picture_error(sdk: pyk4a.Calibration, frame) -> tuple[float, float]:
    """Worst and mean over a grid, one step of colour a pixel."""
    errors = []
    for v in range(30, 546, 30):
        for u in range(30, 610, 30):
            if not frame.depth[v, u] or not frame.colour[v, u].any():
                continue
            point = frame.camera.back_project(np.array([u, v], float), frame.depth[v, u])
            x, y = sdk.convert_3d_to_2d(tuple(point), DEPTH, COLOUR)
            red, green, _ = frame.colour[v, u].astype(float)
            errors += [red - to_and_fro(x), green - to_and_fro(y)]
    assert len(errors) > 300, len(errors)
    return float(np.abs(errors).max()), float(np.abs(errors).mean())


def main(folder: Path) -> None:
    raw = calibration(DEPTH_LENS, COLOUR_LENS, -32.0)
    mode, resolution = pyk4a.DepthMode.NFOV_UNBINNED, pyk4a.ColorResolution.RES_720P
    sdk = pyk4a.Calibration.from_raw(raw[:-1].decode(), mode, resolution)
    depth = plane_seen(sdk)
    across, down = np.meshgrid(to_and_fro(np.arange(1280.0)), to_and_fro(np.arange(720.0)))
    picture = np.stack([across, down, np.full_like(across, 128)], axis=-1).round().astype(np.uint8)
    write(str(folder / "plane.mkv"), np.stack([depth] * 2), picture, raw)
    with open_sensor(f"azure:{folder / 'plane.mkv'}") as sensor:
        frames = list(sensor)
    frame = frames[0]
    print(
        json.dumps(
            {
                "frames": [f.sequence for f in frames],
                "times": [f.device_timestamp for f in frames],
                "plane": off_plane(frame.camera, frame.depth),
                "bent": off_plane(frame.camera, depth.astype(float)),
                "picture": picture_error(sdk, frame),
            }
        )
    )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
