"""``adaptiveface lab``: the copy it makes, the server it starts, and the notebooks inside the wheel."""

from __future__ import annotations

import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
import urllib.error
import urllib.request
import zipfile
from pathlib import Path

import pytest

from adaptiveface import lab
from adaptiveface.cli import main
from adaptiveface.errors import AdaptiveFaceError

CHECKOUT = Path(__file__).resolve().parents[1]


@pytest.fixture
def source(tmp_path):
    """A folder of two notebooks and what must not be copied."""
    folder = tmp_path / "source"
    (folder / "solutions").mkdir(parents=True)
    (folder / ".ipynb_checkpoints").mkdir()
    (folder / "00_start.ipynb").write_text('{"a": 1}')
    (folder / "solutions" / "03_step.ipynb").write_text('{"b": 1}')
    (folder / ".ipynb_checkpoints" / "00_start-checkpoint.ipynb").write_text("{}")
    return folder


def test_copies_once_and_again_only_what_was_not_changed(source, tmp_path):
    mine = tmp_path / "deep" / "mine"
    assert lab.copy_notebooks(mine, source) == lab.Copied(("00_start.ipynb", "solutions/03_step.ipynb"), (), ())
    assert not (mine / ".ipynb_checkpoints").exists()
    assert lab.copy_notebooks(mine, source) == lab.Copied((), (), ())
    (mine / "00_start.ipynb").write_text('{"a": "my own"}')
    (source / "00_start.ipynb").write_text('{"a": 2}')
    (source / "solutions" / "03_step.ipynb").write_text('{"b": 2}')
    assert lab.copy_notebooks(mine, source) == lab.Copied((), ("solutions/03_step.ipynb",), ("00_start.ipynb",))
    assert json.loads((mine / "00_start.ipynb").read_text()) == {"a": "my own"}
    assert json.loads((mine / "solutions" / "03_step.ipynb").read_text()) == {"b": 2}
    (mine / "00_start.ipynb").unlink()
    assert lab.copy_notebooks(mine, source).new == ("00_start.ipynb",)


@pytest.mark.parametrize("damage", ["not json", "[1, 2]", None])
def test_without_a_record_nothing_is_overwritten(source, tmp_path, damage):
    mine = tmp_path / "mine"
    lab.copy_notebooks(mine, source)
    record = mine / lab.STATE / "copied.json"
    record.write_text(damage) if damage else record.unlink()
    (source / "00_start.ipynb").write_text('{"a": 2}')
    assert lab.copy_notebooks(mine, source).kept == ("00_start.ipynb",)
    assert (mine / "00_start.ipynb").read_text() == '{"a": 1}'


def test_the_copy_is_writable_even_if_the_package_is_not(source, tmp_path):
    (source / "00_start.ipynb").chmod(0o444)
    lab.copy_notebooks(tmp_path / "mine", source)
    assert os.stat(tmp_path / "mine" / "00_start.ipynb").st_mode & 0o200


def test_environment_for_machines_without_a_display(tmp_path):
    values = lab.lab_environment(tmp_path, {"VTK_DEFAULT_OPENGL_WINDOW": "", "JUPYTER_CONFIG_PATH": "/etc/mine"})
    assert values["VTK_DEFAULT_OPENGL_WINDOW"] == ("vtkEGLRenderWindow" if sys.platform.startswith("linux") else "")
    assert "VTK_DEFAULT_OPENGL_WINDOW" not in lab.lab_environment(tmp_path, {"DISPLAY": ":0"})
    own, other = values["JUPYTER_CONFIG_PATH"].split(os.pathsep)
    assert other == "/etc/mine"
    settings = json.loads((Path(own) / "labconfig" / "default_setting_overrides.json").read_text())
    assert settings["@jupyterlab/apputils-extension:kernels-settings"] == {"commsOverSubshells": "disabled"}
    assert list(Path(values["VTK_WASM_DIR_OVERRIDE"]).iterdir()) == []


def test_no_dialog_asks_for_a_build(tmp_path, monkeypatch):
    """JupyterLab itself reads it: with an extension in source form it would ask "Build Recommended" over the notebook."""
    get_page_config = pytest.importorskip("jupyterlab_server.config").get_page_config
    monkeypatch.setenv("JUPYTER_CONFIG_PATH", lab.lab_environment(tmp_path, {})["JUPYTER_CONFIG_PATH"])
    told = get_page_config([])
    assert (told["buildCheck"], told["buildAvailable"]) == (False, False)


def test_command_listens_on_this_machine_only(source, tmp_path):
    lab.copy_notebooks(tmp_path, source)
    command = lab.lab_command(tmp_path, 8899, browser=False)
    assert {"--ServerApp.ip=127.0.0.1", "--ServerApp.port=8899", "--no-browser"} < set(command)
    assert "--LabApp.default_url=/lab/tree/00_start.ipynb" in command
    assert not any("token" in word or "password" in word for word in command)
    assert "--no-browser" not in lab.lab_command(tmp_path)


