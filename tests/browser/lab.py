"""JupyterLab in a real browser: start both, run a notebook, find its widgets, watch its pictures."""

from __future__ import annotations

import io
import json
import os
import shutil
import socket
import subprocess
import sys
import time
import urllib.request
from collections.abc import Callable
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image

from adaptiveface.lab import PAGE, SETTINGS

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
CHROMIUM = os.environ.get("CHROMIUM") or shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = [
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
#: Console errors that JupyterLab itself makes without network or with an empty settings folder.
HARMLESS = (
    "favicon",
    "the server responded with a status of 404",
    "net::ERR_",
    "Failed to load resource",
    "Content Security Policy",
    "service worker",
    "ResizeObserver",
)

_IDLE = "() => window.jupyterapp?.shell.currentWidget?.sessionContext?.session?.kernel?.status === 'idle'"
#: From the notebook itself: how its page marks an error changes with JupyterLab.
_ERRORS = """() => [...window.jupyterapp.shell.currentWidget.content.model.cells]
  .flatMap(cell => cell.type === 'code' ? cell.outputs.toJSON() : [])
  .filter(output => output.output_type === 'error').map(output => `${output.ename}: ${output.evalue}`)"""
#: Counts the charts that the browser decodes, the pictures of faces with new shapes or colours, and, "turned", all that it
#: draws of faces, with their times.
_WATCH = """() => { window.loads = {face: [], chart: [], turned: []};
  document.addEventListener('load', e => {
    if (e.target.className?.includes?.('adaptiveface-chart')) window.loads.chart.push(performance.now()); }, true);
  document.addEventListener('adaptiveface-picture', e => {
    window.loads.turned.push(performance.now());
    if (e.detail.fresh) window.loads.face.push(performance.now()); }, true); }"""


@contextmanager
def jupyter_lab(folder: Path, notebooks=(), **environment):
    """JupyterLab on copies of the named notebooks in ``folder``; gives its address, and ends it afterwards."""
    for name in notebooks:
        shutil.copy(NOTEBOOKS / name, folder)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    folders = ("JUPYTER_CONFIG_DIR", "JUPYTER_RUNTIME_DIR", "IPYTHONDIR", "JUPYTERLAB_WORKSPACES_DIR")
    private = {name: str(folder / ".jupyter" / name) for name in (*folders, "JUPYTERLAB_SETTINGS_DIR")}
    quiet = Path(private["JUPYTER_CONFIG_DIR"]) / "labconfig"  # no dialog in front of the notebook, and no question about news
    quiet.mkdir(parents=True, exist_ok=True)
    news = "@jupyterlab/apputils-extension:notification"
    for name, content in (("page_config", PAGE), ("default_setting_overrides", {news: SETTINGS[news]})):
        (quiet / f"{name}.json").write_text(json.dumps(content))
    env = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "ADAPTIVEFACE_STRICT")} | private | environment
    arguments = [
        "--no-browser",
        "--allow-root",
        "--ip=127.0.0.1",
        f"--port={port}",
        "--ServerApp.port_retries=0",
        "--IdentityProvider.token=",
        "--LabApp.expose_app_in_browser=True",
        "--LabApp.news_url=",
        "--LabApp.extension_manager=readonly",  # asks no package registry
        f"--ServerApp.root_dir={folder}",
    ]
    with open(folder / "lab.log", "w") as log:
        server = subprocess.Popen([sys.executable, "-m", "jupyterlab", *arguments], env=env, stdout=log, stderr=log)
        try:
            address = f"http://127.0.0.1:{port}"
            _wait_for(address + "/api", folder / "lab.log")
            yield address
        finally:
            server.terminate()
            server.wait(60)


def _wait_for(address: str, log: Path, seconds: float = 240.0) -> None:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        try:
            urllib.request.urlopen(address, timeout=1)
            return
        except OSError:
            time.sleep(0.2)
    raise RuntimeError(log.read_text()[-2000:])


