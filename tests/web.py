"""Pages in Chromium for tests: packages from npm, a server on this machine, what a page answers."""

from __future__ import annotations

import base64
import functools
import http.server
import importlib.util
import io
import json
import os
import shutil
import subprocess
import threading
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

#: Packages by purpose, each at a version that the tests were made with.
VALIDATOR = "gltf-validator@2.0.0-dev.3.10"
THREE = "three@0.170.0"
THREE_VRM = "@pixiv/three-vrm@3.5.5"
MODEL_VIEWER = "@google/model-viewer@4.1.0"
BABYLON = ("babylonjs@9.28.0", "babylonjs-loaders@9.28.0")


def absent(what: str) -> None:
    """Skip, or fail where the environment promises node, npm and chromium (``.ci/run``)."""
    (pytest.fail if os.environ.get("ADAPTIVEFACE_REQUIRE_NODE") else pytest.skip)(what)


def install(folder: Path, *packages: str) -> Path:
    """``node_modules`` with the packages; skips without node, npm or the package index (in CI: fails)."""
    if not (shutil.which("node") and shutil.which("npm")):
        absent("node and npm are not installed")
    command = [
        "npm",
        "install",
        "--no-audit",
        "--no-fund",
        "--ignore-scripts",
        "--legacy-peer-deps",
        "--prefix",
        str(folder),
    ]
    try:
        subprocess.run([*command, *packages], check=True, capture_output=True, timeout=240)
    except (subprocess.SubprocessError, OSError) as error:
        absent(f"npm cannot fetch {', '.join(packages)}: {str(error)[:120]}")
    return folder / "node_modules"


_VALIDATE = """
const validator = require(process.argv[1]), fs = require('fs'), path = require('path');
(async () => {
  const out = {};
  for (const file of process.argv.slice(2)) {
    const beside = uri => new Uint8Array(fs.readFileSync(path.join(path.dirname(file), decodeURIComponent(uri))));
    out[file] = (await validator.validateBytes(new Uint8Array(fs.readFileSync(file)),
      {maxIssues: 2000, externalResourceFunction: async uri => beside(uri)})).issues.messages;
  }
  console.log(JSON.stringify(out));
})();
"""


def validation(modules: Path, *paths: Path) -> list[list[str]]:
    """For each file the codes of the errors and warnings that the Khronos validator finds."""
    run = subprocess.run(
        ["node", "-e", _VALIDATE, str(modules / "gltf-validator"), *map(str, paths)],
        capture_output=True,
        text=True,
        timeout=180,
        check=True,
    )
    found = json.loads(run.stdout)
    return [sorted(m["code"] for m in found[str(path)] if m["severity"] < 2) for path in paths]


class _Quiet(http.server.SimpleHTTPRequestHandler):
    extensions_map = http.server.SimpleHTTPRequestHandler.extensions_map | {
        ".js": "text/javascript",
        ".mjs": "text/javascript",
        ".wasm": "application/wasm",
    }

    def log_message(self, *_) -> None:
        pass


def ask(folder: Path, modules: Path, page: str, files: dict[str, Path], seconds: int = 120) -> dict:
    """What a page writes as JSON into ``<pre id="out">``; ``files``: name on the server -> file."""
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None or importlib.util.find_spec("playwright") is None:
        absent("chromium or playwright is not installed")
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "page.html").write_text(page)
    for name, path in files.items():
        shutil.copyfile(path, folder / name)
    if not (folder / "node_modules").exists():
        os.symlink(modules, folder / "node_modules")
    handler = functools.partial(_Quiet, directory=str(folder))
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/page.html"
        text = _answer(browser, address, seconds)
        server.shutdown()
    answer = json.loads(text)
    assert "error" not in answer, answer
    return answer


def _answer(browser: str, address: str, seconds: int) -> str:
    from playwright.sync_api import sync_playwright

    flags = [
        "--no-sandbox",
        "--disable-dev-shm-usage",
        "--use-angle=swiftshader",
        "--enable-unsafe-swiftshader",
        "--disable-background-networking",
    ]
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, headless=True, args=flags)
        page = chromium.new_page(viewport={"width": 480, "height": 480})
        said: list[str] = []
        page.on("console", lambda message: said.append(message.text[:200]))
        page.on("pageerror", lambda error: said.append(str(error)[:200]))
        try:
            page.goto(address)
            page.wait_for_selector("#out", state="attached", timeout=1000 * seconds)
            return page.text_content("#out")
        except Exception as error:
            raise AssertionError(f"no answer from the page: {error}; it said {said[-5:]}") from None
        finally:
            chromium.close()


def picture(url: str, path: Path | None = None) -> np.ndarray:
    """(H, W, 3) uint8 of a PNG data URL, on white, saved at ``path`` for people to look at."""
    shown = Image.open(io.BytesIO(base64.b64decode(url.partition(",")[2]))).convert("RGBA")
    image = Image.alpha_composite(Image.new("RGBA", shown.size, "white"), shown).convert("RGB")
    if path is not None:
        image.save(path)
    return np.asarray(image)
