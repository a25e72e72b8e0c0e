"""Records: one declaration per array makes checking, reading, writing, the docstring and the docs."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pytest

from adaptiveface.errors import FileFormatError
from adaptiveface.files import records
from adaptiveface.files.npz import write_npz
from adaptiveface.files.records import array, arrays, part, read, record
from adaptiveface.importers.flame import FlameFile
from adaptiveface.importers.gnm import GnmFile
from adaptiveface.model.actor import Actor
from adaptiveface.model.face_model import FaceModel, embedded_face_model, load_face_model, save_face_model
from adaptiveface.model.feature_set import FeatureSet
from adaptiveface.result import Result
from adaptiveface.retargeting.character import CharacterFile


@record
@dataclass(frozen=True)
class Marks:
    """L marks."""

    where: np.ndarray = array("L", "i4", "vertex", below="N")
    size: np.ndarray = array("L", doc="radius", unit="mm")


@record
@dataclass(frozen=True)
class Sheet:
    """A mesh."""

    points: np.ndarray = array("N 3", doc="corners", unit="mm")
    names: tuple[str, ...] = array("K", "U", "of something")
    flat: bool = array("", "b", "no height", optional=True, default=False)
    count: int = array("", "i4", "of something", optional=True, default=2)
    turn: np.ndarray = array("N", "i1", "state", name="old_turn", optional=True, default=None)
    marks: Marks | None = part(Marks, "mark_")


SHEET = Sheet(np.eye(3), ("a", "b"), True, 5, np.zeros(3, np.int8), Marks(np.array([2, 0]), np.ones(2)))


def test_a_record_comes_back_as_it_was_written(tmp_path):
    write_npz(tmp_path / "a.npz", arrays(SHEET))
    with np.load(tmp_path / "a.npz") as stored:
        assert set(stored) == {"points", "names", "flat", "count", "old_turn", "mark_where", "mark_size"}
        assert stored["points"].dtype == np.float32 and stored["mark_size"].dtype == np.float32
        assert stored["count"].dtype == np.int32, "a single integer has the declared type, too"
    data = read(Sheet, tmp_path / "a.npz", double=True)
    assert (data["names"], data["flat"], data["count"]) == (("a", "b"), True, 5) and data["points"].dtype == float
    assert data["marks"]["where"].tolist() == [2, 0] and data["turn"].tolist() == [0, 0, 0]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (dict(points=None), "'points' is missing"),
        (dict(old_turn=np.zeros(2, np.int8)), "'old_turn' has shape"),
        (dict(mark_size=None), "'mark_size' is missing beside 'mark_where'"),
        (dict(mark_where=np.array([3, 0])), "'mark_where' points outside 0..2"),
        (dict(mark_size=np.array([1.0, np.nan])), "'mark_size' holds NaN"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, change, words):
    known = arrays(SHEET) | change
    write_npz(tmp_path / "a.npz", {name: value for name, value in known.items() if value is not None})
    with pytest.raises(FileFormatError, match=words):
        read(Sheet, tmp_path / "a.npz")


def test_what_is_optional_may_be_missing(tmp_path):
    write_npz(tmp_path / "a.npz", dict(points=np.eye(3), names=np.array(["a"])))
    sheet = Sheet(**read(Sheet, tmp_path / "a.npz"))
    assert (sheet.flat, sheet.count, sheet.turn, sheet.marks) == (False, 2, None, None)


def test_the_docstring_has_every_array():
    assert "points : (N, 3)\n        Corners, mm." in Sheet.__doc__ and "flat : () bool" in Sheet.__doc__


@pytest.mark.parametrize("cls", [Actor, FaceModel, FeatureSet, Result, CharacterFile, FlameFile, GnmFile])
def test_every_array_of_the_records_is_declared_with_a_meaning(cls):
    known = dict(records.declared(cls)) | dict(records.parts(cls))
    assert {entry.name for entry in fields(cls)} - set(known) <= {"name", "landmarks"}
    assert all(entry.doc for _, entry in records.declared(cls))


def test_a_face_model_comes_back(tmp_path):
    model = embedded_face_model()
    save_face_model(tmp_path / "m.npz", model)
    again = load_face_model(tmp_path / "m.npz")
    assert again.expression_names == model.expression_names and again.triangles.dtype == np.int32
    np.testing.assert_allclose(again.eye_modes, model.eye_modes, atol=1e-5)
