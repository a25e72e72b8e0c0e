"""A head that is no person's is refused, a doubtful one is said, and the neutral is taken from calm frames."""

from __future__ import annotations

import dataclasses
import json
import logging
from pathlib import Path

import numpy as np
import pytest
from recordings import edit_intrinsics, talking_head
from scenes import coefficients, exact_actor, head_pose, posed_shape, render_frame

from adaptiveface.cli import main
from adaptiveface.errors import TrackingError
from adaptiveface.geometry.expression_names import SCORE_NAMES
from adaptiveface.geometry.frame import LANDMARKS, DetectedFace, Features2D, RgbdFrame
from adaptiveface.geometry.mesh import surface_points
from adaptiveface.model.actor import Actor
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.neutral.choice import WORDS, Judged, choose, costs, doubts, judge
from adaptiveface.neutral.plausible import ImplausibleFaceError, SizeWatch, check_identity, face_size, likely_unit
from adaptiveface.neutral.take import neutral_of
from adaptiveface.pipeline import FrameReader, capture_source, track_source
from adaptiveface.report import write_report
from adaptiveface.result import Result
from adaptiveface.sensors import Recording, RecordingWriter, open_source
from adaptiveface.synthetic.performer import Performer
from adaptiveface.synthetic.sensor import SyntheticSensor
from adaptiveface.tracking import verdict as verdicts
from adaptiveface.tracking.verdict import verdict

PEOPLE = Path(__file__).resolve().parents[2] / "shared" / "recordings" / "people"


def linked(folder: Path, source: Path, factor: float) -> Path:
    """The recording ``source`` with a depth_scale that makes everything ``factor`` times as large."""
    folder.mkdir()
    for name in ("color", "depth", "features.csv"):
        if (source / name).exists():
            (folder / name).symlink_to(source / name)
    content = json.loads((source / "intrinsic.json").read_text())
    (folder / "intrinsic.json").write_text(json.dumps(content | {"depth_scale": content["depth_scale"] / factor}))
    return folder


def person(name: str) -> Path:
    folder = PEOPLE / name
    if not folder.is_dir():
        pytest.skip(f"the recording is not at {folder}")
    return folder


# ---- the unit of depth -----------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def synthetic(tmp_path_factory) -> Path:
    """A short recording of a synthetic performer: 12 neutral frames, 6 of expressions."""
    sensor = SyntheticSensor(1005, "none", neutral_frames=12, frames=6, repeats=1, colour=False)
    folder = tmp_path_factory.mktemp("synthetic") / "take"
    with RecordingWriter(folder, sensor.camera, depth_scale=1000) as writer:
        for frame in sensor:
            writer.write(frame)
    return folder


@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 5.0, 10.0])
def test_a_wrong_unit_is_refused_with_the_likely_one(synthetic, tmp_path, capsys, factor):
    folder = linked(tmp_path / "wrong", synthetic, factor)
    assert main(["track", str(folder), "--out", str(tmp_path / "r.npz")]) == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1 and not (tmp_path / "r.npz").exists()
    if factor > 0.15:  # nearer than 100 mm nothing is taken for a measurement
        assert f"depth_scale = {1000 / factor:g} in {folder / 'intrinsic.json'} is wrong, 1000 is likely" in message
    else:
        assert f"depth_scale {1000 / factor:g}" in message


@pytest.mark.parametrize(("factor", "kind"), [(1.25, "very large"), (0.8, "child's"), (0.75, "child's")])
def test_a_doubtful_size_is_said_once(synthetic, tmp_path, caplog, factor, kind):
    capture_source(Recording(linked(tmp_path / "odd", synthetic, factor)), neutral_frames=12)
    (said,) = [record.getMessage() for record in caplog.records]
    assert kind in said and "1000 is likely" in said and "mm wide" in said and "odd: " in said


