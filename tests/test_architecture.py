"""The packages stand on floors and import from floors below only; views alone know widgets, geometry pyvista."""

from __future__ import annotations

import ast
import importlib
from collections.abc import Iterator
from pathlib import Path

import pytest

import adaptiveface

PACKAGE = Path(__file__).resolve().parents[1] / "adaptiveface"
#: From the ground up; docs/redraw.py draws the table of docs/architecture.md from it.
FLOORS = {
    "ground": ("errors", "renamed", "files", "caches", "runtime", "parameters", "geometry", "lab", "livelink", "formats"),
    "faces": ("model", "insides"),
    "where frames come from": ("synthetic", "sensors", "landmarks"),
    "alignment": ("registration",),
    "sections 4 and 5": ("tracking",),
    "section 3": ("neutral", "importers", "exercises"),
    "what comes out": ("result",),
    "the whole method": ("pipeline",),
    "section 6": ("retargeting",),
    "running it": ("evaluation", "export", "live"),
    "reporting": ("bench", "report"),
    "many runs": ("batch", "doctor", "studies"),
    "what people see": ("views",),
    "commands": ("cli",),
    "start": ("__main__",),
}
FLOOR = {name: number for number, names in enumerate(FLOORS.values()) for name in names}
#: What tracking may take: arrays go in and come out.
TRACKING = {"model", "geometry", "parameters", "errors", "renamed", "runtime", "caches", "registration"}


def place(path: Path) -> str:
    """The package or top-level module that a file belongs to."""
    return path.relative_to(PACKAGE).parts[0].removesuffix(".py")


def files() -> list[Path]:
    return sorted(path for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py")


def imported(path: Path) -> Iterator[str]:
    """Dotted names a file imports, also inside functions, relative ones made absolute."""
    home = ("adaptiveface", *path.relative_to(PACKAGE).parent.parts)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = [*home[: len(home) - node.level + 1]] if node.level else []
            base += node.module.split(".") if node.module else []
            yield from (".".join([*base, alias.name]) for alias in node.names)


def places_of(path: Path) -> set[str]:
    """The other packages and top-level modules of ours that a file imports from."""
    names = (name.split(".") for name in imported(path))
    found = {parts[1] for parts in names if parts[0] == "adaptiveface" and len(parts) > 1 and parts[1] in FLOOR}
    return found - {place(path)}


def test_every_place_has_a_floor():
    assert {place(path) for path in files()} == set(FLOOR)


@pytest.mark.parametrize("name", sorted(FLOOR))
def test_imports_point_downwards(name):
    for path in (path for path in files() if place(path) == name):
        higher = {other for other in places_of(path) if FLOOR[other] > FLOOR[name]}
        assert not higher, f"{path.relative_to(PACKAGE)} imports from above: {sorted(higher)}"


def test_no_packages_import_each_other_in_a_circle():
    below = {name: set().union(*(places_of(path) for path in files() if place(path) == name)) for name in FLOOR}
    while ready := {name for name, others in below.items() if not others & set(below)}:
        below = {name: others for name, others in below.items() if name not in ready}
    assert not below


def needed_by(path: Path) -> set[Path]:
    """The files of ours that a file imports, also inside functions, but not for type checkers alone."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    checked = [n for n in ast.walk(tree) if isinstance(n, ast.If) and ast.unparse(n.test) == "TYPE_CHECKING"]
    skipped = {id(inside) for branch in checked for inside in ast.walk(branch)}
    found: set[Path] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level and id(node) not in skipped:
            home = path.parents[node.level - 1].joinpath(*(node.module or "").split("."))
            for name in (home / alias.name for alias in node.names):
                found |= {file for file in (name.with_suffix(".py"), name / "__init__.py") if file.is_file()} or {home}
    return {file.with_suffix(".py") if file.with_suffix(".py").is_file() else file for file in found} - {path}


def test_no_modules_import_each_other_in_a_circle():
    below = {path: needed_by(path) for path in files() if path.name != "__init__.py"}
    while ready := {path for path, others in below.items() if not others & set(below)}:
        below = {path: others for path, others in below.items() if path not in ready}
    assert not below, sorted(str(path.relative_to(PACKAGE)) for path in below)


def test_the_stub_declares_what_the_package_exports():
    """Names are imported on first use, which type checkers cannot follow; __init__.pyi tells them."""
    tree = ast.parse((PACKAGE / "__init__.pyi").read_text(encoding="utf-8"))
    declared = {a.asname: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for a in node.names}
    assert declared == adaptiveface._HOME
    assert all(getattr(adaptiveface, name).__name__ == name for name in declared)


def test_tracking_knows_no_sensor_file_or_view():
    known = set().union(*(places_of(path) for path in files() if place(path) == "tracking"))
    assert known <= TRACKING


def test_only_the_views_know_widgets_and_only_geometry_pyvista():
    owners = {"ipywidgets": "views", "anywidget": "views", "pyvista": "geometry", "vtk": "geometry"}
    for path in files():
        roots = {name.split(".")[0] for name in imported(path)}
        wrong = {name for name in roots & set(owners) if owners[name] != place(path)}
        assert not wrong, f"{path.relative_to(PACKAGE)} imports {sorted(wrong)}"


def test_the_docs_are_as_the_code_is(monkeypatch, capsys):
    """Responsibilities, imports, a frame's way and the files' arrays; ``python docs/redraw.py`` writes them."""
    monkeypatch.syspath_prepend(str(PACKAGE.parent / "docs"))
    redraw = importlib.import_module("redraw")
    stale = redraw.main(["--check"])
    assert redraw.pages() and not stale, f"{capsys.readouterr().out}run python docs/redraw.py, and look at the difference"
