"""The cases that people report: every row of the table prints the right value."""

from __future__ import annotations

import case_table
import pytest
from export_scene import tracked_result

pytestmark = pytest.mark.skipif(not case_table.CASES.is_dir(), reason=f"no cases at {case_table.CASES}")


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("cases")
    actor, result, _ = tracked_result()
    actor.save(folder / "actor.npz")
    result.save(folder / "result.npz")
    return folder / "result.npz"


@pytest.mark.parametrize("name", case_table.CHARACTERS)
def test_characters(name, result, tmp_path):
    came, good = case_table.character_row(name, result, tmp_path)
    assert good, f"{came} instead of {case_table.CHARACTERS[name]}"


def test_the_video_of_variable_rate_has_its_own_times(tmp_path, detector):
    came, good = case_table.video_row(tmp_path)
    assert good, f"{came} instead of {case_table.VIDEO}"
