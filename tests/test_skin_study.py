"""Notebook 05's pictures of dense skin: what the colours move, what samples and patches know."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from adaptiveface import views
from adaptiveface.errors import AdaptiveFaceError
from adaptiveface.studies import skin
from adaptiveface.views import skin_study


@pytest.fixture(scope="module")
def session(tmp_path_factory):
    source = "synthetic:7:truedepth:skin=freckled"
    return views.load_session(source, neutral_frames=6, frames=8, cache=tmp_path_factory.mktemp("views"))


def test_samples_know_one_direction_and_patches_more(session):
    shown = skin.track_skin(session, 3)
    assert shown.frame.index == session.frames[3].index
    low, high = np.linalg.eigvalsh(shown.information()).T
    patch_low, patch_high = np.linalg.eigvalsh(skin.around(shown.pixels(), shown.information())).T
    assert (low >= -1e-9).all() and np.median((low / np.maximum(high, 1e-12))[high > 1e-6]) < 0.05
    assert np.median((patch_low / np.maximum(patch_high, 1e-12))[patch_high > 1e-6]) > 0.05
    assert "%" in skin.aperture(shown)
    for image in (skin_study.ellipses(shown), skin_study.on_and_off(session, views.Measures(session), shown)):
        assert image.data[:4] == b"\x89PNG" and image.alt


def test_a_performance_without_colour_says_so(session):
    grey = [replace(frame, colour=None) for frame in session.neutral]
    plain = views.Session(session.name, session.camera, grey, session.frames, session.fps)
    plain._actor = session.actor
    with pytest.raises(AdaptiveFaceError, match="no colour"):
        skin.track_skin(plain, 0)
