"""Turn arrays into pictures (JPEG or PNG bytes in an ``ipywidgets.Image``), and draw overlays on colour images."""

from __future__ import annotations

import cv2
import ipywidgets as widgets
import numpy as np

from ..geometry.frame import RgbdFrame


def encode(image: np.ndarray, format: str = "jpeg", quality: int = 85) -> bytes:
    """Encode RGB (H, W, 3) uint8, or for a PNG also RGBA (H, W, 4), as a picture file."""
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if format == "jpeg" else []
    order = cv2.COLOR_RGBA2BGRA if image.shape[2] == 4 else cv2.COLOR_RGB2BGR
    done, data = cv2.imencode("." + format, cv2.cvtColor(image, order), options)
    if not done:
        raise ValueError(f"an image of shape {image.shape} cannot be encoded")
    return data.tobytes()


def image_widget(width: int, height: int, format: str = "jpeg", name: str = "") -> widgets.Image:
    """Make a picture that shrinks with its window and keeps its proportions. ``name`` is its CSS class, for tests."""
    image = widgets.Image(format=format, width=width, height=height)
    image.layout = widgets.Layout(max_width="100%", height="auto", object_fit="contain", margin="2px 0")
    if name:
        image.add_class(name)
    return image


def depth_as_colour(depth: np.ndarray) -> np.ndarray:
    """Turn depth (H, W) mm into grey (H, W, 3) uint8, in which near is bright; for sources without colour."""
    measured = depth[depth > 0]
    if not len(measured):
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = np.percentile(measured, [1, 99])
    grey = np.where(depth > 0, 230 - 190 * np.clip((depth - near) / max(far - near, 1.0), 0, 1), 0)
    return np.repeat(grey.astype(np.uint8)[..., None], 3, axis=2)


#: A ring of radius 3 and a cross of half width 2, pixels. One call draws each of them for all features, because every call of
#: OpenCV hands the interpreter to the tracker's threads and must wait to get it back.
_RING = 3.0 * np.stack([np.cos(np.arange(16) * np.pi / 8), np.sin(np.arange(16) * np.pi / 8)], axis=1)
_CROSS = np.array([[[-2.0, 0.0], [2.0, 0.0]], [[0.0, -2.0], [0.0, 2.0]]])
#: Fractional bits of OpenCV's coordinates.
_SHIFT = 4


def annotate(frame: RgbdFrame, points: np.ndarray | None = None, features: np.ndarray | None = None) -> np.ndarray:
    """Draw 2D features (yellow rings), the model's features (blue crosses) and its vertices (dots) on a colour image.

    The model's vertices (n, 3) and features (40, 3) are in the camera frame, mm, or None. The result is (H, W, 3) uint8.
    """
    image = (depth_as_colour(frame.depth) if frame.colour is None else frame.colour).copy()

    def pixels(positions: np.ndarray) -> np.ndarray:
        return np.round(frame.camera.project(positions)).astype(int)

    if points is not None:
        u, v = pixels(points).T
        inside = (u >= 0) & (v >= 0) & (u < image.shape[1]) & (v < image.shape[0])
        image[v[inside], u[inside]] = (90, 220, 255)
    if features is not None:
        _draw(image, pixels(features)[:, None, None] + _CROSS, False, (30, 90, 255))
    if frame.features is not None:
        seen = np.round(frame.features.pixels[frame.features.valid])
        _draw(image, seen[:, None, None] + _RING, True, (255, 220, 0))
    return image


def _draw(image: np.ndarray, lines: np.ndarray, closed: bool, colour: tuple[int, int, int]) -> None:
    """Draw thin smooth lines in place, each through m points: (..., m, 2) px."""
    fixed = np.round(lines * (1 << _SHIFT)).astype(np.int32).reshape(-1, *lines.shape[-2:])
    cv2.polylines(image, list(fixed), closed, colour, 1, cv2.LINE_AA, _SHIFT)


class CameraView:
    """The sensor's picture, cropped to the face, with features and model over it. Display its ``widget``.

    With ``depth``, the depth map is shown beside it.
    """

    def __init__(self, size: tuple[int, int] = (360, 400), title: str = "what the sensor sees", depth: bool = False) -> None:
        self.size = size
        self._image = image_widget(*size, name="adaptiveface-camera")
        self._image.value = encode(np.full((size[1], size[0], 3), 240, np.uint8))  # until the first frame
        self.widget = widgets.VBox([widgets.HTML(f"<b>{title}</b>"), self._image])
        self._depth = image_widget(*size) if depth else None
        if depth:
            beside = widgets.VBox([widgets.HTML("<b>depth: near is bright, black was not measured</b>"), self._depth])
            self.widget = widgets.HBox([self.widget, beside], layout=widgets.Layout(flex_flow="row wrap"))
        self._centre: np.ndarray | None = None

    def show(self, frame: RgbdFrame, points: np.ndarray | None = None, features: np.ndarray | None = None) -> None:
        """Draw a frame. The arguments are those of :func:`annotate`."""
        image = annotate(frame, points, features)
        self._image.value = self._encoded(image, frame)
        if self._depth is not None:
            self._depth.value = self._encoded(depth_as_colour(frame.depth), frame)

    def _encoded(self, image: np.ndarray, frame: RgbdFrame) -> bytes:
        return encode(cv2.resize(self._crop(image, frame), self.size, interpolation=cv2.INTER_LINEAR))

    def _crop(self, image: np.ndarray, frame: RgbdFrame) -> np.ndarray:
        """A window around the face with the view's proportions, which follows only large movements."""
        features = frame.features
        half = np.array(self.size) / max(self.size) * min(image.shape[:2]) * 0.42
        if features is not None and features.valid.sum() > 5:
            u0, v0, u1, v1 = features.bounding_box
            centre = np.array([u0 + u1, v0 + v1]) / 2
            half = np.array(self.size) / max(self.size) * max(u1 - u0, v1 - v0, 60) * 1.25
            if self._centre is None or np.linalg.norm(centre - self._centre) > 0.3 * half[0]:
                self._centre = centre
        centre = self._centre if self._centre is not None else np.array(image.shape[1::-1]) / 2
        low = np.clip(np.round(centre - half), 0, None).astype(int)
        high = np.round(centre + half).astype(int)
        crop = image[low[1] : high[1], low[0] : high[0]]
        return crop if crop.size else image
