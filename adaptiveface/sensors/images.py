"""Read and write the images of a recording.

Pillow reads the header first, so that the size is checked before any pixel is decoded. It also refuses truncated files, where
OpenCV silently fills the missing rows with grey or zeros.
"""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
from PIL import Image

from ..errors import FileFormatError, FrameError
from ..files import open_regular, replacing
from ..geometry.camera import Camera

#: Largest image file that is read. The largest picture that is allowed has 96 MiB without compression.
_MAX_FILE_BYTES = 128 << 20


def read_depth(path: Path, camera: Camera) -> np.ndarray:
    """Read a depth image.

    Parameters
    ----------
    path : Path
        A 16-bit PNG.
    camera : Camera
        The calibration, which determines the size of the image.

    Returns
    -------
    (H, W) float32
        Depth in the units of the file.

    Raises
    ------
    FrameError
        The image cannot be used. The message names the file and the reason.
    """
    pixels = _decode(path, camera, formats=("PNG",), modes=("I;16", "I;16B", "I"), what="a 16-bit grey image")
    return pixels.astype(np.float32)


def read_colour(path: Path, camera: Camera) -> np.ndarray:
    """Read a colour image.

    Parameters
    ----------
    path : Path
        A JPEG or PNG.
    camera : Camera
        The calibration, which determines the size of the image.

    Returns
    -------
    (H, W, 3) uint8
        The RGB picture.

    Raises
    ------
    FrameError
        The image cannot be used. The message names the file and the reason.
    """
    return _decode(path, camera, formats=("JPEG", "PNG"), modes=("RGB", "RGBA", "L"), what="an 8-bit colour image")


def _decode(path: Path, camera: Camera, formats: tuple, modes: tuple, what: str) -> np.ndarray:
    try:
        with warnings.catch_warnings(), open_regular(path, _MAX_FILE_BYTES) as stream:
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(stream, formats=formats) as image:
                if image.size != (camera.width, camera.height):
                    size = f"{image.size[0]} x {image.size[1]} pixels"
                    raise FrameError(f"{path}: {size}, the camera has {camera.width} x {camera.height}")
                if image.mode not in modes:
                    raise FrameError(f"{path}: pixels are of kind '{image.mode}', {what} is expected")
                return np.array(image.convert("RGB") if "RGB" in modes else image)
    except FrameError:
        raise
    except FileFormatError as error:
        raise FrameError(str(error)) from None
    except Exception as error:  # image decoders raise anything from OSError to SyntaxError on damaged files
        raise FrameError(f"{path}: not readable as an image ({error or type(error).__name__})") from error


def write_image(path: Path, pixels: np.ndarray) -> None:
    """Write an image completely or not at all.

    Parameters
    ----------
    path : Path
        The file. A ``.png`` is lossless, and any other suffix gives a JPEG of quality 95.
    pixels : (H, W) uint16 or (H, W, 3) uint8
        Depth or RGB.
    """
    buffer = io.BytesIO()
    image = Image.fromarray(pixels)
    if path.suffix == ".png":
        image.save(buffer, "PNG", compress_level=3)
    else:
        image.save(buffer, "JPEG", quality=95, subsampling=0)
    with replacing(path, keep_suffix=False) as temporary:
        temporary.write_bytes(buffer.getvalue())
