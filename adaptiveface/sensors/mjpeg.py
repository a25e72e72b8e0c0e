"""Read, within limits, a network camera that sends one JPEG after another (multipart/x-mixed-replace over HTTP).

A decoder allocates what a picture's header asks for, and 16,000 x 16,000 pixels take gigabytes. Headers are therefore checked
before anything is decoded, and no part may be longer than a picture can be.
"""

from __future__ import annotations

import base64
import io
import urllib.request
import warnings
from http.client import HTTPException
from urllib.parse import unquote, urlsplit, urlunsplit

import cv2
import numpy as np
from PIL import Image

from ..errors import SensorError
from ..files.bounded import size
from ..geometry.camera import MAX_PIXELS

#: Largest picture, bytes. An 8K JPEG of the best quality has half of that.
MAX_PICTURE_BYTES = 16 << 20
_MAX_LINE, _MAX_LINES, _CHUNK = 4096, 64, 1 << 16


class MjpegStream:
    """An open stream, which is read as OpenCV's captures are.

    Parameters
    ----------
    response : http.client.HTTPResponse
        The answer of the camera.
    boundary : bytes
        The mark between two pictures.
    name : str
        Name of the camera, for messages.
    """

    def __init__(self, response, boundary: bytes, name: str) -> None:
        self._response, self._name = response, name
        self._boundary = b"--" + boundary.removeprefix(b"--")
        self._kept = b""  # received, but not used yet

    def read(self) -> tuple[bool, np.ndarray | None]:
        """Return the next picture.

        Returns
        -------
        found : bool
            Whether there is a picture that can be decoded.
        picture : (H, W, 3) uint8 or None
            The picture in BGR.

        Raises
        ------
        SensorError
            The stream sends something that no camera sends.
        """
        try:
            content = self._part()
        except (OSError, HTTPException):
            content = None
        picture = None if not content else self._decoded(content)
        return picture is not None, picture

    def close(self) -> None:
        """Close the connection."""
        self._response.close()

    def _part(self) -> bytes | None:
        """Return the content of the next part, or None at the end of the stream."""
        length, begun = None, False
        for _ in range(_MAX_LINES):
            line = self._line()
            if line is None:
                return None
            if line.lower().startswith(b"content-length:"):
                text = line.split(b":", 1)[1].strip()
                length = int(text[:20]) if text.isdigit() else None
            if begun and not line:
                break
            begun = begun or line.startswith(b"--")
        else:
            raise SensorError(f"{self._name}: sends no pictures but more than {_MAX_LINES} lines of headers")
        if length is not None:
            if length > MAX_PICTURE_BYTES:
                raise self._too_long(length)
            return self._take(length)
        return self._until_boundary()

    def _line(self) -> bytes | None:
        while b"\n" not in self._kept:
            if len(self._kept) > _MAX_LINE:
                raise SensorError(f"{self._name}: sends no pictures, or none that are marked off by '{self._mark()}'")
            if not self._more():
                return None
        line, self._kept = self._kept.split(b"\n", 1)
        return line.rstrip(b"\r")

    def _take(self, length: int) -> bytes | None:
        parts, held = [self._kept], len(self._kept)
        while held < length:
            chunk = self._response.read1(_CHUNK)
            if not chunk:
                return None
            parts.append(chunk)
            held += len(chunk)
        content = b"".join(parts)
        self._kept = content[length:]
        return content[:length]

    def _until_boundary(self) -> bytes | None:
        content = bytearray(self._kept)
        looked = 0
        while (end := content.find(self._boundary, looked)) < 0:
            looked = max(0, len(content) - len(self._boundary))
            if len(content) > MAX_PICTURE_BYTES:
                raise self._too_long(len(content))
            chunk = self._response.read1(_CHUNK)
            if not chunk:
                return None
            content += chunk
        self._kept = bytes(content[end:])
        return bytes(content[:end])

    def _more(self) -> bool:
        chunk = self._response.read1(_CHUNK)
        self._kept += chunk
        return bool(chunk)

    def _mark(self) -> str:
        return self._boundary[:40].decode(errors="replace")

    def _too_long(self, length: int) -> SensorError:
        return SensorError(f"{self._name}: a picture of {size(length)} or more; at most {size(MAX_PICTURE_BYTES)} are read")

    def _decoded(self, content: bytes) -> np.ndarray | None:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", Image.DecompressionBombWarning)
                with Image.open(io.BytesIO(content), formats=("JPEG",)) as image:
                    width, height = image.size
        except (Image.DecompressionBombError, Image.DecompressionBombWarning) as error:
            raise SensorError(f"{self._name}: {error}") from None
        except Exception:  # Pillow may raise anything on a damaged picture; the next one may be intact
            return None
        if width * height > MAX_PIXELS:
            raise SensorError(f"{self._name}: a picture of {width} x {height} pixels; at most {MAX_PIXELS} in all are read")
        return cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_COLOR)


def open_mjpeg(address: str, name: str, timeout: float) -> MjpegStream | None:
    """Open the stream at an address.

    Parameters
    ----------
    address : str
        An http or https address. It may hold a user name and a password.
    name : str
        Name of the camera, for messages.
    timeout : float
        Longest time for the connection and for every read, s.

    Returns
    -------
    MjpegStream or None
        The stream, or None if it is not a stream of JPEGs.

    Raises
    ------
    SensorError
        The address gives single pictures.
    OSError
        Nobody answers.
    """
    request = urllib.request.Request(_without_login(address))
    parts = urlsplit(address)
    if parts.username is not None:
        login = f"{unquote(parts.username)}:{unquote(parts.password or '')}"
        request.add_header("Authorization", "Basic " + base64.b64encode(login.encode()).decode())
    try:
        response = urllib.request.urlopen(request, timeout=timeout)
    except HTTPException as error:
        raise OSError(str(error)) from None
    kind = response.headers.get_content_type()
    boundary = response.headers.get_param("boundary")
    if kind == "multipart/x-mixed-replace" and boundary:
        return MjpegStream(response, str(boundary).strip('"').encode(), name)
    response.close()
    if "jpeg" in kind:
        raise SensorError(f"{name}: sends single pictures; give the address of its stream")
    return None


def _without_login(address: str) -> str:
    parts = urlsplit(address)
    return urlunsplit(parts._replace(netloc=parts.netloc.rpartition("@")[2]))
