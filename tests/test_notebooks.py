"""Notebooks are stored clean, a callback that raises fails their run, an interrupt does not end their kernel.

That every notebook runs from its first to its last cell is ``pytest --nbmake notebooks``, a part of plain ``pytest``.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

nbformat = pytest.importorskip("nbformat", reason="the extra 'notebooks' is not installed")
nbclient = pytest.importorskip("nbclient", reason="the extra 'test' is not installed")
pytest.importorskip("pyvista", reason="the extra 'notebooks' is not installed")

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
NOTEBOOKS = sorted(FOLDER.glob("*.ipynb"))


@pytest.fixture(autouse=True)
def short_and_strict(monkeypatch):
    monkeypatch.setenv("ADAPTIVEFACE_NOTEBOOK_FAST", "1")
    monkeypatch.setenv("ADAPTIVEFACE_STRICT", "1")
    monkeypatch.delenv("DISPLAY", raising=False)


def executed(cells: list[str], folder: Path, **options):
    """Run code cells in a kernel of their own; returns the notebook with its outputs."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    return run(notebook, folder, **options)


def run(notebook, folder: Path, **options):
    resources = {"metadata": {"path": str(folder)}}
    nbclient.NotebookClient(notebook, timeout=240, kernel_name="python3", resources=resources, **options).execute()
    return notebook


def text_of(notebook) -> str:
    return "".join(output.get("text", "") for cell in notebook.cells for output in cell.get("outputs", []))


def test_all_notebooks_are_here():
    assert [path.name[:2] for path in NOTEBOOKS][:9] == [f"0{k}" for k in range(9)]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebook_is_stored_clean_and_readable(path):
    """No outputs, short cells, a title, and the one line to change for a recording."""
    notebook = nbformat.read(path, 4)
    nbformat.validate(notebook)
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert not any(cell.outputs or cell.execution_count for cell in code)
    assert notebook.cells[0].source.startswith("# ") and sum("SOURCE = " in cell.source for cell in code) == 1
    assert max(len(cell.source.splitlines()) for cell in code) <= 30, "code belongs into the package"
    text = "\n".join(cell.source for cell in notebook.cells)
    assert "/tmp" not in text and "/work" not in text


def nbmake(cells: list[str], folder: Path) -> subprocess.CompletedProcess:
    """``pytest --nbmake`` on a notebook of these cells, with the settings of our own notebooks."""
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    nbformat.write(notebook, folder / "planted.ipynb")
    shutil.copy(FOLDER / "conftest.py", folder)
    (folder / "pytest.ini").write_text("[pytest]\n")
    command = [sys.executable, "-m", "pytest", "--nbmake", "-p", "no:cacheprovider", str(folder)]
    env = {k: v for k, v in os.environ.items() if not k.startswith("ADAPTIVEFACE_")}
    path = os.pathsep.join([str(FOLDER.parent), env.get("PYTHONPATH", "")])
    return subprocess.run(command, capture_output=True, text=True, env={**env, "PYTHONPATH": path}, cwd=folder)


PANEL = (
    "from adaptiveface import views\n"
    "def refuse(parameters):\n    if parameters.laplacian.w2 > 50: raise ValueError('no such face')\n"
    "panel = views.ParameterPanel(['laplacian'], refuse)\npanel.widget"
)


@pytest.mark.parametrize("value, passes", [(10.0, True), (100.0, False)])
def test_nbmake_fails_on_a_planted_slider_callback_that_raises(tmp_path, value, passes):
    """The same notebook, once with a value that its callback takes and once with one it refuses."""
    run = nbmake([PANEL, f"panel['laplacian.w2'].value = {value}"], tmp_path)
    assert (run.returncode == 0) == passes, run.stdout + run.stderr
    assert ("no such face" in run.stdout) != passes and ("1 passed" in run.stdout) == passes


def test_nbmake_fails_on_an_error_in_the_background_that_no_cell_waits_for(tmp_path):
    task = (
        "import asyncio\nfrom adaptiveface.views.kernel import BackgroundTask\n"
        "async def work():\n    raise ValueError('late')\n"
        "task = BackgroundTask()\ntask.start(work())\nawait asyncio.sleep(0.3)"
    )
    run = nbmake([task], tmp_path)
    assert run.returncode == 1 and "late" in run.stdout, run.stdout + run.stderr


def test_an_error_in_the_background_fails_the_cell_that_waits(tmp_path):
    cells = [
        "from adaptiveface.views.kernel import BackgroundTask\n"
        "async def work():\n    raise ValueError('late')\n"
        "task = BackgroundTask()\ntask.start(work())",
        "await task.finished()",
    ]
    with pytest.raises(nbclient.exceptions.CellExecutionError, match="late"):
        executed(cells, tmp_path)


def test_interrupting_a_cell_keeps_the_kernel_and_the_player(tmp_path):
    """SIGINT while a cell works or waits, with a player running beside it."""
    from jupyter_client.manager import start_new_kernel

    manager, client = start_new_kernel(kernel_name="python3", cwd=str(tmp_path), env=dict(os.environ))
    try:
        client.execute_interactive(
            "import asyncio, time\nfrom adaptiveface.views.player import Player\n"
            "player = Player(1000, lambda index: None)\nplayer.play()",
            output_hook=lambda message: None,
            timeout=60,
        )
        for busy in ("time.sleep(30)", "await asyncio.sleep(30)"):
            # With the default, the kernel drops what is asked in the moment after an error.
            request = client.execute(busy, stop_on_error=False)
            while True:  # until it has begun
                message = client.get_iopub_msg(timeout=120)
                if message["msg_type"] == "execute_input" and message["parent_header"]["msg_id"] == request:
                    break
            time.sleep(0.5)
            manager.interrupt_kernel()
            reply = client.get_shell_msg(timeout=20)  # less than the cell's 30 s
            assert reply["content"]["status"] == "error" and manager.is_alive()
        answers = []
        client.execute_interactive(
            "before = player.drawn\nawait asyncio.sleep(0.5)\nprint('playing', player.drawn > before)\nplayer.close()",
            output_hook=lambda message: answers.append(message["content"].get("text", "")),
            timeout=30,
        )
        assert "playing True" in "".join(answers)
    finally:
        client.stop_channels()
        manager.shutdown_kernel(now=True)


CHAPTERS = NOTEBOOKS


@pytest.mark.parametrize("path", CHAPTERS, ids=lambda path: path.stem)
def test_a_chapter_says_what_it_is_about_and_ends_with_questions_that_unfold(path):
    cells = nbformat.read(path, 4).cells
    about, questions = cells[1].source, cells[-1].source
    for word in ("you will learn", "you need", "it takes", "in the paper"):
        assert f"| {word} | " in about
    assert questions.count("<details><summary>") == questions.count("</details>") == 5
    assert "## Further reading" in questions
    following = questions.rsplit("](", 1)[1].rstrip(")")
    assert (FOLDER / following).is_file()
