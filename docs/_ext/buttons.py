"""The row under a notebook's title: download, and where the repository is known, Binder and Colab."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
_GITHUB = re.compile(r"https?://github\.com/([\w.-]+/[\w.-]+?)(?:\.git)?/?$")
BRANCH = "main"


def repository(environment: Mapping[str, str], pyproject: str) -> str | None:
    """``OWNER/NAME`` on GitHub, or None: by ``project.urls.Repository``, else by the variables of GitHub's and Read the
    Docs' builds."""
    urls = tomllib.loads(pyproject).get("project", {}).get("urls", {})
    clone = environment.get("READTHEDOCS_GIT_CLONE_URL", "")
    named = environment.get("GITHUB_REPOSITORY", "")
    for address in (urls.get("Repository", ""), f"https://github.com/{named}", clone):
        if found := _GITHUB.match(address):
            return found[1]
    return None


def row(name: str, owner_and_name: str | None, above: str = "../../..") -> str:
    """MyST text of the buttons of ``notebooks/NAME``; ``above``: from its page's folder to the checkout."""
    links = [f"{{download}}`Download <{above}/notebooks/{name}>`"]
    if owner_and_name:
        binder = f"https://mybinder.org/v2/gh/{owner_and_name}/HEAD?urlpath=lab/tree/notebooks/{name}"
        colab = f"https://colab.research.google.com/github/{owner_and_name}/blob/{BRANCH}/notebooks/{name}"
        links += [f"[Run on Binder]({binder})", f"[Open in Colab]({colab})"]
    text = f"```{{container}} buttons\n{' '.join(links)}\n```\n"
    if owner_and_name:
        source = f"adaptiveface[notebooks] @ git+https://github.com/{owner_and_name}"
        text += f'\nIn Colab, run `%pip install "{source}"` first.\n'
    return text
