"""The docs: every public name has a docstring, every parameter a row, and the site builds without a warning."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import adaptiveface
from adaptiveface.errors import MissingExtraError
from adaptiveface.parameters import describe

DOCS = Path(__file__).resolve().parents[1] / "docs"


def public_modules() -> list[str]:
    walk = pkgutil.walk_packages(adaptiveface.__path__, "adaptiveface.", onerror=lambda name: None)
    return ["adaptiveface", *(m.name for m in walk if not re.search(r"\._", m.name))]


def undocumented(name: str) -> list[str]:
    """Public functions and classes defined in a module that have no docstring."""
    module = importlib.import_module(name)
    missing = [] if (module.__doc__ or "").strip() else [name]
    for key, value in vars(module).items():
        if key.startswith("_") or getattr(value, "__module__", None) != name:
            continue
        if inspect.isclass(value) or inspect.isfunction(value):
            if not _own_doc(value):
                missing.append(f"{name}.{key}")
    return missing


def _own_doc(value) -> bool:
    """Whether there is a docstring that a person wrote: dataclasses make one of their signature."""
    text = (value.__dict__.get("__doc__") if inspect.isclass(value) else value.__doc__) or ""
    return bool(text.strip()) and not (inspect.isclass(value) and text.startswith(f"{value.__name__}("))


@pytest.mark.parametrize("name", public_modules())
def test_every_public_name_has_a_docstring(name):
    try:
        importlib.import_module(name)
    except (MissingExtraError, ModuleNotFoundError) as error:
        pytest.skip(f"an extra is not installed: {error}")
    assert undocumented(name) == []


@pytest.fixture(scope="module")
def generated(request):
    """The module that writes pages from the package."""
    sys.path.insert(0, str(DOCS / "_ext"))
    request.addfinalizer(lambda: sys.path.remove(str(DOCS / "_ext")))
    return importlib.import_module("generated")


def test_the_parameter_page_has_every_parameter(generated):
    page = generated.parameters_page()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert [re.match(r"\| `(\w+)` ", row).group(1) for row in rows] == [row["name"] for row in describe()]
    assert all(len(re.findall(r"(?<!\\)\|", row)) == 8 for row in rows)
    assert f"| `w` | {5e-5:g} |" in page and "## adaptive_pca" in page


def test_docstrings_become_valid_markup(generated):
    lines = ["Energy |L d|^2 and M_ of ``a_b|c``s:", "", "    w1 |x|_1", "", "* one", "  more", "text", "    hangs"]
    generated.plain_to_rst(None, "function", "f", None, None, lines)
    assert lines[0] == r"Energy \|L d\|^2 and M\_ of ``a_b|c``\ s:"
    assert lines[2:5] == ["::", "", "    w1 |x|_1"]
    assert lines[-4:] == ["* one", "  more", "text", "hangs"]


def test_names_with_underscores_in_formulas_show_no_backslash(generated):
    pytest.importorskip("latex2mathml")
    shown = re.sub(r"<[^>]+>", "", importlib.import_module("mathml").to_mathml(r"\textit{valid\_min} < \|s\|^2"))
    assert shown.replace("&#x0005F;", "_").startswith("valid_min") and "\\" not in shown


def test_every_link_between_pages_and_every_picture_exists():
    for page in DOCS.glob("*.md"):
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8")):
            if not target.startswith("_generated/"):
                assert (DOCS / target).exists(), f"{page.name}: {target}"


def sidebar(page: Path) -> str:
    """The navigation of a page of the site."""
    return page.read_text(encoding="utf-8").split('class="sidebar-tree"')[1].split("</aside>")[0]


@pytest.mark.slow
def test_the_site_builds_without_a_warning(tmp_path):
    for name in ("sphinx", "myst_nb", "furo", "latex2mathml"):
        pytest.importorskip(name)
    folders = ["-d", str(tmp_path / "doctrees"), str(DOCS), str(tmp_path / "site")]
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-t", "quick", *folders]
    run = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[-3000:]
    site = tmp_path / "site"
    assert "valid_max" in (site / "_generated" / "parameters.html").read_text(encoding="utf-8")
    rigid = site / "_generated" / "api" / "adaptiveface.registration.step.html"
    assert "point_to_plane_step" in rigid.read_text(encoding="utf-8")
    assert any((site / "_generated" / "notebooks").glob("06*.html"))
    index = (site / "_generated" / "api" / "index.html").read_text(encoding="utf-8")
    assert 'href="adaptiveface.tracking.rigid.html"' in index and "adaptiveface.tracking.rigid.html" not in sidebar(rigid)
