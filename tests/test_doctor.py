"""``adaptiveface doctor``: it sees what is absent, broken or overwritten, names a way out, and ends with 0 or 1."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import tomllib
from importlib.metadata import PathDistribution
from pathlib import Path

import pytest

from adaptiveface import doctor
from adaptiveface.cli import main
from adaptiveface.doctor import FAULT, NOTE, OK, Finding, opencv_files, places, software

PROJECT = tomllib.loads((Path(__file__).resolve().parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def test_it_knows_every_dependency_and_every_extra():
    needed = {re.match(r"[\w-]+", line)[0].lower() for line in PROJECT["dependencies"]}
    assert needed == {name.lower() for name in software.NEEDED} | {opencv_files.OURS}
    assert set(PROJECT["optional-dependencies"]) - {"test"} == set(software.EXTRAS) | set(software.SENSORS)


def test_this_machine(capsys):
    status = main(["doctor", "--json"])
    found = [Finding(**entry) for entry in json.loads(capsys.readouterr().out)]
    assert status == int(any(finding.state == FAULT for finding in found))
    groups = {finding.group for finding in found}
    assert {"versions", "OpenCV", "optional parts", "sensors", "graphics", "notebooks", "caches"} <= groups
    for finding in found:
        assert finding.state in (OK, NOTE, FAULT) and finding.text and "\n" not in finding.text
        assert finding.fix or finding.state == OK, finding
    versions = {finding.name: finding for finding in found if finding.group == "versions"}
    assert versions["numba"].state == OK and re.match(r"\d+\.\d+", versions["numba"].text)


def distribution(site: Path, name: str, files: dict[str, bytes]) -> PathDistribution:
    """A distribution that was installed to ``site``: its files and their record."""
    info = site / f"{name.replace('-', '_')}-5.0.dist-info"
    info.mkdir(parents=True)
    rows = []
    for path, content in files.items():
        (site / path).parent.mkdir(exist_ok=True)
        (site / path).write_bytes(content)
        digest = base64.urlsafe_b64encode(hashlib.sha256(content).digest()).rstrip(b"=").decode()
        rows.append(f"{path},sha256={digest},{len(content)}")
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 5.0\n")
    (info / "RECORD").write_text("\n".join(rows) + "\n")
    return PathDistribution(info)


FIRST = {"cv2/__init__.py": b"one", "cv2/cv2.so": b"first"}
SECOND = {"cv2/__init__.py": b"one", "cv2/cv2.so": b"second"}
CONTRIB, HEADLESS = "opencv-contrib-python", "opencv-contrib-python-headless"


@pytest.mark.parametrize(
    "order, spoil, state, words",
    [
        ([(HEADLESS, FIRST)], None, OK, "all files its own"),
        ([(HEADLESS, FIRST), (CONTRIB, SECOND)], None, NOTE, f"the files are {CONTRIB}'s, those of {HEADLESS} are gone"),
        ([(CONTRIB, SECOND), (HEADLESS, FIRST)], None, NOTE, f"the files are {HEADLESS}'s, those of {CONTRIB} are gone"),
        ([(HEADLESS, FIRST)], "change", FAULT, "overwritten or are missing (cv2/cv2.so)"),
        ([(HEADLESS, FIRST), (CONTRIB, SECOND)], "remove", FAULT, "overwritten or are missing (cv2/cv2.so)"),
        ([], None, FAULT, "not installed"),
    ],
)
def test_distributions_of_opencv(tmp_path, monkeypatch, order, spoil, state, words):
    found = [distribution(tmp_path, name, files) for name, files in order]
    if spoil == "change":
        (tmp_path / "cv2/cv2.so").write_bytes(b"somebody else's")
    elif spoil == "remove":
        (tmp_path / "cv2/cv2.so").unlink()
    monkeypatch.setattr(opencv_files, "distributions", lambda: found)
    monkeypatch.setattr(opencv_files, "failure", lambda statement: None if found else "ModuleNotFoundError: No module 'cv2'")
    (finding,) = opencv_files.opencv()
    assert finding.state == state and words in finding.text
    if state != OK:
        assert finding.fix.endswith(f"pip install --no-deps --force-reinstall {HEADLESS}")
        assert all(name in finding.fix for name, _ in order)


def test_a_missing_extra_is_a_note_and_a_broken_one_a_fault(monkeypatch):
    monkeypatch.setattr(software, "importable", lambda module: module != "pxr")
    monkeypatch.setattr(software, "failure", lambda statement: "ImportError: libEGL.so.1" if "mediapipe" in statement else None)
    found = {finding.name: finding for finding in software.optional()}
    assert found["usd"].state == NOTE and found["usd"].fix == 'python -m pip install "adaptiveface[usd]"'
    assert found["landmarks"].state == FAULT and "libEGL.so.1" in found["landmarks"].text
    assert "apt install libegl1" in found["landmarks"].fix and found["video"].state == OK


def test_caches_that_cannot_be_written(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(places, "cache_folders", lambda: [tmp_path / "file" / "x", tmp_path / "temporary"])
    monkeypatch.setattr(places, "cache_folder", lambda: tmp_path / "temporary")
    monkeypatch.setattr(places, "failure", lambda statement: None)
    first, second, compiled, model = places.caches()
    assert first.state == NOTE and "cannot be written" in first.text and "HOME" in first.fix
    assert second.state == NOTE and "in use" in second.text and compiled.state == OK
    monkeypatch.setattr(places, "cache_folders", list)
    monkeypatch.setattr(places, "cache_folder", lambda: None)
    assert places.caches()[0].text == "none can be written"


def test_a_check_that_fails_is_reported(monkeypatch, capsys):
    def broken():
        raise OSError("disk on fire")

    monkeypatch.setattr(doctor, "CHECKS", (broken,))
    assert main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "could not be examined (disk on fire)" in out and "1 to be mended" in out
