"""Check a built site: ``python docs/check_site.py docs/_build``. Links and anchors inside it lead somewhere; pages are small.

No network: addresses of other sites are not asked for. A page's size is its HTML and the pictures that it shows.
"""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

#: Bytes of a page with its pictures.
LARGEST = 1_500_000


@dataclass
class Page(HTMLParser):
    """What a page names: ``ids`` that links may lead to, ``links`` and ``pictures``."""

    path: Path
    ids: set[str] = field(default_factory=set)
    links: set[str] = field(default_factory=set)
    pictures: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()
        self.feed(self.path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Collect; called by the parser."""
        values = {name: value or "" for name, value in attrs}
        self.ids |= {values[name] for name in ("id", "name") if name in values}
        if tag in ("a", "link") and "href" in values:
            self.links.add(values["href"])
        if tag in ("img", "script", "source") and "src" in values:
            self.links.add(values["src"])
            self.pictures |= {values["src"]} if tag == "img" else set()

    def target(self, link: str) -> tuple[Path, str] | None:
        """The file and the anchor that a link leads to; None for other sites."""
        parts = urlsplit(link)
        if parts.scheme or parts.netloc:
            return None
        path = self.path if not parts.path else self.path.parent / unquote(parts.path)
        return Path(os.path.abspath(path)), unquote(parts.fragment)

    def size(self) -> int:
        """Bytes of the page and of its pictures."""
        shown = [self.target(picture) for picture in self.pictures]
        return self.path.stat().st_size + sum(t[0].stat().st_size for t in shown if t and t[0].is_file())


def read(site: Path) -> dict[Path, Page]:
    """Every page of a site by its path."""
    return {Path(os.path.abspath(path)): Page(path) for path in sorted(site.rglob("*.html"))}


def faults(site: Path, largest: int = LARGEST, pages: dict[Path, Page] | None = None) -> list[str]:
    """One line per broken link, lost anchor and page that is too large; ``pages`` where they were read already."""
    pages = read(site) if pages is None else pages
    there: dict[Path, bool] = {}
    found = []
    for path, page in pages.items():
        name = path.relative_to(os.path.abspath(site))
        for link in sorted(page.links):
            if (target := page.target(link)) is None:
                continue
            file, anchor = target
            if not there.setdefault(file, file.exists()):
                found.append(f"{name}: {link}: no such file")
            elif anchor and file in pages and anchor not in pages[file].ids:
                found.append(f"{name}: {link}: no such anchor")
        if (size := page.size()) > largest:
            found.append(f"{name}: {size / 1e6:.2f} MB with its pictures, more than {largest / 1e6:.2f}")
    return found


def main() -> int:
    """Print the faults and the largest pages; 1 where there are faults."""
    site = Path(sys.argv[1])
    pages = read(site)
    found = faults(site, LARGEST, pages)
    print(*found, sep="\n", end="\n" if found else "")
    print(f"{len(pages)} pages, {len(found)} faults; the largest:")
    for size, path in sorted(((page.size(), page.path.relative_to(site)) for page in pages.values()), reverse=True)[:5]:
        print(f"  {size / 1e6:.2f} MB  {path}")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
