"""Screenshots of the notebooks for the docs, from JupyterLab in a headless browser.

    python docs/make_screenshots.py [--chromium /usr/bin/chromium] [--whole FOLDER] [--views FOLDER] [00 05 ...]

Needs the extras ``notebooks`` and ``test``. Every notebook is run from top to bottom; the picture shows its first view.
For looking at: ``--whole`` also writes each notebook from top to bottom, in JupyterLab's light and dark theme, and ``--views``
every view of it in windows of two sizes, light and dark (1280 x 720 without the list of files, 1440 x 900 with it).
"""

from __future__ import annotations

import argparse
import io
import socket
import subprocess
import tempfile
import time
import urllib.request
from pathlib import Path

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from adaptiveface.lab import copy_notebooks, lab_command, lab_environment

PICTURES = Path(__file__).parent / "pictures"
FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
IDLE = """() => {
  const context = window.jupyterapp?.shell.currentWidget?.sessionContext;
  return context?.session?.kernel?.status === 'idle';
}"""
FAILED = """() => [...window.jupyterapp.shell.currentWidget.content.model.cells]
  .some(cell => cell.type === 'code' && cell.outputs.toJSON().some(output => output.output_type === 'error'))"""
HEIGHT = "() => document.querySelector('.jp-WindowedPanel-outer').scrollHeight"
UPPER_PART = """view => {
  const outer = document.querySelector('.jp-WindowedPanel-outer');
  outer.scrollBy(0, view.getBoundingClientRect().top - outer.getBoundingClientRect().top - 250);
}"""
SIZE = {"width": 1280, "height": 1150}
WINDOWS = {False: {"width": 1280, "height": 720}, True: {"width": 1440, "height": 900}}  # by whether files are listed
WHOLE = """() => {  // all cells in the page at once: JupyterLab otherwise takes out those that are not in sight
  const { content } = window.jupyterapp.shell.currentWidget;
  content.notebookConfig = { ...content.notebookConfig, windowingMode: 'none' };
}"""
LISTED = "() => !window.jupyterapp.shell.leftCollapsed"
TOP = """view => {
  const outer = document.querySelector('.jp-WindowedPanel-outer');
  outer.scrollBy(0, view.getBoundingClientRect().top - outer.getBoundingClientRect().top - 4);
}"""
OUTPUT = ".jp-OutputArea-output:has(canvas, img, iframe, .jupyter-widgets):not(:has(.adaptiveface-saved, [role=progressbar]))"
VIEW = ".jp-OutputArea-output .jupyter-widgets canvas, .jp-OutputArea-output .jupyter-widgets img, .jp-OutputArea-output img"


def free_port() -> int:
    """A port nobody listens on."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def wait_for(url: str, seconds: float = 60) -> None:
    """Return when the server answers."""
    end = time.monotonic() + seconds
    while True:
        try:
            urllib.request.urlopen(url, timeout=2).close()
            return
        except OSError:
            if time.monotonic() > end:
                raise
            time.sleep(0.3)


def run_all(page: Page, address: str) -> None:
    """Open a notebook, run every cell and wait until the kernel has nothing left to do."""
    page.goto(address)
    page.wait_for_selector(".jp-NotebookPanel .jp-CodeCell", timeout=60_000)
    page.wait_for_function(IDLE, timeout=60_000)
    page.evaluate(WHOLE)
    page.evaluate("() => window.jupyterapp.commands.execute('application:toggle-left-area')")
    page.evaluate("() => window.jupyterapp.commands.execute('notebook:run-all-cells')")
    page.wait_for_timeout(1000)
    page.wait_for_function(IDLE, timeout=240_000)
    if page.locator(".adaptiveface-live-view").count():  # opens its sensor and scans a neutral face first
        tracks = "() => document.querySelector('.adaptiveface-live-figures')?.innerText.includes('latency')"
        page.wait_for_function(tracks, timeout=180_000)
        page.wait_for_timeout(30_000)  # rates are of the last seconds: not of its start
    page.wait_for_timeout(3000)


def photograph(page: Page, path: Path) -> None:
    """The window with the notebook's first view in it."""
    page.evaluate("() => document.querySelector('.jp-WindowedPanel-outer')?.scrollTo(0, 0)")
    views = page.locator(VIEW)
    if views.count():
        views.first.scroll_into_view_if_needed()
        page.wait_for_timeout(500)
        views.first.evaluate(UPPER_PART)  # room below it for the panel and the charts
        page.wait_for_timeout(1500)
    Image.open(io.BytesIO(page.screenshot())).convert("RGB").save(path, quality=82, optimize=True)


