"""The paper's figures: what is performed, what is drawn from it, and what is written."""

from __future__ import annotations

import csv
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from matplotlib.figure import Figure
from scenes import exact_actor

from adaptiveface.cli import main
from adaptiveface.cli.studies import PAPER_FIGURES
from adaptiveface.errors import ParameterError
from adaptiveface.geometry.mesh import rotation_vector_matrix
from adaptiveface.studies import EMOTIONS, FIGURES, PARAMETER_SETS, PaperFigure, Take, paper_figure
from adaptiveface.studies import figure as figure_module
from adaptiveface.studies.construction import from_truth
from adaptiveface.studies.convergence import falls
from adaptiveface.studies.drawing import grid, scan_picture
from adaptiveface.studies.out_of_space import Roughness


@pytest.fixture
def drawn():
    figure = Figure(figsize=(2, 2))
    figure.subplots().plot([0, 1])
    return PaperFigure(11, "a title", "a caption", figure, [{"frame": 0, "mm": 0.5}, {"frame": 1, "mm": 0.25}])


def test_a_figure_is_saved_as_png_svg_and_csv_and_twice_alike(drawn, tmp_path):
    paths = drawn.save(tmp_path / "new" / "folder")
    assert [path.name for path in paths] == ["figure_11.png", "figure_11.svg", "figure_11.csv"]
    assert cv2.imread(str(paths[0])).shape[0] == 240
    with open(paths[2], newline="", encoding="utf-8") as stream:
        assert list(csv.DictReader(stream)) == [{"frame": "0", "mm": "0.5"}, {"frame": "1", "mm": "0.25"}]
    first = [path.read_bytes() for path in paths]
    assert first[1].startswith(b"<?xml")
    assert [path.read_bytes() for path in drawn.save(paths[0].parent)] == first


def test_the_command_draws_what_is_asked_for(drawn, tmp_path, monkeypatch, capsys):
    asked = []

    def draw(seed, noise, frames):
        asked.append((seed, noise, frames))
        return drawn.caption, drawn.figure, drawn.rows

    monkeypatch.setattr(figure_module.importlib, "import_module", lambda name, package: SimpleNamespace(draw=draw))
    assert main(["paper", "--figure", "11", "--seed", "7", "--frames", "20", "--out", str(tmp_path)]) == 0
    assert asked == [(7, "structured-light", 20)]
    assert "a caption" in capsys.readouterr().out and (tmp_path / "figure_11.svg").is_file()


def test_there_is_a_module_for_each_figure_and_none_for_others(tmp_path, capsys):
    assert tuple(FIGURES) == PAPER_FIGURES
    for module, title in FIGURES.values():
        found = __import__(f"adaptiveface.studies.{module}", fromlist=["draw"])
        assert callable(found.draw) and title
    with pytest.raises(ParameterError, match="3, 4, 5, 6, 7, 8, 9, 10, 11"):
        paper_figure(2)
    with pytest.raises(SystemExit):
        main(["paper", "--figure", "2", "--out", str(tmp_path)])
    assert main(["paper", "--figure", "6", "--noise", "none at all", "--out", str(tmp_path)]) == 2
    assert "noise" in capsys.readouterr().err


def test_every_action_unit_of_an_emotion_is_one_of_the_model():
    names = {name.removesuffix("Left").removesuffix("Right") for name in exact_model_names()}
    for units in EMOTIONS.values():
        assert set(units) <= names and all(0.0 < level <= 1.0 for level in units.values())
    assert list(PARAMETER_SETS) == ["paper()", "our defaults"]


def exact_model_names():
    from adaptiveface.model.face_model import embedded_face_model

    return embedded_face_model().expression_names


def test_falls_are_peaks_that_drop_soon():
    values = np.full(60, 0.1)
    values[10:14] = [0.5, 0.3, 0.2, 0.15]  # stands out and drops
    values[30:50] = 0.5  # stays
    np.testing.assert_array_equal(falls(values), [10])
    assert len(falls(np.full(20, 0.2))) == 0


def test_roughness_is_zero_for_a_shift_and_grows_with_noise():
    actor = exact_actor()
    rough = Roughness(Take(None, actor))
    shift = np.tile([1.0, 2.0, 3.0], (len(actor.neutral), 1))
    assert rough(shift) < 1e-9
    noise = np.random.default_rng(1).normal(size=shift.shape)
    assert rough(shift + 0.2 * noise) == pytest.approx(0.2 * rough(noise)) and rough(noise) > 1.5


def test_heads_are_measured_where_depth_is_and_rigid_motion_is_no_error():
    actor = exact_actor()
    turned = actor.neutral @ rotation_vector_matrix(np.array([0.0, 0.05, 0.0])).T + [1.0, 2.0, 3.0]
    distance = from_truth(turned, actor.neutral, actor)
    scored = actor.frontal & actor.depth_valid
    assert np.array_equal(np.isfinite(distance), scored) and distance[scored].max() < 1e-3
    grown = from_truth(1.05 * actor.neutral, actor.neutral, actor)
    assert np.nanmedian(grown) > 0.3


def test_a_scan_is_drawn_from_the_front_nearest_points_last():
    actor = exact_actor()
    nose = actor.neutral[actor.frontal].mean(axis=0)
    points = np.array([nose + [0, 0, 50.0], nose + [0, 0, -50.0]])
    normals = np.array([[-0.3, 0.4, 0.87], [0.3, -0.4, -0.87]])  # lit, and turned away
    picture = scan_picture(actor, points, normals, (60, 80))
    background = picture[0, 0]
    drawn = picture[(picture != background).any(axis=2)]
    assert len(drawn) == 9 and (drawn > 140).all()  # of the near one, in the colour of skin


def test_the_grid_has_a_cell_for_each_picture_and_takes_gaps():
    picture = np.zeros((4, 3, 3), np.uint8)
    figure = grid([[picture, None], [picture, picture]], [["a", "lost"], ["c", "d"]], ["one", "two"], 2.0, "mm")
    assert len(figure.axes) == 5
    assert [axis.get_title() for axis in figure.axes[:4]] == ["a", "lost", "c", "d"]
    assert [len(axis.images) for axis in figure.axes[:4]] == [1, 0, 1, 1]
