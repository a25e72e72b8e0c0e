"""``binder/`` by repo2docker's rules: pinned versions that fit the package, scripts that do what they say."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

CHECKOUT = Path(__file__).resolve().parents[1]
BINDER = CHECKOUT / "binder"
PROJECT = tomllib.loads((CHECKOUT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS = ("notebooks", "landmarks", "cluster")

posix = pytest.mark.skipif(os.name != "posix", reason="shell scripts")


def canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def pins() -> dict[str, str]:
    lines = (BINDER / "requirements.txt").read_text(encoding="utf-8").splitlines()
    entries = [line for line in lines if line and not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+==[A-Za-z0-9_.+!-]+", entry) for entry in entries), entries
    return {canonical(name): version for name, version in (entry.split("==") for entry in entries)}


def test_every_requirement_is_pinned_to_a_version_that_fits():
    pinned = pins()
    wanted = [*PROJECT["dependencies"], *(r for extra in EXTRAS for r in PROJECT["optional-dependencies"][extra])]
    for requirement in map(Requirement, wanted):
        if requirement.marker is None or requirement.marker.evaluate():
            version = pinned[canonical(requirement.name)]
            assert requirement.specifier.contains(version), f"{requirement} but {version} is pinned: run binder/pin"
    assert "adaptiveface" not in pinned


def test_the_python_version_is_one_of_ours():
    version = re.fullmatch(r"python-(3\.\d+)\n", (BINDER / "runtime.txt").read_text()).group(1)
    assert SpecifierSet(PROJECT["requires-python"]).contains(version)


def test_apt_packages_are_those_of_the_continuous_integration():
    names = (BINDER / "apt.txt").read_text().split()
    assert len(set(names)) == len(names) and {"libegl1", "libgl1-mesa-dri"} <= set(names)
    tested = re.search(r'packages="([^"]+)"', (CHECKOUT / ".ci" / "run").read_text()).group(1).split()
    assert set(names) <= set(tested)


@posix
@pytest.mark.parametrize("script", ["postBuild", "start", "pin", "check"])
def test_scripts_are_executable_and_parse(script):
    path = BINDER / script
    assert os.access(path, os.X_OK) and path.read_text().startswith("#!/bin/bash\n")
    subprocess.run(["bash", "-n", str(path)], check=True)
    mode = subprocess.run(["git", "ls-files", "-s", str(path)], cwd=CHECKOUT, capture_output=True, text=True).stdout
    assert not mode or mode.startswith("100755")


@posix
def test_start_sets_the_environment_and_becomes_the_server():
    show = "import os, sys; print(os.environ['VTK_DEFAULT_OPENGL_WINDOW'], os.getpid(), *sys.argv[1:])"
    environment = {key: value for key, value in os.environ.items() if key != "VTK_DEFAULT_OPENGL_WINDOW"}
    server = subprocess.Popen(
        [str(BINDER / "start"), sys.executable, "-c", show, "two words", "x"],
        env=environment,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert server.communicate()[0].split() == ["vtkEGLRenderWindow", str(server.pid), "two", "words", "x"]


@posix
def test_post_build_installs_the_package_and_writes_jupyterlab_settings(tmp_path):
    """With a stand-in for python that records the installation and the warm-up instead of running them."""
    tools = tmp_path / "tools"
    tools.mkdir()
    fake = tools / "python"
    fake.write_text(
        f'#!/bin/bash\ncase "$1" in\n  -m) echo "$@" >> "{tmp_path}/calls" ;;\n  -) cat > "{tmp_path}/warm_up.py" ;;\n'
        f'  *) exec "{sys.executable}" "$@" ;;\nesac\n'
    )
    fake.chmod(0o755)
    environment = {**os.environ, "PATH": f"{tools}:{os.environ['PATH']}", "NB_PYTHON_PREFIX": str(tmp_path / "prefix")}
    subprocess.run([str(BINDER / "postBuild")], cwd=CHECKOUT, env=environment, check=True)
    assert (tmp_path / "calls").read_text() == "-m pip install --no-deps --no-cache-dir .\n"
    compile((tmp_path / "warm_up.py").read_text(), "warm_up.py", "exec")
    (written,) = (tmp_path / "prefix" / "share" / "jupyter" / "lab" / "settings" / "overrides.d").iterdir()
    settings = json.loads(written.read_text())
    assert settings["@jupyterlab/apputils-extension:kernels-settings"] == {"commsOverSubshells": "disabled"}
