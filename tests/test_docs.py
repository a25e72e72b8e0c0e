"""The docs: every public name has a docstring, every parameter a row, and the site builds without a warning."""

from __future__ import annotations

import importlib
import inspect
import json
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import pytest

import adaptiveface
from adaptiveface.errors import MissingExtraError
from adaptiveface.parameters import describe
from adaptiveface.renamed import OLD_MODULES

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
    pytest.importorskip("sphinx", reason="the extra 'docs' is not installed")
    sys.path.insert(0, str(DOCS / "_ext"))
    request.addfinalizer(lambda: sys.path.remove(str(DOCS / "_ext")))
    return importlib.import_module("generated")


def test_the_parameter_page_has_every_parameter(generated):
    page = generated.parameters_page()
    rows = [line for line in page.splitlines() if line.startswith("| `")]
    assert [re.match(r"\| `(\w+)` ", row).group(1) for row in rows] == [row["name"] for row in describe()]
    assert all(len(re.findall(r"(?<!\\)\|", row)) == 8 for row in rows)
    assert f"| `w` | {5e-5:g} |" in page and "## adaptive_pca" in page


def test_numpys_sections_become_fields(generated):
    lines = [
        "Sum.",
        "",
        "Parameters",
        "----------",
        "a, *rest : float",
        "    One ``a``: |a| < 1.",
        "",
        "Returns",
        "-------",
        "float",
    ]
    generated.plain_to_rst(None, "function", "f", None, None, lines)
    assert ":type a: *float*" in lines and ":param a: One ``a``: \\|a\\| < 1." in lines and ":rtype: *float*" in lines
    constant = ["Where they go: up, down."]
    generated.plain_to_rst(None, "data", "f", None, None, constant)
    assert constant == ["Where they go: up, down."]


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


def documented(name: str):
    """The objects of a module that its page in the reference shows: itself, functions, classes and their members."""
    module = importlib.import_module(name)
    yield name, module
    for key, value in vars(module).items():
        if key.startswith("_") or getattr(value, "__module__", None) != name:
            continue
        if inspect.isclass(value) or inspect.isfunction(value):
            yield f"{name}.{key}", value
        for member, owned in vars(value).items() if inspect.isclass(value) else ():
            if not member.startswith("_") and (inspect.isfunction(owned) or isinstance(owned, (property, classmethod))):
                yield f"{name}.{key}.{member}", owned


def test_every_docstring_is_valid_markup(generated):
    """What a build of the whole reference would complain of, in a tenth of its time: each docstring is parsed alone."""
    from docutils import frontend, nodes, utils
    from docutils.parsers import rst

    for role in ("class", "func", "meth", "attr", "mod", "data", "exc", "py:class", "py:func", "py:mod"):
        rst.roles.register_local_role(role, lambda role, raw, text, *rest, **options: ([nodes.literal(raw, text)], []))
    parser, bad = rst.Parser(), []
    settings = frontend.get_default_settings(rst.Parser)
    settings.report_level, settings.halt_level, settings.warning_stream = 5, 5, False
    for name in public_modules():
        try:
            found = list(documented(name))
        except (MissingExtraError, ModuleNotFoundError):
            continue
        for label, value in found:
            lines = (inspect.getdoc(value) or "").splitlines()
            generated.plain_to_rst(None, "function", label, None, None, lines)
            document = utils.new_document(label, settings)
            # An attribute directive is unknown here: beside a dataclass's fields it would describe them twice.
            parser.parse("\n".join(lines), document)
            bad += [f"{label}: {message.astext()}" for message in document.findall(nodes.system_message)]
    assert not bad, "\n".join(bad)


def test_every_link_between_pages_and_every_picture_exists():
    for page in [*DOCS.glob("*.md"), *DOCS.glob("programs/*.md"), *DOCS.glob("howto/*.md")]:
        for target in re.findall(r"\]\((?!https?:)([^)#]+)", page.read_text(encoding="utf-8")):
            if "_generated/" not in target:
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def texts_that_name_modules() -> list[Path]:
    root = DOCS.parent
    found = [*root.glob("*.md"), *DOCS.rglob("*.md"), *root.glob("js/src/*.js"), *root.rglob("notebooks/*.ipynb")]
    found += [path for folder in ("adaptiveface", "data_synth", "docs") for path in (root / folder).rglob("*.py")]
    return [path for path in found if path.name != "CHANGELOG.md" and "_generated" not in path.parts]