def test_the_right_unit_says_nothing(synthetic, caplog):
    capture_source(Recording(synthetic), neutral_frames=12)
    assert not caplog.records


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_an_actor_of_another_size_is_refused(synthetic, tmp_path, factor, capsys):
    capture_source(Recording(synthetic), neutral_frames=12).save(tmp_path / "actor.npz")
    folder = linked(tmp_path / "wrong", synthetic, factor)
    arguments = ["--actor", str(tmp_path / "actor.npz"), "--out", str(tmp_path / "r.npz")]
    assert main(["track", str(folder), *arguments]) == 2
    message = capsys.readouterr().err
    assert "times as large as the actor's" in message and "1000 is likely" in message and message.count("\n") == 1
    folder = linked(tmp_path / "odd", synthetic, 1.0 + 0.2 * (factor - 1))
    main(["track", str(folder), *arguments])
    assert ("1000 is likely" in capsys.readouterr().err) == (factor > 1)  # 1.2 is said, 0.9 is not


@pytest.mark.parametrize(("seed", "scale"), [(3, 0.75), (1000, 0.85), (1001, 1.15)])
def test_children_and_large_heads_are_captured(seed, scale, monkeypatch):
    """Heads that differ from the average one by themselves, made smaller and larger."""
    performer = Performer(seed)
    monkeypatch.setattr(performer, "surface", lambda x, original=performer.surface: scale * original(x))
    sensor = SyntheticSensor(seed, neutral_frames=8, frames=1, repeats=1, colour=False, performer=performer)
    size = face_size(embedded_face_model(), capture_source(sensor, neutral_frames=8).neutral)[0]
    plain = face_size(embedded_face_model(), performer.neutral)[0]
    assert size == pytest.approx(scale * plain, rel=0.08)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kinect2_ir_1", "kinect2_ir_2", "kinect2_ir_3"])
@pytest.mark.parametrize("factor", [0.5, 1.0, 2.0, 10.0])
def test_people(detector, tmp_path, name, factor):
    recording = Recording(linked(tmp_path / name, person(name), factor))
    if factor == 1.0:
        capture_source(recording, neutral_frames=9, detector=detector)
        return
    with pytest.raises(ImplausibleFaceError, match="1000 is likely"):
        capture_source(recording, neutral_frames=9, detector=detector)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_the_mannequin(mannequin, detector, tmp_path, factor):
    with pytest.raises(ImplausibleFaceError, match="8000 is likely"):
        capture_source(Recording(linked(tmp_path / "m", mannequin, factor)), neutral_frames=12, detector=detector)


def test_a_source_without_a_unit_of_its_own(caplog):
    class Phone:
        name, depth_scale = "phone", 10_000.0

    assert "depth_scale" not in likely_unit(Phone, 2.0) and "focal length" in likely_unit(Phone, 2.0)
    assert likely_unit(None, 1.0) == likely_unit(Phone, float("nan")) == ""


@pytest.mark.parametrize("identity", [np.full(40, 3.5), np.eye(40)[3] * 12, -np.eye(40)[0] * 11])
def test_coefficients_that_nobody_has(identity):
    with pytest.raises(ImplausibleFaceError, match="unlike any person's"):
        check_identity(identity)
    check_identity(np.full(40, 2.0))
    check_identity(np.eye(40)[3] * 7)


def test_features_that_show_no_face_are_refused_without_depth_too():
    """Colour only: features of a frame turned upside down, which no head explains."""
    sensor = SyntheticSensor(2, neutral_frames=6, frames=1, repeats=1, colour=False)

    class Video:
        name, colour_only, camera, has_features = "video", True, sensor.camera, True

        def __len__(self):
            return 6

        def read(self, index):
            frame = sensor.read(index)
            squashed = (frame.features.pixels - frame.features.pixels[30]) * [1.0, 3.0] + frame.features.pixels[30]
            features = Features2D(squashed, frame.features.confidence)
            return dataclasses.replace(frame, depth=np.zeros_like(frame.depth), features=features)

    with pytest.raises(TrackingError, match="unlike any person's|no face"):
        capture_source(Video(), neutral_frames=6)


