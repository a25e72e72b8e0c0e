"""Simulate a video camera: motion blur, automatic gain and white balance, noise, and colours at half the resolution.

The noise comes from photons, whose variance grows with the light, and from the read-out (Foi et al. 2008, "Practical
Poissonian-Gaussian noise modeling and fitting for single-image raw-data"). The gain follows the light with a delay, as the
automatic exposure of webcams does.
"""

from __future__ import annotations

import cv2
import numpy as np

from .lamp import lamp
from .photographic import to_linear, to_srgb

#: Time for which the shutter is open, in frames: 12 ms at 30 frames a second.
SHUTTER = 0.36
#: Number of samples of the motion while the shutter is open.
_TAPS = 5
#: Time constant of gain and white balance, s, and the share of a change in colour that they follow.
_GAIN_LAG, _BALANCE = 0.4, 0.7
#: Standard deviations of the noise at unit gain in linear light: of the photons of white, and of the read-out.
_PHOTONS, _READ_OUT = 0.018, 0.0025


class VideoCamera:
    """A camera in a room with the light ``light``, which is a kind of :func:`.lamp.lamp`."""

    def __init__(self, light: str, fps: float) -> None:
        self._light, self._fps = light, fps

    def gain(self, index: int) -> np.ndarray:
        """Return the (3,) factors by which the camera brightens R, G and B in frame ``index``. They follow earlier frames."""
        steps = np.arange(1, 61)  # two seconds, which is five times the delay
        weights = np.exp(-steps / (_GAIN_LAG * self._fps))
        seen = np.array([lamp(self._light, (index - step) / self._fps).brightness for step in steps])
        seen = np.average(seen, axis=0, weights=weights)
        usual = lamp("steady", 0.0).brightness.mean()
        grey = float(seen.mean())
        hunting = 1.0 + 0.03 * np.sin(2 * np.pi * index / self._fps / 1.7)
        return usual / grey * hunting * (grey / seen) ** _BALANCE

    def develop(self, picture: np.ndarray, motion: np.ndarray, index: int, rng: np.random.Generator) -> np.ndarray:
        """Turn a rendered picture into the picture that the camera stores.

        Parameters
        ----------
        picture : (H, W, 3) float32 array
            Rendered colours, 0 to 255 and above.
        motion : (H, W, 2) array
            How far the content of each pixel moves from one frame to the next, px.
        index : int
            Number of the frame.
        rng : numpy.random.Generator

        Returns
        -------
        (H, W, 3) uint8 array
            The stored picture.
        """
        gain = self.gain(index).astype(np.float32)
        light = to_linear(blurred(picture, motion)) * gain
        deviation = np.sqrt(_PHOTONS**2 * light * gain + (_READ_OUT * gain) ** 2)
        light += deviation * rng.standard_normal(light.shape, np.float32)
        image = np.clip(to_srgb(light), 0, 255).astype(np.uint8)
        coded = cv2.cvtColor(image, cv2.COLOR_RGB2YCrCb)
        height, width = image.shape[:2]
        half = cv2.resize(coded[..., 1:], (-(-width // 2), -(-height // 2)), interpolation=cv2.INTER_AREA)
        coded[..., 1:] = cv2.resize(half, (width, height), interpolation=cv2.INTER_LINEAR)
        return cv2.cvtColor(coded, cv2.COLOR_YCrCb2RGB)


def blurred(picture: np.ndarray, motion: np.ndarray) -> np.ndarray:
    """Average ``picture`` (H, W, 3) float32 along ``motion`` (H, W, 2) px per frame, while the shutter is open."""
    height, width = picture.shape[:2]
    u, v = np.meshgrid(np.arange(width, dtype=np.float32), np.arange(height, dtype=np.float32))
    total = np.zeros_like(picture)
    for share in np.linspace(-0.5, 0.5, _TAPS):
        away = np.float32(share * SHUTTER) * motion.astype(np.float32)
        total += cv2.remap(picture, u + away[..., 0], v + away[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return total / np.float32(_TAPS)