def test_every_module_that_a_text_names_exists():
    old = set(OLD_MODULES)
    for path in texts_that_name_modules():
        for name in set(re.findall(r"\badaptiveface(?:\.[a-z_]+)+", path.read_text(encoding="utf-8"))):
            assert not {name, name.rpartition(".")[0]} & old, f"{path.relative_to(DOCS.parent)}: {name} has moved"


@pytest.mark.parametrize(
    "environment, urls, expected",
    [
        ({}, "", None),
        ({"GITHUB_REPOSITORY": "someone/faces"}, "", "someone/faces"),
        ({"READTHEDOCS_GIT_CLONE_URL": "https://github.com/someone/faces.git"}, "", "someone/faces"),
        ({"GITHUB_REPOSITORY": "a/fork"}, 'Repository = "https://github.com/someone/faces"', "someone/faces"),
        ({}, 'Repository = "https://example.org/faces"', None),
    ],
)
def test_buttons_know_the_repository_or_leave_it(generated, environment, urls, expected):
    buttons = importlib.import_module("buttons")
    assert buttons.repository(environment, f"[project.urls]\n{urls}") == expected
    row = buttons.row("01_neutral_scan.ipynb", expected)
    assert "{download}`Download <../../../notebooks/01_neutral_scan.ipynb>`" in row
    for service in ("mybinder.org/v2/gh/someone/faces/HEAD", "colab.research.google.com/github/someone/faces/blob/main"):
        assert (service in row) == bool(expected)
    page = json.loads(generated.notebook_page(generated.NOTEBOOKS / "01_neutral_scan.ipynb", DOCS, expected))
    title, _, under = page["cells"][0]["source"].partition("\n\n")
    assert title.startswith("# 01 ") and "\n" not in title and under.startswith(row)


@pytest.fixture
def site_check(monkeypatch):
    """The script that checks a built site."""
    monkeypatch.syspath_prepend(str(DOCS))
    yield importlib.import_module("check_site")
    sys.modules.pop("check_site")


def sidebar(page: Path) -> str:
    """The navigation of a page of the site."""
    return page.read_text(encoding="utf-8").split('class="sidebar-tree"')[1].split("</aside>")[0]


def test_the_check_of_a_site_finds_what_is_broken(site_check, tmp_path):
    (tmp_path / "sub").mkdir()
    (tmp_path / "a.html").write_text('<h1 id="top"></h1><a href="sub/b.html#here"></a><a href="https://elsewhere.org/x">x</a>')
    (tmp_path / "sub" / "b.html").write_text('<p id="here"><a href="../a.html#top"></a><img src="p%20q.png"></p>')
    (tmp_path / "sub" / "p q.png").write_bytes(bytes(900))
    assert site_check.faults(tmp_path) == []
    assert "sub/b.html: 0.00 MB" in site_check.faults(tmp_path, 900)[0]
    (tmp_path / "a.html").write_text('<a href="sub/b.html#gone"></a><a href="c.html"></a>')
    found = site_check.faults(tmp_path)
    assert [fault.rpartition(" ")[2] for fault in found] == ["file", "anchor", "anchor"]


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_its_links_lead_somewhere(tmp_path, site_check, monkeypatch):
    for name in ("sphinx", "myst_nb", "furo", "latex2mathml"):
        pytest.importorskip(name)
    monkeypatch.setenv("GITHUB_REPOSITORY", "someone/faces")
    folders = ["-d", str(tmp_path / "doctrees"), str(DOCS), str(tmp_path / "site")]
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "-t", "quick", *folders]
    run = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert run.returncode == 0, run.stderr[-3000:]
    site = tmp_path / "site"
    assert site_check.faults(site) == []
    assert "valid_max" in (site / "_generated" / "parameters.html").read_text(encoding="utf-8")
    rigid = site / "_generated" / "api" / "adaptiveface.registration.step.html"
    assert "point_to_plane_step" in rigid.read_text(encoding="utf-8")
    (notebook,) = (site / "_generated" / "notebooks").glob("06*.html")
    assert "mybinder.org/v2/gh/someone/faces" in notebook.read_text(encoding="utf-8")
    assert any((site / "_downloads").rglob(f"{notebook.stem}.ipynb"))
    index = (site / "_generated" / "api" / "index.html").read_text(encoding="utf-8")
    linked = 'href="adaptiveface.registration.step.html"'
    assert linked in index and "adaptiveface.registration.step.html" not in sidebar(notebook)
