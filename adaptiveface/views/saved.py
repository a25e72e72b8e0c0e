"""Save the form of a view that a page shows without a kernel: pictures of its content, and heads that can be turned.

A view is displayed twice. The first output is the live widget. The second one is HTML that is hidden as long as the live
widget is in the page: a picture of every head, chart and camera. Where scripts run, as in what ``jupyter nbconvert`` makes,
the page draws the heads itself, and the mouse turns them. JupyterLab says "Error displaying widget" for widgets of a kernel
that has ended, and shows the pictures below. pyvista's windows, which are frames of the kernel's own pages, also get a
picture.
"""

from __future__ import annotations

import base64
import gzip
import html
import json
from collections.abc import Iterable, Iterator
from pathlib import Path

import ipywidgets as widgets

from .heads import Heads
from .pictures import encode

#: CSS class by which a page recognises saved content.
SAVED = "adaptiveface-saved"
_VIEWER = Path(__file__).resolve().parents[1] / "assets" / "saved_heads.js"
_NOTE = "As it was when the cell had run; run the cell to work with it."


def install() -> None:
    """Make IPython display boxes of widgets by :func:`show`, and pyvista's windows by :func:`show_window`.

    Outside IPython, this does nothing.
    """
    from IPython import get_ipython

    shell = get_ipython()
    if shell is not None:
        shell.display_formatter.ipython_display_formatter.for_type(widgets.Box, show)
        shell.display_formatter.ipython_display_formatter.for_type(widgets.HTML, show_window)


def show(box: widgets.Box) -> None:
    """Display a box of widgets together with its saved form."""
    from IPython.display import HTML, display

    text = saved(box)
    if text:
        box.add_class(_live(box))
    display(box._repr_mimebundle_(), raw=True)
    if text:
        display(HTML(text))


def show_window(frame: widgets.HTML) -> None:
    """Display a text widget. If it frames the window of one of pyvista's plotters, add a picture of that window."""
    from IPython.display import HTML, display

    plotter = getattr(getattr(frame, "viewer", None), "plotter", None)
    if plotter is not None:
        frame.add_class(_live(frame))
    display(frame._repr_mimebundle_(), raw=True)
    if plotter is not None:
        picture = _picture(encode(plotter.screenshot(return_img=True), "png"), "png", "pyvista's window")
        # A page made by nbconvert has the frame, too, but no server answers there.
        display(HTML(_kept(frame, f"<div>{picture}</div>", f"#main .{_live(frame)}")))


def saved(box: widgets.Widget) -> str:
    """HTML of every head and picture in a tree of widgets; "" if there is none."""
    parts = [part for widget in _tree(box) for part in _part(widget)]
    if not parts:
        return ""
    heads = any("<script" in part for part in parts)
    script = f"<script>{_VIEWER.read_text(encoding='utf-8')}</script>" if heads else ""
    row = f"<div style='display:flex;flex-wrap:wrap;gap:8px;align-items:flex-start'>{''.join(parts)}</div>"
    return _kept(box, row, f".{_live(box)}", script)


def _kept(widget: widgets.Widget, content: str, live: str, script: str = "") -> str:
    """HTML of the saved form of a widget. A page that has an element ``live`` (a CSS selector) hides it."""
    rule = f"<style>body:has({live}) .{SAVED}-{widget.model_id} {{display: none}}</style>"
    return f"{rule}<div class='{SAVED} {SAVED}-{widget.model_id}'>{content}<small>{_NOTE}</small>{script}</div>"


def _live(box: widgets.Widget) -> str:
    return f"adaptiveface-shown-{box.model_id}"


def _tree(widget: widgets.Widget) -> Iterator[widgets.Widget]:
    """Yield a widget and all its descendants in order, without hidden ones."""
    if widget.layout is not None and widget.layout.display == "none":
        return
    yield widget
    for child in getattr(widget, "children", ()):
        yield from _tree(child)


def _part(widget: widgets.Widget) -> list[str]:
    if isinstance(widget, Heads):
        return [_head(widget)]
    value, shown = getattr(widget, "value", None), isinstance(widget, widgets.Image) or hasattr(widget, "_esm")
    if not (shown and isinstance(value, (bytes, memoryview)) and len(value)):
        return []
    value = bytes(value)
    kind = "png" if value.startswith(b"\x89PNG") else "jpeg"
    return [_picture(value, kind, getattr(widget, "description", "") or "picture")]


def _picture(data: bytes, kind: str, description: str) -> str:
    source = f"data:image/{kind};base64,{base64.b64encode(data).decode('ascii')}"
    return f"<img style='max-width:100%' alt='{html.escape(description, quote=True)}' src='{source}'>"


def _head(view: Heads) -> str:
    """A view's picture, and the data from which the page draws it."""
    titles = ", ".join(title for title in view.titles if title) or "head"
    picture = "" if view.still is None else _picture(encode(view.still()), "jpeg", titles)
    data = f"<script type='application/octet-stream'>{packed(view)}</script>"
    return f"<div class='adaptiveface-saved-head'>{picture}{data}</div>"


def packed(view: Heads) -> str:
    """The values of a view that the browser has, including bytes, as text."""
    buffers: dict[str, int] = {}  # because panes often share a geometry

    def plain(value):
        if isinstance(value, (bytes, memoryview)):
            return {"bytes": buffers.setdefault(base64.b64encode(value).decode("ascii"), len(buffers))}
        if isinstance(value, dict):
            return {name: plain(one) for name, one in value.items()}
        return [plain(one) for one in value] if isinstance(value, (list, tuple)) else value

    return pack({name: plain(getattr(view, name)) for name in view.own_traits()}, buffers)


def pack(state: dict, buffers: Iterable[str]) -> str:
    """Text that ``js/src/saved.js`` unpacks; ``{"bytes": k}`` in ``state`` stands for the k-th of ``buffers``, in base64."""
    text = json.dumps({"state": state, "buffers": [*buffers]}, separators=(",", ":"))
    return base64.b64encode(gzip.compress(text.encode(), mtime=0)).decode("ascii")