def test_without_jupyterlab_the_pip_line_is_told(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(lab, "NEEDED", ("jupyterlab_that_nobody_has",))
    assert main(["lab", "--dir", str(tmp_path / "mine")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and 'pip install "adaptiveface[notebooks]"' in error
    assert not (tmp_path / "mine").exists()


def test_bad_folders_and_ports_end_in_one_line(monkeypatch, tmp_path, capsys):
    monkeypatch.setattr(lab, "NEEDED", ())
    (tmp_path / "file").write_text("")
    assert main(["lab", "--dir", str(tmp_path / "file")]) == 2
    assert "is a file" in capsys.readouterr().err
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        assert main(["lab", "--dir", str(tmp_path / "a"), "--port", str(taken.getsockname()[1])]) == 2
    assert "--port" in capsys.readouterr().err
    monkeypatch.setattr(lab, "__file__", str(tmp_path / "nowhere" / "lab.py"))
    with pytest.raises(AdaptiveFaceError, match="missing from the installation"):
        lab.packaged_notebooks()


def test_the_wheel_holds_the_notebooks(tmp_path):
    """Built from a copy of the checkout's packaging files, so that nothing is left in it."""
    pytest.importorskip("setuptools", minversion="77")
    copy = tmp_path / "checkout"
    copy.mkdir()
    for name in ("pyproject.toml", "setup.py", "MANIFEST.in", "README.md", "LICENSE"):
        if (CHECKOUT / name).exists():
            shutil.copy(CHECKOUT / name, copy)
    shutil.copytree(CHECKOUT / "notebooks", copy / "notebooks")
    (copy / "adaptiveface" / "assets").mkdir(parents=True)
    for name in ("__init__.py", "lab.py", "errors.py", "assets/LICENSE-face_model.txt"):
        shutil.copy(CHECKOUT / "adaptiveface" / name, copy / "adaptiveface" / name)
    build = "from setuptools.build_meta import build_wheel; print(build_wheel('.'))"
    run = subprocess.run([sys.executable, "-c", build], cwd=copy, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stderr[-2000:]
    (wheel,) = copy.glob("*.whl")
    names = set(zipfile.ZipFile(wheel).namelist())
    wanted = {
        p.relative_to(CHECKOUT / "notebooks").as_posix()
        for p in (CHECKOUT / "notebooks").rglob("*.ipynb")
        if ".ipynb_checkpoints" not in p.parts
    }
    packed = {n.removeprefix("adaptiveface/_notebooks/") for n in names if n.startswith("adaptiveface/_notebooks/")}
    assert packed == wanted and "solutions/03_point_to_plane_step.ipynb" in packed


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals")
def test_jupyterlab_starts_serves_the_notebooks_and_its_settings(tmp_path):
    pytest.importorskip("jupyterlab")
    port, folder = free_port(), tmp_path / "mine"
    own = {"HOME": str(tmp_path), "JUPYTER_TOKEN": "secret", "JUPYTER_RUNTIME_DIR": str(tmp_path / "runtime")}
    code = "from adaptiveface import cli, lab; lab.NEEDED = ('jupyterlab',); raise SystemExit(cli.main())"
    arguments = ["lab", "--dir", str(folder), "--port", str(port), "--no-browser"]
    server = subprocess.Popen(
        [sys.executable, "-c", code, *arguments],
        cwd=tmp_path,
        env={**os.environ, **own},
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )
    try:

        def get(path: str):
            address, token = f"http://127.0.0.1:{port}{path}", {"Authorization": "token secret"}
            return json.load(urllib.request.urlopen(urllib.request.Request(address, headers=token), timeout=5))

        wait_for_server(server, port)
        names = {entry["name"] for entry in get("/api/contents/solutions")["content"]}
        assert "06_em_step.ipynb" in names
        settings = get("/lab/api/settings/@jupyterlab/apputils-extension:kernels-settings")
        assert settings["schema"]["properties"]["commsOverSubshells"]["default"] == "disabled"
        with pytest.raises(urllib.error.HTTPError, match="403"):
            urllib.request.urlopen(f"http://127.0.0.1:{port}/api/contents", timeout=5)
    finally:
        server.send_signal(signal.SIGTERM)
        output = server.communicate(timeout=120)[0]
    assert str(folder) in output
    with socket.socket() as probe:
        assert probe.connect_ex(("127.0.0.1", port)) != 0  # nothing is left


def wait_for_server(server: subprocess.Popen, port: int, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end and server.poll() is None:
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.2)
    raise AssertionError(f"JupyterLab did not start: {server.poll()}")
