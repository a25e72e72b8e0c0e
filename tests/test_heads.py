"""The bundle that draws heads in the browser is the one of its sources, and its licence is there."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

CHECKOUT = Path(__file__).resolve().parents[1]
ASSETS, SOURCES = CHECKOUT / "adaptiveface" / "assets", CHECKOUT / "js"


def test_the_bundle_was_built_from_these_sources():
    """Else: ``npm ci && npm run build`` in ``js``."""
    digest = hashlib.sha256()
    for path in (SOURCES / "package.json", *sorted((SOURCES / "src").glob("*.js"))):
        digest.update(path.read_bytes().replace(b"\r\n", b"\n"))
    banner = (ASSETS / "heads.js").read_text(encoding="utf-8").splitlines()[0]
    assert digest.hexdigest() in banner
    wanted = json.loads((SOURCES / "package.json").read_text())["dependencies"]["three"]
    locked = json.loads((SOURCES / "package-lock.json").read_text())["packages"]["node_modules/three"]["version"]
    assert re.search(r"three.js (\S+), MIT", banner)[1] == wanted == locked


def test_the_licence_of_what_is_bundled_is_there():
    text = (ASSETS / "LICENSE-three.txt").read_text(encoding="utf-8")
    assert "three.js authors" in text and "MIT" in text
    assert "adaptiveface/assets/LICENSE-three.txt" in (CHECKOUT / "pyproject.toml").read_text()
