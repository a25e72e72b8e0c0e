"""Formulas as MathML, which browsers draw themselves: no script, no network, and the theme's colours."""

from __future__ import annotations

import re

from docutils import nodes
from latex2mathml.converter import convert


def to_mathml(text: str, display: str = "inline") -> str:
    r"""A formula as MathML. The converter would show the backslash of ``\_`` within ``\text...{}``."""
    return convert(re.sub(r"\\text\w*\{[^{}]*\}", lambda words: words[0].replace(r"\_", "_"), text), display=display)


def _inline(translator, node) -> None:
    translator.body.append(to_mathml(node.astext()))
    raise nodes.SkipNode


def _block(translator, node) -> None:
    # A line break inside a formula is a space; \\ starts a new line.
    text = re.sub(r"\s*\n\s*", " ", node.astext().strip())
    translator.body.append(f'<div class="math">{to_mathml(text, display="block")}</div>\n')
    raise nodes.SkipNode


def setup(app) -> dict:
    """Register the renderer; ``html_math_renderer = "mathml"`` selects it."""
    app.add_html_math_renderer("mathml", (_inline, None), (_block, None))
    return {"parallel_read_safe": True}