@contextmanager
def chromium_page(width: int = 1500, height: int = 1300):
    """A page of Debian's chromium; ``page.problems`` collects console errors that are not known to be harmless."""
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, headless=True, args=FLAGS)
        try:
            page = browser.new_context(viewport={"width": width, "height": height}).new_page()
            page.problems = []

            def note(message) -> None:
                text = f"{message.text} {message.location.get('url', '')}"
                if message.type == "error" and not any(h.lower() in text.lower() for h in HARMLESS):
                    page.problems.append(text)

            page.on("console", note)
            page.on("pageerror", lambda error: page.problems.append(str(error)))
            yield page
        finally:
            browser.close()


def open_notebook(page, address: str, name: str) -> None:
    """Open a notebook and wait until its kernel is idle (running cells earlier races with its start)."""
    page.goto(f"{address}/lab/tree/{name}?reset")
    page.wait_for_selector(".jp-NotebookPanel .jp-CodeCell", timeout=240_000)
    page.wait_for_function(_IDLE, timeout=240_000)
    page.evaluate(_WATCH)
    # All cells in the page at once: JupyterLab otherwise takes those out that are not in sight.
    page.evaluate(
        "() => { const p = window.jupyterapp.shell.currentWidget; p.content.notebookConfig = "
        "{...p.content.notebookConfig, windowingMode: 'none'}; }"
    )


def run_cells(page, last: int, timeout: float = 400.0) -> None:
    """Run the cells 0 .. ``last``, one after the other, and wait for the end; raises on a cell's error."""
    page.evaluate(
        """async last => { const p = window.jupyterapp.shell.currentWidget, c = window.jupyterapp.commands;
          for (let i = 0; i <= last; i++) { p.content.activeCellIndex = i; p.content.deselectAll();
            if (p.content.activeCell.model.type === 'code') await c.execute('notebook:run-cell'); } }""",
        last,
    )
    page.wait_for_function(_IDLE, timeout=1000 * timeout)
    raised = errors(page)
    if raised:
        raise AssertionError("; ".join(raised))


def errors(page) -> list[str]:
    """What the cells of the open notebook have raised, "NameError: ..."."""
    return page.evaluate(_ERRORS)


def run_code(page, code: str) -> str:
    """Run code in the open notebook's kernel, without a cell; returns what it printed, or its error."""
    return page.evaluate(
        """async code => { let out = '';
          const future = window.jupyterapp.shell.currentWidget.sessionContext.session.kernel.requestExecute({code});
          future.onIOPub = message => { const c = message.content;
            out += c.text ?? ''; if (c.ename) out += c.ename + ': ' + c.evalue; };
          await future.done; return out; }""",
        code,
    )


def shut_down(page) -> None:
    """End the open notebook's kernel: the machine belongs to the next one."""
    page.evaluate("async () => window.jupyterapp.shell.currentWidget.sessionContext.shutdown()")


def pictures_per_second(page, seconds: float) -> float:
    """How many pictures of the face the browser decodes a second, while it is left alone."""
    page.evaluate("() => { window.loads.face = []; }")
    page.wait_for_timeout(1000 * seconds)
    times = page.evaluate("() => window.loads.face")
    return 0.0 if len(times) < 2 else (len(times) - 1) / (times[-1] - times[0]) * 1000


def wait_for_text(page, selector: str, text: str, seconds: float) -> None:
    """Wait until an element shows ``text``."""
    page.wait_for_function(
        "([selector, text]) => document.querySelector(selector)?.innerText.includes(text)",
        arg=[selector, text],
        timeout=1000 * seconds,
    )


def notebook_of(*cells: str):
    """A notebook of these code cells."""
    import nbformat

    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
    return notebook


def cell_with(name: str, text: str) -> int:
    """Number of the first code cell of a notebook that contains ``text``."""
    import nbformat

    cells = nbformat.read(NOTEBOOKS / name, 4).cells
    return next(i for i, cell in enumerate(cells) if cell.cell_type == "code" and text in cell.source)


