"""The notebooks as a user turns them to another source or a saved head: typed into the first cell, run from the menu.

    python tests/browser/sources.py [--source TAKE] [--actor FILE] [--pictures FOLDER] [00 05 ...]

Without ``--source`` and ``--actor`` the live notebook scans its synthetic performer, saves the head, and all others open it.
Prints what the first cell says, and the errors; ``--pictures``: every view of every notebook, for looking at.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import lab

LIVE = "live_sensor.ipynb"
#: The performer whom the live notebook's "synthetic" sensor films.
PERFORMER = "synthetic:0"
SAVED = "actor.npz"
#: Whether a cell was run and none waits or runs: in between cells the kernel is idle, too.
_RUN = """() => { const prompts = [...document.querySelectorAll('.jp-InputPrompt')].map(p => p.innerText);
  return prompts.some(p => /\\d/.test(p)) && !prompts.some(p => p.includes('*')); }"""
_SHOWN = ".jp-OutputArea-output:has(canvas, img, .jupyter-widgets)"


def save_head(page, address: str) -> str:
    """Scan and save a head in the live notebook, by its buttons; returns what the view says of it."""
    lab.open_notebook(page, address, LIVE)
    lab.run_cells(page, lab.cell_with(LIVE, "views.LiveView("))
    lab.wait_for_text(page, ".adaptiveface-live-status", "tracking", 240)
    page.locator("button.adaptiveface-save").click()
    lab.wait_for_text(page, ".adaptiveface-live-view", f"saved {SAVED}", 60)
    page.locator("button.adaptiveface-stop").click()
    said = page.locator(".adaptiveface-live-status").inner_text()
    lab.shut_down(page)
    return said


def open_with(page, address: str, name: str, **lines: str) -> str:
    """Type ``SOURCE = ...`` and ``ACTOR = ...`` into a notebook and run all of it; returns what its first cell prints."""
    lab.open_notebook(page, address, name)
    for variable, value in lines.items():
        page.locator(".jp-CodeCell .cm-line", has_text=f"{variable} = ").first.click()
        page.keyboard.press("Home")
        page.keyboard.press("Shift+End")
        page.keyboard.insert_text(f"{variable} = {value!r}")
    page.locator(".lm-MenuBar-itemLabel", has_text="Run").first.click()
    page.locator(".lm-Menu-itemLabel", has_text="Run All Cells").first.click()
    page.wait_for_function(_RUN, timeout=900_000)
    lab.wait_for_rest(page)
    said = page.locator(".jp-CodeCell").first.locator(".jp-OutputArea-output")
    return "\n".join(text for text in said.all_inner_texts() if text.strip())


def photograph(page, folder: Path, name: str) -> None:
    """Every output that shows something, as ``NUMBER_OUTPUT.png``."""
    folder.mkdir(parents=True, exist_ok=True)
    for k, shown in enumerate(one for one in page.locator(_SHOWN).all() if one.is_visible()):
        shown.scroll_into_view_if_needed()
        page.wait_for_timeout(500)
        shown.screenshot(path=folder / f"{name.partition('_')[0]}_{k}.png")


def main() -> None:
    """Turn the chosen notebooks."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--source", help="a recording or a video")
    parser.add_argument("--actor", help="a saved head")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="every view, in here")
    parser.add_argument("numbers", nargs="*", help="e.g. 00 05; default: all")
    args = parser.parse_args()
    names = sorted(p.name for p in lab.NOTEBOOKS.glob("0*.ipynb") if not args.numbers or p.name[:2] in args.numbers)
    lines = {key: str(value) for key, value in (("SOURCE", args.source), ("ACTOR", args.actor)) if value}
    with tempfile.TemporaryDirectory() as folder, lab.jupyter_lab(Path(folder), [*names, LIVE]) as address:
        if not lines:
            with lab.chromium_page() as page:
                print(save_head(page, address), flush=True)
            lines = {"SOURCE": PERFORMER, "ACTOR": SAVED}
        for name in names:
            with lab.chromium_page() as page:
                said = open_with(page, address, name, **lines)
                if args.pictures:
                    photograph(page, args.pictures, name)
                print(f"== {name}\n{said}\nraised: {lab.errors(page)}; console: {page.problems}", flush=True)
                lab.shut_down(page)


if __name__ == "__main__":
    main()
