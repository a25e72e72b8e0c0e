"""Pages made from the package at build time: the parameters' table, one API page per module, the notebooks.

A Sphinx extension too: it turns the plain-text docstrings into valid reStructuredText.
"""

from __future__ import annotations

import ast
import importlib.util
import json
import pkgutil
import re
import shutil
from collections.abc import Collection
from pathlib import Path

import buttons
from PIL import Image
from sphinx.ext.napoleon import Config, NumpyDocstring

import adaptiveface
from adaptiveface import parameters

#: Pixels of the pictures in the list of notebooks.
SMALL = 640
NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"


def write_pages(docs: Path, modules: Collection[str] | None = None, repository: str | None = None) -> None:
    """Write every generated page below ``docs/_generated``; unchanged files keep their time: quick rebuilds.

    ``modules``: those that get a page (default: all). ``repository``: ``OWNER/NAME`` for the notebooks' buttons.
    """
    pages, modules = docs / "_generated", public_modules() if modules is None else modules
    wanted = {pages / "parameters.md": parameters_page(), pages / "api" / "index.md": api_index(modules)}
    wanted |= {pages / "api" / f"{name}.md": module_page(name) for name in modules}
    for path in _notebooks():
        wanted[pages / "notebooks" / path.relative_to(NOTEBOOKS)] = notebook_page(path, docs, repository)
    wanted[pages / "notebooks" / "index.md"] = notebooks_index(docs)
    for old in set(pages.rglob("*.*")) - set(wanted):
        old.unlink()
    for path, text in wanted.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
    for picture in (docs / "pictures").glob("notebook_*.jpg"):
        shutil.copy(picture, pages / "notebooks")
        with Image.open(picture) as whole:  # the list of all shows small ones
            whole.thumbnail((SMALL, SMALL))
            whole.save(pages / "notebooks" / f"small_{picture.name}", quality=80)


# ---- parameters -----------------------------------------------------------------------------------------------------
def parameters_page() -> str:
    """The table of :func:`adaptiveface.parameters.describe`, one section per stage."""
    lines = [
        "# Parameters",
        "",
        "Generated from `adaptiveface.parameters`, where every parameter is defined once: the same fields make the",
        "command line's `--set stage.name=value`, the sliders of the notebooks and this table. The paper's value is",
        "given where the default differs; `Parameters.paper()` uses them all.",
        "",
    ]
    stage = None
    for row in parameters.describe():
        if row["stage"] != stage:
            stage = row["stage"]
            kind = type(getattr(parameters.Parameters(), stage))
            lines += ["", f"## {stage}", "", (kind.__doc__ or "").strip(), ""]
            lines += ["| name | default | paper | range | unit | section | meaning |", "|---|---|---|---|---|---|---|"]
        lines.append("| " + " | ".join(_cells(row)) + " |")
    return "\n".join(lines) + "\n"


def _cells(row: dict) -> list[str]:
    bounds = ", ".join(row["choices"]) or ("" if row["low"] is None else f"{row['low']:g} to {row['high']:g}")
    if isinstance(row["default"], bool):
        bounds = "true, false"
    if row["log"]:
        bounds += " (log)"
    paper = "" if row["paper"] is None else _value(row["paper"])
    unit, meaning = (str(row[key]).replace("|", r"\|") for key in ("unit", "doc"))
    return [f"`{row['name']}`", _value(row["default"]), paper, bounds, unit, row["section"], meaning]


def _value(value) -> str:
    return str(value).lower() if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)


# ---- reference ------------------------------------------------------------------------------------------------------
def public_modules() -> list[str]:
    """Every importable module of the package without a leading underscore in its path."""
    found = pkgutil.walk_packages(adaptiveface.__path__, "adaptiveface.", onerror=lambda name: None)
    names = [entry.name for entry in found if not any(part.startswith("_") for part in entry.name.split("."))]
    return sorted(["adaptiveface", *names])


