"""A head that the live notebook's button saved opens in other notebooks, typed in and run from the menu.

All ten, in full length and with pictures: ``python tests/browser/sources.py``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
pytest.importorskip("jupyterlab", reason="the extra 'notebooks' is not installed")
pytest.importorskip("playwright", reason="playwright is not installed")

import lab  # noqa: E402
import sources  # noqa: E402

if lab.CHROMIUM is None:
    pytest.skip("no chromium found (Debian: apt install chromium; or set CHROMIUM to its path)", allow_module_level=True)

NOTEBOOKS = ("02_blendshapes.ipynb", "05_laplacian_deformation.ipynb")


@pytest.mark.slow
def test_a_head_saved_by_the_live_notebooks_button_opens_in_others(tmp_path):
    quick = {"ADAPTIVEFACE_NOTEBOOK_FAST": "1", "ADAPTIVEFACE_SENSOR": "synthetic"}
    with lab.jupyter_lab(tmp_path, (sources.LIVE, *NOTEBOOKS), **quick) as address, lab.chromium_page() as page:
        sources.save_head(page, address)
        assert (tmp_path / sources.SAVED).stat().st_size > 100_000
        for name in NOTEBOOKS:
            said = sources.open_with(page, address, name, SOURCE=sources.PERFORMER, ACTOR=sources.SAVED)
            assert said.strip().endswith(f"The head is {sources.SAVED}."), "of this performer, and not another person's"
            face = page.locator(".adaptiveface-face").first
            face.scroll_into_view_if_needed()
            assert lab.pixels(face).std() > 15
            assert lab.errors(page) == []
            lab.shut_down(page)
        assert page.problems == []
