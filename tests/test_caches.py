"""Compiled code, model and session are cached where it can be written, private where others write, and never under ~."""

from __future__ import annotations

import importlib.util
import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numba.core import caching

from adaptiveface.caches import cache_folder, cache_folders, folders
from adaptiveface.errors import FileFormatError
from adaptiveface.studies.rendered import RenderedPerformance
from adaptiveface.studies.session import load_session

PROGRAM = """
import sys
sys.path.insert(0, sys.argv[1])
from module import twice, halves
print(twice(3), halves(3))
import adaptiveface.caches
print(adaptiveface.caches.cache_folder())
"""
MODULE = """
from adaptiveface.caches.compiled import compiled
@compiled
def twice(x):
    return 2 * x
@compiled(nogil=True)
def halves(x):
    return twice(x) / 4
"""
ROOT = Path(__file__).resolve().parents[1]
#: Becomes another user who may read everything (where Python is the root's own) and write what a user may.
SETPRIV = [
    "setpriv",
    "--reuid=12345",
    "--regid=12345",
    "--clear-groups",
    "--inh-caps=+dac_read_search",
    "--ambient-caps=+dac_read_search",
]
needs_root = pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0 or shutil.which("setpriv") is None, reason="changes the user"
)


@pytest.fixture
def place(tmp_path):
    """A package folder with compiled functions, an empty home and a folder for temporary files."""
    for name in ("package", "home", "temporary", "here"):
        (tmp_path / name).mkdir()
    (tmp_path / "package" / "module.py").write_text(MODULE)
    return tmp_path


def run(place: Path, home: str | None, other: bool = False, program: str = PROGRAM):
    """Run a program in ``here`` with that home, as this or as another user."""
    values = {"PATH": os.environ["PATH"], "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1"}
    values |= {"TMPDIR": str(place / "temporary")} | ({} if home is None else {"HOME": home})
    command = [*(SETPRIV if other else []), sys.executable, "-c", program, str(place / "package")]
    return subprocess.run(command, cwd=place / "here", env=values, capture_output=True, text=True)


def compiled_files(folder: Path) -> list[Path]:
    return sorted(folder.rglob("*.nbi"))


def read_only(place: Path) -> None:
    for path in (place / "package", place / "home"):
        path.chmod(0o555)
    (place / "temporary").chmod(0o1777)
    (place / "here").chmod(0o777)
    for parent in [place, *place.parents[:3]]:  # pytest's own folders are the owner's alone
        if str(parent).startswith("/tmp/"):
            parent.chmod(0o755)


def test_beside_the_module_where_that_can_be_written(place):
    done = run(place, str(place / "home"))
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.startswith("6 1.5")
    assert len(compiled_files(place / "package")) == 2 and not compiled_files(place / "home")


@needs_root
@pytest.mark.parametrize("home", ["/nonexistent", None, "", "/", "relative", "HERE"])
def test_another_user_without_a_home_uses_the_temporary_folder(place, home):
    """A container with a foreign user id: no passwd entry, nothing but the temporary folder can be written."""
    read_only(place)
    done = run(place, str(place / "home") if home == "HERE" else home, other=True)
    assert done.returncode == 0, done.stderr
    folder = place / "temporary" / "adaptiveface-12345"
    assert done.stderr == "" and done.stdout.splitlines() == ["6 1.5", str(folder)]
    assert len(compiled_files(folder)) == 2 and stat.S_IMODE(folder.stat().st_mode) == 0o700
    assert not list((place / "here").iterdir())  # no folder named ~
    again = run(place, home, other=True)
    assert (again.returncode, again.stderr) == (0, "")


@needs_root
def test_the_users_cache_where_the_package_is_read_only(place):
    read_only(place)
    (place / "home").chmod(0o777)
    done = run(place, str(place / "home"), other=True)
    assert done.returncode == 0, done.stderr
    assert len(compiled_files(place / "home" / ".cache" / "adaptiveface")) == 2


@needs_root
def test_nowhere_at_all_still_runs(place):
    read_only(place)
    (place / "temporary").chmod(0o555)
    (place / "here").chmod(0o555)
    # Python looks for other temporary folders, and finds /tmp here.
    program = PROGRAM.replace("import sys\n", "import sys, tempfile\ntempfile.tempdir = sys.argv[1]\n")
    done = run(place, None, other=True, program=program)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["6 1.5", "None"]


@needs_root
@pytest.mark.parametrize("trap", ["foreign", "writable", "link", "file"])
def test_a_temporary_folder_that_others_can_write_is_not_trusted(place, trap):
    """Cached code is run: what somebody else put there beforehand is not."""
    read_only(place)
    folder = place / "temporary" / "adaptiveface-12345"
    if trap == "file":
        folder.write_text("")
    elif trap == "link":
        (place / "elsewhere").mkdir(mode=0o777)
        folder.symlink_to(place / "elsewhere")
    else:
        folder.mkdir()
        folder.chmod(0o777)
        os.chown(folder, 12345 if trap == "writable" else 54321, 12345)
    done = run(place, None, other=True)
    assert done.returncode == 0 and done.stdout.splitlines() == ["6 1.5", "None"]