def pixels(locator, attempts: int = 10) -> np.ndarray:
    """(H, W, 3) int: what the browser shows there; again where the page put another element in its place meanwhile."""
    from playwright.sync_api import Error

    for attempt in range(attempts):
        try:
            shown = locator.screenshot()
            break
        except Error as error:
            if "not attached" not in str(error) or attempt == attempts - 1:
                raise
            locator.page.wait_for_timeout(300)
    return np.asarray(Image.open(io.BytesIO(shown)).convert("RGB")).astype(int)


def changed(before: np.ndarray, after: np.ndarray) -> float:
    """Share of pixels that differ clearly."""
    return float((np.abs(before - after).max(axis=2) > 12).mean()) if before.shape == after.shape else 1.0


def drag(page, parameter: str, by: float, steps: int = 10) -> None:
    """Drag the slider of a parameter ("laplacian.w2") with the mouse, ``by`` pixels."""
    handle = page.locator(f".adaptiveface-{parameter.replace('.', '-')} .noUi-handle").first
    _drag_element(page, handle, 0.5, (by, 0.0), steps)


def drag_face(page, face, by: tuple[float, float], steps: int = 12) -> None:
    """Drag on the face itself with the mouse, ``by`` pixels."""
    _drag_element(page, face, 0.25, by, steps)


def drag_line(page, line, down: float) -> None:
    """Drag a horizontal line, ``down`` pixels."""
    _drag_element(page, line, 0.5, (0.0, down), 8)


def _drag_element(page, element, from_left: float, by: tuple[float, float], steps: int) -> None:
    """From a point at this share of the width, at half the height."""
    element.scroll_into_view_if_needed()
    box = element.bounding_box()
    x, y = box["x"] + from_left * box["width"], box["y"] + box["height"] / 2
    page.mouse.move(x, y)
    page.mouse.down()
    for k in range(1, steps + 1):
        page.mouse.move(x + by[0] * k / steps, y + by[1] * k / steps)
        page.wait_for_timeout(25)
    page.mouse.up()


def touch(page, *fingers: tuple, steps: int = 12) -> None:
    """Touch the screen with one or two fingers at once, each from (x, y) to (x, y), and lift them."""
    session = page.context.new_cdp_session(page)

    def send(kind: str, share: float) -> None:
        at = [[a + share * (b - a) for a, b in zip(start, end, strict=True)] for start, end in fingers]
        points = [] if kind == "touchEnd" else [{"x": x, "y": y, "id": k} for k, (x, y) in enumerate(at)]
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    send("touchStart", 0.0)
    for k in range(1, steps + 1):
        send("touchMove", k / steps)
        page.wait_for_timeout(20)
    send("touchEnd", 1.0)
    session.detach()


def wait_until(page, true: Callable[[], bool], seconds: float = 30.0) -> bool:
    """Whether ``true()`` becomes true in this time; it is asked every 150 ms."""
    end = time.monotonic() + seconds
    while not true():
        if time.monotonic() > end:
            return False
        page.wait_for_timeout(150)
    return True


def wait_for_rest(page, seconds: float = 240.0) -> None:
    """Wait until no face has changed for two seconds: what was on its way is drawn, and a playback that goes on never rests."""
    page.wait_for_function(
        """() => { const drawn = window.loads.face.length, now = performance.now();
          if (window.rest?.drawn !== drawn) window.rest = {drawn, since: now};
          return now - window.rest.since > 2000; }""",
        timeout=1000 * seconds,
    )


def wait_for_change(page, locator, before: np.ndarray, least: float = 0.005, seconds: float = 60.0) -> float:
    """Share of pixels that changed, once it exceeds ``least``; 0 when that does not happen."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        share = changed(before, pixels(locator))
        if share > least:
            return share
        page.wait_for_timeout(150)
    return 0.0