# ---- which frames are the neutral ------------------------------------------------------------------------------------
CALM = Judged(5.0, 0.9, 0.1, (0.3, 0.5, 0.4))
ASIDE, TALKING, SMILING = (
    dataclasses.replace(CALM, **change) for change in (dict(angle=60.0, seen=0.1), dict(mouth=1.5), dict(rest=(1.6, 0.5, 0.4)))
)
#: As most frames of a take may be: only the detector's scores tell.
GRINNING = dataclasses.replace(CALM, expression=2.5)


@pytest.mark.parametrize(
    ("faces", "picked", "words"),
    [
        ([CALM] * 30, range(10), ""),
        ([CALM] * 9 + [TALKING] + [CALM] * 20, range(10), ""),  # a moment is no harm
        ([ASIDE] * 12 + [CALM] * 18, range(12, 22), "hardly seen"),
        ([TALKING] * 12 + [CALM] * 18, range(12, 22), "with an open mouth in 10"),
        ([SMILING] * 5 + [CALM] * 20, range(5, 15), "moving in 5"),
        ([GRINNING] * 40 + [CALM] * 10, range(40, 50), "smiling or the like in 10"),
        ([GRINNING] * 30, range(10), "doubtful"),
        ([None] * 10 + [CALM] * 10, range(10, 20), "turned away"),
        ([TALKING] * 30, range(10), "doubtful"),
        ([ASIDE] * 30, range(10), "doubtful"),
        ([TALKING] * 8 + [CALM] * 4, range(8, 12), "open mouth"),
        ([CALM], range(1), ""),
        ([], range(0), ""),
        ([TALKING], range(1), "doubtful"),
    ],
)
def test_calm_frames_are_chosen(faces, picked, words):
    choice = choose(faces, 10)
    assert choice.picked == list(picked) and words in choice.note and bool(words) == bool(choice.note)


def test_doubts_of_named_frames():
    assert doubts([CALM] * 9 + [TALKING]) == "" and "open mouth" in doubts([TALKING] * 5 + [CALM] * 5)
    assert doubts([ASIDE] * 10, turned=False) == "" and doubts([ASIDE] * 10) and doubts([]) == ""


def head(angle: float, jaw: float, index: int):
    actor = exact_actor()
    return render_frame(actor, posed_shape(actor, coefficients(actor, jawOpen=jaw)), head_pose((0.0, angle, 0.0)), index)


def scored(frame: RgbdFrame, smile: float) -> RgbdFrame:
    """The frame as a detector sees it that gives it such a score for smiling."""
    face = DetectedFace(np.zeros((LANDMARKS, 3)), np.where(np.char.startswith(SCORE_NAMES, "mouthSmile"), smile, 0.0))
    return dataclasses.replace(frame, features=dataclasses.replace(frame.features, face=face))


def test_a_smile_is_told_by_the_detector():
    model = embedded_face_model()
    points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    calm = head(0.0, 0.0, 0)
    costs_of = [costs([judge(frame, points)])[0] for frame in (calm, scored(calm, 0.1), scored(calm, 0.8))]
    assert (
        costs_of[0].max() < 1 and costs_of[1].max() < 1 <= costs_of[2].max() == costs_of[2][WORDS.index("smiling or the like")]
    )


class Take:
    """Turned or talking frames first, then calm ones."""

    name, has_features = "take", True

    def __init__(self, first, calm=12):
        self.frames = [*first, *(head(0.05 * (k % 3), 0.0, len(first) + k) for k in range(calm))]
        self.camera = self.frames[0].camera

    def __len__(self):
        return len(self.frames)

    def read(self, index):
        return self.frames[index]


@pytest.fixture(scope="module")
def profile_first() -> Take:
    return Take([head(0.9 + 0.02 * k, 0.0, k) for k in range(10)])


@pytest.fixture(scope="module")
def talking_first() -> Take:
    return Take([head(0.0, 0.5, k) for k in range(10)])