@pytest.mark.parametrize("suffix", [".nbi", ".nbc"])
@pytest.mark.parametrize("damage", ["empty", "half", "noise", "one bit", "folder"])
def test_damaged_compiled_code_is_made_again(place, suffix, damage):
    assert run(place, str(place / "home")).returncode == 0
    paths = [path for path in (place / "package").rglob(f"*{suffix}") if "twice" in path.name or "halves" in path.name]
    assert paths
    for path in paths:
        content = bytearray(path.read_bytes())
        if damage == "one bit":
            content[len(content) // 2] ^= 16
        path.unlink()
        if damage == "folder":
            path.mkdir()
        else:
            path.write_bytes(
                {"empty": b"", "half": content[: len(content) // 2], "noise": os.urandom(500), "one bit": content}[damage]
            )
    done = run(place, str(place / "home"))
    assert done.returncode == 0 and done.stdout.startswith("6 1.5"), done.stderr
    assert "Traceback" not in done.stderr and done.stderr.count("\n") <= 1
    if damage != "folder":
        assert done.stderr == "" or "thrown away and made again" in done.stderr
        again = run(place, str(place / "home"))
        assert (again.returncode, again.stderr) == (0, "")


def test_a_home_that_is_not_known_leaves_no_folder_named_after_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for path in ("~/.cache/adaptiveface", "cache", "/x/~/adaptiveface"):
        monkeypatch.setattr(folders, "user_cache_path", lambda name, path=path: Path(path))
        assert len(cache_folders()) == 1 and cache_folder() == cache_folders()[0]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("damage", ["empty", "half", "other"])
@pytest.mark.parametrize("which", ["performance", "actor"])
def test_a_damaged_session_is_made_again_and_says_so(tmp_path, capsys, which, damage):
    def load():
        session = load_session("synthetic:3:none", neutral_frames=4, frames=2, cache=tmp_path)
        return session, session.actor

    session, actor = load()
    path = next(p for p in tmp_path.iterdir() if p.name.endswith(".actor.npz") == (which == "actor"))
    content = path.read_bytes()
    path.unlink()  # the session has the file mapped: its own stays what it was
    if damage == "other":
        np.savez(path, something=np.zeros(3))
    else:
        path.write_bytes(content[: len(content) // 2] if damage == "half" else b"")
    capsys.readouterr()
    again, same = load()
    lines = [line for line in capsys.readouterr().out.splitlines() if "made again" in line]
    assert len(lines) == 1 and lines[0].startswith(f"{path}: damaged, made again")
    np.testing.assert_array_equal(again.frames[0].depth, session.frames[0].depth)
    np.testing.assert_allclose(same.neutral, actor.neutral, atol=1e-3)
    load()
    assert capsys.readouterr().out == ""


def test_the_large_arrays_of_a_kept_performance_stay_on_the_disk(tmp_path):
    load_session("synthetic:3:none", neutral_frames=2, frames=2, cache=tmp_path)
    (path,) = tmp_path.iterdir()
    data = RenderedPerformance.load(path)
    assert {name for name, values in vars(data).items() if isinstance(values, np.memmap)} == {"depth", "colour"}
    with np.load(path) as stored:
        assert list(stored) == list(vars(data)), "the file has the record's arrays in its order"
        for name, values in vars(data).items():
            assert stored[name].dtype == values.dtype and np.array_equal(stored[name], values)
    np.savez(tmp_path / "other.npz", **vars(data) | {"depth": data.depth[0]})
    with pytest.raises(FileFormatError, match=r"other\.npz: .*'depth'.*480"):
        RenderedPerformance.load(tmp_path / "other.npz")


def test_a_session_that_cannot_be_kept_still_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("adaptiveface.studies.session.cache_folder", lambda: None)
    assert len(load_session("synthetic:3:none", neutral_frames=2, frames=2)) == 4
    (tmp_path / "file").write_text("")
    assert len(load_session("synthetic:3:none", neutral_frames=2, frames=2, cache=tmp_path / "file" / "x")) == 4
    assert "not kept for the next time" in capsys.readouterr().out


def test_older_versions_of_numba_name_their_classes_otherwise(monkeypatch):
    """0.60, the oldest that is asked for, has an underscore before two of them."""
    with monkeypatch.context() as patch:
        for name in ("InTreeCacheLocator", "UserProvidedCacheLocator"):
            patch.setattr(caching, f"_{name}", getattr(caching, name), raising=False)
            patch.delattr(caching, name)
        module = importlib.util.module_from_spec(importlib.util.find_spec("adaptiveface.caches.compiled"))
        module.__spec__.loader.exec_module(module)
        assert module._Checked._locator_classes[1] is caching._InTreeCacheLocator
