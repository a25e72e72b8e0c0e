"""Small pieces of HTML: everything inline, so that the page opens anywhere without a network."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from html import escape
from importlib.resources import files

import numpy as np
from PIL import Image

#: Stands for the page's text colour in charts.
INK = "#010203"

_PAGE = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{style}</style>
</head>
<body>
<main>
{body}
</main>
</body>
</html>
"""


def page(title: str, sections: Sequence[str]) -> str:
    """A whole self-contained HTML document."""
    style = (files("adaptiveface") / "assets" / "report.css").read_text(encoding="utf-8")
    return _PAGE.format(title=escape(title), style=style, body="\n".join(sections))


def image_uri(pixels: np.ndarray, quality: int = 82) -> str:
    """A data URI of (h, w, 3) RGB or (h, w, 4) RGBA uint8 pixels, as WebP."""
    stream = io.BytesIO()
    Image.fromarray(pixels).save(stream, "WEBP", quality=quality, method=4)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode()


def animation_uri(frames: Sequence[np.ndarray], milliseconds: int, quality: int = 62) -> str:
    """A data URI of an endless animated WebP of (h, w, 3) uint8 frames."""
    first, *rest = (Image.fromarray(frame) for frame in frames)
    stream = io.BytesIO()
    first.save(stream, "WEBP", save_all=True, append_images=rest, duration=milliseconds, loop=0, quality=quality, method=2)
    return "data:image/webp;base64," + base64.b64encode(stream.getvalue()).decode()


def image(pixels_or_uri, alt: str, width: int | None = None) -> str:
    """An ``<img>`` of pixels or of a data URI."""
    uri = pixels_or_uri if isinstance(pixels_or_uri, str) else image_uri(pixels_or_uri)
    size = f' width="{width}"' if width else ""
    return f'<img src="{uri}" alt="{escape(alt)}"{size}>'


def figure(content: str, caption: str = "") -> str:
    """A ``<figure>`` with an optional caption."""
    return f"<figure>{content}{f'<figcaption>{escape(caption)}</figcaption>' if caption else ''}</figure>"


def table(header: Sequence[str], rows: Sequence[Sequence[str]], strong: Sequence[int] = (), kind: str = "") -> str:
    """An HTML table of plain text cells; the rows numbered in ``strong`` are set bold. Cells may be ``Changed`` or ``Link``."""
    head = "".join(f"<th>{escape(name)}</th>" for name in header)
    body = []
    for number, row in enumerate(rows):
        cells = "".join(_cell(cell) for cell in row)
        body.append(f"<tr{' class=strong' if number in strong else ''}>{cells}</tr>")
    return f'<div class="scroll"><table class="{kind}"><tr>{head}</tr>{"".join(body)}</table></div>'


def _cell(cell: str) -> str:
    text = escape(str(cell))
    if isinstance(cell, Link):
        text = f'<a href="{escape(cell.address, quote=True)}">{text}</a>'
    return f"<td{' class=changed' if isinstance(cell, Changed) else ''}>{text}</td>"


class Changed(str):
    """A table cell whose value differs from the default."""


class Link(str):
    """A table cell that leads to ``address``."""

    address: str

    def __new__(cls, text: str, address: str) -> Link:
        """The cell of a table with ``text`` that leads to ``address``."""
        cell = super().__new__(cls, text)
        cell.address = address
        return cell


def inline_svg(text: str, prefix: str) -> str:
    """A Matplotlib SVG made fit for inlining: prolog, metadata and namespaces dropped, ids made unique by ``prefix``.

    ``INK`` becomes ``currentColor``, so that axes and text follow the page's light or dark theme.
    """
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.S)
    text = re.sub(r'\sxmlns(:\w+)?="[^"]*"', "", text)
    text = re.sub(r'\bid="([^"]+)"', rf'id="{prefix}-\1"', text)
    text = re.sub(r'(href="|url\()#', rf"\1#{prefix}-", text)
    return text.replace(INK, "currentColor")
