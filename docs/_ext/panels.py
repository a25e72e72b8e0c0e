"""Executed notebooks for the site: a panel of widgets becomes the pictures and words that it showed when its cell had run.

A page has no kernel. What a widget displays is in the notebook's stored state; ``RENDERERS`` maps a widget model's name to
a function that makes outputs of it, which is where views that work in the page by themselves can join.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Callable

from PIL import Image

from adaptiveface.views.saved import pack

VIEW = "application/vnd.jupyter.widget-view+json"
STATE = "application/vnd.jupyter.widget-state+json"
#: What views leave behind for pages without a kernel (adaptiveface.views.saved); here :data:`RENDERERS` do that.
SAVED = "adaptiveface-saved"
#: Pixels; wider pictures are shrunk, so that pages stay small.
WIDEST = 900


def image(model: dict) -> list[dict]:
    """The picture of an Image widget, as JPEG or PNG."""
    data = _value(model)
    if not data:
        return []
    drawn = Image.open(io.BytesIO(base64.b64decode(data)))
    if drawn.width < 2 or drawn.height < 2:
        return []
    drawn.thumbnail((WIDEST, WIDEST))
    stream, kind = io.BytesIO(), "png" if drawn.format == "PNG" or model["state"].get("format") == "png" else "jpeg"
    drawn.convert("RGB").save(stream, kind, optimize=True)
    return [_output({f"image/{kind}": base64.b64encode(stream.getvalue()).decode()})]


def _value(model: dict) -> str:
    """The base64 text of a picture, or "" where the widget holds none."""
    return next((b["data"] for b in model.get("buffers") or () if b["path"] == ["value"]), "")


def words(model: dict) -> list[dict]:
    """The text of an HTML widget; what belongs to sliders, units and style sheets, is left out with them."""
    text = model["state"].get("value", "")
    with_sliders = "<style" in text or text.startswith("<span")
    return [_output({"text/html": f"<p>{text}</p>"})] if text.strip() and not with_sliders else []


#: The class of the widget that draws heads.
HEADS = "adaptiveface.views.heads.Heads"


def heads(model: dict) -> list[dict]:
    """Heads that the page draws and the mouse turns, as a saved notebook keeps them, for ``assets/saved_heads.js``."""
    values = {name: value for name, value in model["state"].items() if not name.startswith("_")}
    known: dict[str, int] = {}  # panes often share a geometry
    for buffer in model.get("buffers") or ():
        *way, last = buffer["path"]
        place = values
        for step in way:
            place = place[step]
        place[last] = {"bytes": known.setdefault(buffer["data"], len(known))}
    titles = ", ".join(title for title in values["titles"] if title) or "a head"
    place = f'<div class="adaptiveface-saved-head"><p>{titles}: drawn with JavaScript.</p>'
    return [_output({"text/html": f'{place}<script type="application/octet-stream">{pack(values, known)}</script></div>'})]


#: Widget model -> what it leaves in the page. Sliders and buttons leave nothing: they need a kernel.
RENDERERS: dict[str, Callable[[dict], list[dict]]] = {"ImageModel": image, "HTMLModel": words, HEADS: heads}


def static(notebook: dict) -> dict:
    """The notebook with every widget's view replaced by its pictures and words; the state is dropped, in place."""
    state = notebook["metadata"].pop("widgets", {}).get(STATE, {}).get("state", {})
    for cell in notebook["cells"]:
        kept = []
        for output in cell.get("outputs", ()):
            view = output.get("data", {}).get(VIEW)
            saved = SAVED in "".join(output.get("data", {}).get("text/html", ""))
            if output.get("name") == "stderr" or saved:
                continue
            kept += [output] if view is None else _drawn(view["model_id"], state)
        if "outputs" in cell:
            cell["outputs"] = kept
    return notebook


def _drawn(identity: str, state: dict) -> list[dict]:
    """Outputs of a widget and of all that it holds, in their order."""
    model = state.get(identity)
    if model is None:
        return []
    name, values = model.get("model_name", ""), model["state"]
    if "_esm" in values:  # one of our own
        name = "ImageModel" if _value(model) else values.get("_anywidget_id", name)
    found = RENDERERS.get(name, lambda model: [])(model)
    for child in values.get("children") or ():
        found += _drawn(child.removeprefix("IPY_MODEL_"), state)
    return found


def _output(data: dict) -> dict:
    return {"output_type": "display_data", "data": data, "metadata": {}}