@pytest.mark.parametrize("name", ["profile_first", "talking_first"])
@pytest.mark.parametrize("count", [5, 10])
def test_a_take_that_begins_badly(name, count, request, caplog):
    takes = []
    capture_source(request.getfixturevalue(name), neutral_frames=count, on_take=takes.append)
    (take,) = takes
    assert not take.leading and min(frame.index for frame in take.frames) >= 10 and len(take.frames) == count
    (said,) = [record.getMessage() for record in caplog.records]
    assert "take: of the first" in said and "--neutral-frames" in said
    assert "open mouth" in said if name == "talking_first" else "turned away" in said or "hardly seen" in said


def test_named_frames_are_taken_as_they_are(talking_first, caplog):
    model = embedded_face_model()
    points = surface_points(model.mean, model.feature_triangles, model.feature_weights)
    with FrameReader(talking_first) as reader:
        take = neutral_of(reader, range(2, 7), points, 150)
        assert [frame.index for frame in take.frames] == [2, 3, 4, 5, 6] and "open mouth" in take.note
        take = neutral_of(reader, range(12, 90), points, 150)
        assert [frame.index for frame in take.frames] == list(range(12, 22)) and take.note == ""
        everything = neutral_of(reader, None, points, 150)
        assert [frame.index for frame in everything.frames] == list(range(10, 22)) and "left out" in everything.note


def test_neutral_frames_on_the_command_line(tmp_path, capsys):
    talking_head(tmp_path / "take", 8)
    out = str(tmp_path / "actor.npz")
    assert main(["capture", str(tmp_path / "take"), "--out", out, "--neutral-frames", "0:1"]) == 0
    assert capsys.readouterr().err == ""
    assert Actor.load(out).neutral.shape[1] == 3
    for text in ("3:3", "5:2", "a:b", "-1:4", "0", "1:2:3", "3:"):
        with pytest.raises(SystemExit):
            main(["capture", str(tmp_path / "take"), "--out", out, f"--neutral-frames={text}"])
        assert capsys.readouterr().err.count("\n") == 1
    assert main(["capture", str(tmp_path / "take"), "--out", out, "--neutral-frames", "50:60"]) == 2
    assert "no face found" in capsys.readouterr().err


def test_the_demo_takes_its_leading_frames(caplog):
    """Neutral scans as they should be are taken as before: the first frames, all of them, in order."""
    for seed in (0, 1006):
        sensor, takes = SyntheticSensor(seed, neutral_frames=10, frames=3, repeats=1, colour=False), []
        capture_source(sensor, neutral_frames=10, on_take=takes.append)
        assert takes[0].leading and [frame.index for frame in takes[0].frames] == list(range(10))
    assert not caplog.records


def test_the_mannequin_starts_in_profile(mannequin, detector, caplog):
    takes = []
    actor = capture_source(Recording(mannequin), neutral_frames=16, detector=detector, on_take=takes.append)
    assert not takes[0].leading and 25 <= takes[0].frames[0].index and takes[0].frames[-1].index <= 80
    assert len([record for record in caplog.records if "instead" in record.getMessage()]) == 1
    result = track_source(Recording(mannequin), actor, detector=detector)
    print(f"{result.tracked.sum()} of {len(result)} frames tracked")
    assert result.tracked.sum() >= 83


def test_someone_who_smiles_throughout(detector, caplog):
    path = PEOPLE / "webcam" / "smiles_throughout.mp4"
    if not path.is_file():
        pytest.skip(f"the video is not at {path}")
    takes = []
    capture_source(open_source(str(path)), neutral_frames=20, detector=detector, on_take=takes.append)
    chosen = [frame.index for frame in takes[0].frames]
    assert chosen[0] < 20 and chosen[-1] > 130  # frames from all over it, since none need be neutral
    assert not any("open mouth" in record.getMessage() for record in caplog.records)