def module_page(name: str) -> str:
    """The page of one module."""
    directive = f".. automodule:: {name}\n   :members:\n   :ignore-module-all:\n   :show-inheritance:\n"
    # Not in the sidebar: with every module in it, every page would have to draw some 300 entries.
    return f"---\norphan: true\n---\n\n# {name}\n\n```{{eval-rst}}\n{directive}```\n"


def api_index(modules: Collection[str]) -> str:
    """The list of modules, grouped by package; those among ``modules`` are links."""
    groups: dict[str, list[str]] = {}
    for name in public_modules():
        parts = name.split(".")
        packaged = len(parts) > 2 or any(other.startswith(name + ".") for other in public_modules()) and len(parts) > 1
        groups.setdefault(parts[1] if packaged else "adaptiveface", []).append(name)
    lines = ["# Reference", "", "From the docstrings. Shapes, units and sources in the paper are given there.", ""]
    for group, names in groups.items():
        shown = [f"[`{name}`]({name}.md)" if name in modules else f"`{name}`" for name in names]
        rows = [f"* {text}: {_first_line(name)}" for text, name in zip(shown, names, strict=True)]
        lines += [f"## {group}", "", *rows, ""]
    return "\n".join(lines)


def _first_line(name: str) -> str:
    """What a module is for, from its source: importing it may need what is not installed."""
    path = Path(importlib.util.find_spec(name).origin)
    text = (ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or "").split("\n\n")[0].replace("\n", " ")
    return re.sub(r":\w+:`~?([^`]+)`", r"`\1`", text.replace("``", "`"))


# ---- notebooks ------------------------------------------------------------------------------------------------------
def _notebooks() -> list[Path]:
    return sorted(p for p in NOTEBOOKS.rglob("*.ipynb") if ".ipynb_checkpoints" not in p.parts)


def _picture(docs: Path, name: str) -> Path:
    """Screenshot of the notebook whose name starts with its number (or "live")."""
    return docs / "pictures" / f"notebook_{name.split('_')[0]}.jpg"


def notebook_page(path: Path, docs: Path, repository: str | None = None) -> str:
    """A notebook with its buttons under the title, as it was executed, or with its screenshot: panels show in Jupyter only."""
    own = path.parent == NOTEBOOKS
    executed = docs / "_executed" / path.name  # by execute_notebooks.py: with what every cell has shown
    shown = executed if own and executed.exists() else path
    notebook = json.loads(shown.read_text(encoding="utf-8"))
    picture = _picture(docs, path.name)
    if own:
        screenshot = f"\n![This notebook in JupyterLab]({picture.name})\n" if shown is path and picture.exists() else ""
        title, _, rest = "".join(notebook["cells"][0]["source"]).partition("\n")
        notebook["cells"][0]["source"] = f"{title}\n\n{buttons.row(path.name, repository)}\n{screenshot}{rest}"
    return json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"


def notebooks_index(docs: Path) -> str:
    """All notebooks with their pictures, and the solutions."""
    names = [path.relative_to(NOTEBOOKS).with_suffix("").as_posix() for path in _notebooks()]
    lines = [
        "# Notebooks",
        "",
        "`adaptiveface lab` opens them in JupyterLab, where everything moves. Here they are to be read.",
        "",
    ]
    for title, chosen in (
        ("Stage by stage", [name for name in names if "/" not in name]),
        ("Solutions of the exercises", [name for name in names if "/" in name]),
    ):
        lines += [f"## {title}", "", "```{toctree}", ":maxdepth: 1", "", *chosen, "```", ""]
        for name in chosen:
            picture = _picture(docs, name)
            if "/" not in name and picture.exists():
                lines += [f"![Notebook {name.split('_')[0]} in JupyterLab](small_{picture.name})", ""]
    return "\n".join(lines)


