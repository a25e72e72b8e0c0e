"""Look at a built site as a phone and a desktop show it.

    python docs/look_at_site.py docs/_build PICTURES [--chromium /usr/bin/chromium] [--all | PAGE ...]

Writes ``PAGE_390.png`` and ``PAGE_1280.png`` to the folder PICTURES (``--all``: no pictures, every page), and prints what is
wider than the window or cuts off a line of code. Ends with 1 where there is such a thing. Needs the extra ``test``.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from playwright.sync_api import Page, sync_playwright

WIDTHS = (390, 1280)
PAGES = (
    "index",
    "start",
    "audience",
    "gallery",
    "howto/index",
    "howto/stage",
    "programs",
    "programs/unity",
    "teaching",
    "formats",
    "_generated/parameters",
    "_generated/notebooks/02_blendshapes",
    "_generated/notebooks/06_incremental_pca",
    "_generated/api/adaptiveface.geometry.polydata",
)
TOO_WIDE = """() => {
  const found = [];
  const page = document.scrollingElement;
  if (page.scrollWidth > window.innerWidth + 1) found.push(`the page is ${page.scrollWidth} px wide`);
  for (const code of document.querySelectorAll('article pre'))
    if (code.scrollWidth > code.clientWidth + 1) found.push(`cut off: ${code.innerText.slice(0, 60)}`);
  return found;
}"""


def look(page: Page, address: str, width: int, picture: Path | None) -> list[str]:
    """Load a page in a window of a width; returns what does not fit."""
    page.set_viewport_size({"width": width, "height": 900})
    page.goto(address)
    if picture is not None:
        page.screenshot(path=picture, full_page=True)
    return page.evaluate(TOO_WIDE)


def main() -> int:
    """Every chosen page in every width."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("site", type=Path)
    parser.add_argument("pictures", type=Path)
    parser.add_argument("--chromium", default="/usr/bin/chromium")
    parser.add_argument("--all", action="store_true", help="every page, without pictures")
    parser.add_argument("pages", nargs="*", default=PAGES)
    args = parser.parse_args()
    site = args.site.resolve()
    names = [str(p.relative_to(site).with_suffix("")) for p in sorted(site.rglob("*.html"))] if args.all else args.pages
    args.pictures.mkdir(parents=True, exist_ok=True)
    faults = 0
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=args.chromium, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page()
        for name in names:
            for width in WIDTHS:
                picture = None if args.all else args.pictures / f"{name.replace('/', '-')}_{width}.png"
                for fault in look(page, (site / f"{name}.html").as_uri(), width, picture):
                    faults += 1
                    print(f"{name} at {width}: {fault}")
        browser.close()
    print(f"{len(names)} pages in {len(WIDTHS)} widths, {faults} faults")
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