# ---- what is said first ----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("kept", "lost", "faceless", "words"),
    [
        (80, 20, 0, ""),
        (79, 21, 0, "only 79 of the 100 frames with a face are tracked (79%)"),
        (24, 50, 7, "only 24 of the 74 frames with a face are tracked (32%)"),
        (10, 0, 90, ""),
        (0, 5, 0, "only 0 of the 5"),
        (0, 0, 5, ""),
        (0, 0, 0, ""),
    ],
)
def test_under_80_per_cent_is_said(kept, lost, faceless, words):
    reasons = [""] * kept + [verdicts.MISFIT] * lost + [verdicts.NO_FACE] * faceless
    text = verdict([not reason for reason in reasons], [False] * len(reasons), reasons)
    assert words in text and bool(words) == bool(text) and "\n" not in text
    assert not text or ("--neutral-frames" in text and verdicts.MISFIT in text)


def test_broken_frames_are_no_faces():
    assert verdict([True, False, False], [False, True, True], ["", "a.png: missing", "b.png: missing"]) == ""


@pytest.fixture(scope="module")
def poorly_tracked(tmp_path_factory):
    """A result of frames of which most show another face than the actor: its depth lies somewhere else."""
    folder = tmp_path_factory.mktemp("poor")
    actor = talking_head(folder / "take", 10)
    frames = [Recording(folder / "take").read(k) for k in range(10)]
    for k in range(3, 10):
        lumps = 60.0 * np.sin(np.arange(320) / 9.0)[None] * (frames[k].depth > 0)
        frames[k] = dataclasses.replace(frames[k], depth=(frames[k].depth + lumps).astype(np.float32))

    class Source(Take):
        def __init__(self):
            self.frames, self.camera, self.timestamps = frames, frames[0].camera, np.arange(10) / 30

    return actor, Source(), folder


def test_command_report_and_notebook_say_it_first(poorly_tracked):
    actor, source, folder = poorly_tracked
    result = track_source(source, actor)
    assert not result.tracked[4:].any() and result.tracked[:3].all()
    first = result.summary().splitlines()[0]
    assert first.startswith("only ") and "frames with a face are tracked" in first
    assert "with a face that was not tracked" in result.summary()
    result.save(folder / "r.npz")
    page = write_report(Result.load(folder / "r.npz"), source, actor, folder / "report").read_text()
    body = page[page.index("<h1>") :]
    assert body.index("nly ") < body.index("frames tracked") and "frames with a face are tracked" in body


def test_a_frame_is_lost_for_a_reason_that_is_named():
    frame, actor = head(0.0, 0.0, 0), exact_actor()
    points = surface_points(actor.neutral, actor.feature_triangles, actor.feature_weights)
    change = dataclasses.replace
    assert verdicts.why_lost(change(frame, depth=np.zeros_like(frame.depth)), points) == verdicts.NO_DEPTH
    assert verdicts.why_lost(change(frame, features=None), points) == verdicts.NO_FACE
    assert verdicts.why_lost(change(frame, depth=2 * frame.depth), points) == verdicts.WRONG_SIZE
    assert verdicts.why_lost(frame, points) == verdicts.MISFIT
    faint = Features2D(frame.features.pixels, 0.02 * frame.features.confidence)
    assert verdicts.why_lost(change(frame, features=faint), points) == verdicts.TURNED
    far = np.where(np.arange(frame.depth.shape[0])[:, None] < 20, frame.depth + 900, 0).astype(np.float32)
    assert verdicts.why_lost(change(frame, depth=far), points) == verdicts.BARE


def test_notes_are_printed_once(tmp_path, capsys):
    talking_head(tmp_path / "take", 3)
    edit_intrinsics(tmp_path / "take", fps=None)
    out = str(tmp_path / "actor.npz")
    assert main(["capture", str(tmp_path / "take"), "--out", out, "--neutral-frames", "0:1"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == len(set(lines)) == 1 and lines[0].startswith("adaptiveface: note: ")
    assert not logging.getLogger("adaptiveface").handlers


def test_the_watch_says_nothing_of_the_same_person(synthetic, caplog):
    recording = Recording(synthetic)
    watch = SizeWatch(recording, capture_source(recording, neutral_frames=12))
    for frame in recording:
        watch.see(frame)
    watch.judge()
    assert not caplog.records