# ---- docstrings -----------------------------------------------------------------------------------------------------
NAPOLEON = Config(napoleon_google_docstring=False, napoleon_use_ivar=True)
LITERAL = re.compile(r"(``.+?``|:\w+:`[^`]+`)")
BARE_ROLE = re.compile(r"(:(?:class|func|meth|attr):`)(?=[A-Za-z])(?!adaptiveface)")


def plain_to_rst(app, what, name, obj, options, lines: list[str]) -> None:
    """Docstrings are plain text with ``literals``: formulas keep their stars and bars, indented blocks their layout.

    Of NumPy's sections napoleon makes fields. It is called here, because as an extension it takes what stands before a colon
    in the text of a constant or a property for a type.
    """
    starts = [n - 1 for n in range(1, len(lines)) if re.fullmatch("-{3,}", lines[n].strip())]
    ends = [*starts[1:], len(lines)]
    out = _plain(lines[: starts[0]] if starts else lines)
    for start, end in zip(starts, ends if starts else (), strict=True):
        body = lines[start + 2 : end]
        written = _plain(body) if lines[start].strip() in ("Notes", "References") else map(_section_line, body)
        out += [*lines[start : start + 2], *written]
    lines[:] = map(_type_in_words, NumpyDocstring(out, NAPOLEON, what="function").lines()) if starts else out


def _type_in_words(line: str) -> str:
    """The type of a field in italics: as plain text Sphinx would look for an object of that name, such as "actor"."""
    return re.sub(r"^(:(?:type|vartype) [^:]+:|:rtype:) ([^*`\\]+)$", r"\1 *\2*", line)


def _section_line(line: str) -> str:
    """A line of a list of parameters; what stands at the margin is a name and its type, which napoleon escapes."""
    text = line.lstrip()
    return line[: len(line) - len(text)] + _escaped(text, False) if line.startswith(" ") else line


def _plain(lines: list[str]) -> list[str]:
    """Paragraphs, bullets and indented blocks as reStructuredText."""
    out: list[str] = []
    block = False
    for line in lines:
        indent = len(line) - len(line.lstrip())
        bullet = line.lstrip().startswith(("* ", "- "))
        after_blank = bool(out) and not out[-1].strip()
        if block and line.strip() and indent < 4:
            block = False
        if not block and indent >= 4 and after_blank:
            block = True
            announced = next((text for text in reversed(out) if text.strip()), "").rstrip().endswith("::")
            out += [] if announced else ["::", ""]
        if block:
            out.append(line)
            continue
        if indent and not bullet and not after_blank and not _hangs(out):
            line = line.lstrip()
        out.append(_escaped(line, bullet))
    return out


def _hangs(out: list[str]) -> bool:
    """Whether a line continues a bullet above it."""
    for line in reversed(out):
        if line.lstrip().startswith(("* ", "- ")):
            return True
        if not line.startswith(" "):
            return False
    return False


def _escaped(line: str, bullet: bool) -> str:
    head = line[: len(line) - len(line.lstrip()) + 2] if bullet else ""
    parts = LITERAL.split(line[len(head) :])
    parts[::2] = [re.sub(r"(\w)_(?!\w)", r"\1\\_", re.sub(r"([*|])", r"\\\1", part)) for part in parts[::2]]
    for number in range(2, len(parts), 2):  # a literal must not touch the word after it
        if parts[number][:1].isalnum():
            parts[number] = "\\ " + parts[number]
    # A name without its module links to wherever in the package it is defined.
    parts[1::2] = [BARE_ROLE.sub(r"\1.", part) for part in parts[1::2]]
    return head + "".join(parts)


def forget_modules_without_source(app, env) -> None:
    """The index of sources lists every module that it was asked for, also those such as ``time`` that get no page."""
    known = getattr(env, "_viewcode_modules", {})
    for name in [name for name, entry in known.items() if not entry]:
        del known[name]


def setup(app) -> dict:
    """Register the docstring conversion."""
    app.connect("autodoc-process-docstring", plain_to_rst)
    app.connect("env-updated", forget_modules_without_source)
    return {"parallel_read_safe": True}
