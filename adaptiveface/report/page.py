"""Build pieces of HTML with everything inline, so that the page opens anywhere without a network."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

if TYPE_CHECKING:
    from markupsafe import Markup

#: Placeholder in charts for the page's text colour.
INK = "#010203"


@cache
def html() -> Any:
    """Load the macros of ``assets/report.html``. They return ``Markup`` and escape everything else."""
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("adaptiveface", "assets")
    return Environment(loader=loader, autoescape=True, trim_blocks=True).get_template("report.html").module


def page(title: str, sections: Sequence[Markup | str]) -> str:
    """Build a complete HTML document without external files."""
    from markupsafe import Markup

    style = (files("adaptiveface") / "assets" / "report.css").read_text(encoding="utf-8")
    return str(html().page(title, Markup(style), sections))


def image_uri(pixels: np.ndarray, quality: int = 82) -> str:
    """Encode (h, w, 3) RGB or (h, w, 4) RGBA uint8 pixels as a data URI in WebP."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "WEBP", quality=quality, method=4)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode()


def animation_uri(frames: Sequence[np.ndarray], milliseconds: int, quality: int = 62) -> str:
    """Encode (h, w, 3) uint8 frames as a data URI of an endless animation in WebP."""
    first, *rest = (Image.fromarray(frame) for frame in frames)
    stream = io.BytesIO()
    first.save(stream, "WEBP", save_all=True, append_images=rest, duration=milliseconds, loop=0, quality=quality, method=2)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode()


def image(pixels_or_uri, alt: str, width: int | None = None) -> Markup:
    """Build an ``<img>`` from pixels or a data URI."""
    uri = pixels_or_uri if isinstance(pixels_or_uri, str) else image_uri(pixels_or_uri)
    return html().image(uri, alt, width)


def figure(pixels: np.ndarray, caption: str, width: int | None = None, alt: str | None = None) -> Markup:
    """Build a ``<figure>`` from pixels, with a caption."""
    return html().figure(image(pixels, caption if alt is None else alt, width), caption)


class Changed(str):
    """A table cell whose value differs from the default."""

    changed = True


class Link(str):
    """A table cell that links to ``address``."""

    address: str

    def __new__(cls, text: str, address: str) -> Link:
        """Create a cell that shows ``text``."""
        cell = super().__new__(cls, text)
        cell.address = address
        return cell


def inline_svg(text: str, prefix: str) -> Markup:
    """Prepare a Matplotlib SVG for inlining: drop prolog, metadata and namespaces, and make ids unique by ``prefix``.

    ``INK`` becomes ``currentColor``, so that axes and text follow the page's light or dark theme.
    """
    from markupsafe import Markup

    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r'(href="|url\()#', rf"\1#{prefix}-", text)
    return Markup(text.replace(INK, "currentColor"))