def photograph_whole(page: Page, folder: Path, number: str) -> None:
    """The whole notebook as ``NUMBER_light.png`` and ``NUMBER_dark.png``: in a window as high as its cells."""
    folder.mkdir(parents=True, exist_ok=True)
    height = page.evaluate(HEIGHT)
    page.set_viewport_size({**SIZE, "height": min(int(height) + 200, 14_000)})
    for name in ("Dark", "Light"):
        change_theme(page, name)
        page.screenshot(path=folder / f"{number}_{name.lower()}.png")


def change_theme(page: Page, name: str) -> None:
    """JupyterLab in "Light" or "Dark"."""
    page.evaluate(f"() => window.jupyterapp.commands.execute('apputils:change-theme', {{theme: 'JupyterLab {name}'}})")
    page.wait_for_timeout(2500)


def photograph_views(page: Page, folder: Path, number: str) -> None:
    """Every view at the top of the window, as ``NUMBER_VIEW_WIDTH_THEME.png``."""
    folder.mkdir(parents=True, exist_ok=True)
    for listed, size in WINDOWS.items():
        page.set_viewport_size(size)
        if page.evaluate(LISTED) != listed:
            page.evaluate("() => window.jupyterapp.commands.execute('application:toggle-left-area')")
        for theme in ("Dark", "Light"):
            change_theme(page, theme)
            for k, view in enumerate(page.locator(OUTPUT).all()):
                for _ in range(2):  # cells above change their height when they come in sight
                    view.evaluate(TOP)
                    page.wait_for_timeout(700)
                page.screenshot(path=folder / f"{number}_{k}_{size['width']}_{theme.lower()}.png")


def main() -> None:
    """Start JupyterLab on a fresh copy, and photograph the chosen notebooks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    parser.add_argument("--whole", type=Path, metavar="FOLDER", help="also whole notebooks, light and dark, in here")
    parser.add_argument("--views", type=Path, metavar="FOLDER", help="also every view, in two sizes, light and dark, in here")
    parser.add_argument("numbers", nargs="*", help="e.g. 00 05 live; default: all")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        copy_notebooks(Path(folder))
        port, token = free_port(), "screenshots"
        environment = {**lab_environment(Path(folder)), "JUPYTER_TOKEN": token}
        environment |= {"JUPYTER_CONFIG_DIR": f"{folder}/config", "JUPYTERLAB_WORKSPACES_DIR": f"{folder}/workspaces"}
        command = [*lab_command(Path(folder), port, browser=False), "--LabApp.expose_app_in_browser=True"]
        server = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        browser = playwright.chromium.launch(executable_path=args.chromium, headless=True, args=FLAGS)
        try:
            wait_for(f"http://127.0.0.1:{port}/api")
            for path in sorted(Path(folder).glob("*.ipynb")):
                number = path.name.partition("_")[0]
                if args.numbers and number not in args.numbers:
                    continue
                page = browser.new_page(viewport=SIZE)
                run_all(page, f"http://127.0.0.1:{port}/lab/tree/{path.name}?reset&token={token}")
                failed = page.evaluate(FAILED)
                photograph(page, PICTURES / f"notebook_{number}.jpg")
                if args.whole:
                    photograph_whole(page, args.whole, number)
                if args.views:
                    photograph_views(page, args.views, number)
                print(path.name, "a cell raised" if failed else "fine", flush=True)
                page.evaluate("() => window.jupyterapp.shell.currentWidget.sessionContext.shutdown()")
                page.close()
        finally:
            browser.close()
            server.terminate()
            server.wait(30)


if __name__ == "__main__":
    main()
