"""The report: its parts, and that it needs nothing outside itself."""

import base64
import io
import re
from dataclasses import replace
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image
from scenes import CAMERA, coefficients, exact_actor, head_pose, posed_shape, render_frame

from adaptiveface import evaluation as ev
from adaptiveface.errors import AdaptiveFaceError, FrameError, ParameterError
from adaptiveface.evaluation.coefficients import INITIAL, PLAIN, RESOLVED, KnownCoefficients
from adaptiveface.evaluation.run import STAGES
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.geometry.rendering import picture
from adaptiveface.parameters import Parameters
from adaptiveface.report import write_report
from adaptiveface.report.moments import expressive_frames, liveliest_window
from adaptiveface.result import Result
from adaptiveface.retargeting.smoothing import COMPARED
from adaptiveface.tracking.tracker import FaceTracker


class Smiling:
    """Two neutral frames and a smile performed twice; frame 4 cannot be read."""

    name = "a <smiling> head"
    camera = CAMERA

    def __init__(self):
        self.actor = exact_actor()
        self.amounts = [0.0, 0.0, 0.5, 1.0, 0.5, 0.5, 1.0, 0.2]

    def __len__(self):
        return len(self.amounts)

    def head(self, i):
        smile = coefficients(self.actor, mouthSmileLeft=self.amounts[i], jawOpen=0.5 * self.amounts[i])
        return posed_shape(self.actor, smile)

    def pose(self, i):
        return head_pose(rotation=(0.0, 0.01 * i, 0.0))

    def read(self, i):
        if i == 4:
            raise FrameError("depth/00004.png: truncated")
        frame = render_frame(self.actor, self.head(i), self.pose(i), i, noise=0.5, pixel_noise=0.3)
        colour = picture(CAMERA, transform_points(self.pose(i), self.head(i)), self.actor.triangles)
        return type(frame)(frame.depth, CAMERA, colour, i, i / 30, frame.features)

    def ground_truth(self, i):
        performance = -1 if i < 2 else int(i >= 5)
        return ev.TruthFrame(transform_points(self.pose(i), self.head(i)), self.pose(i), performance)


@pytest.fixture(scope="module")
def run():
    source = Smiling()
    tracker = FaceTracker(source.actor)
    frames = []
    for i in range(len(source)):
        frame = source.read(i) if i != 4 else None
        if frame is None:  # as the run loop does: an empty frame stands for the one that cannot be read
            empty = source.read(0)
            frame = type(empty)(np.zeros_like(empty.depth), CAMERA, None, i, i / 30)
        frames.append(tracker.track(frame))
    return source, frames


class Resources(HTMLParser):
    def __init__(self):
        super().__init__()
        self.found, self.tags = [], []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.found += [value for name, value in attrs if name in ("src", "href", "xlink:href", "srcset", "data")]


def test_report_holds_its_parts_and_nothing_from_outside(run, tmp_path):
    source, frames = run
    correctives = np.random.default_rng(0).normal(size=(3 * int(source.actor.frontal.sum()), 2))
    evaluation = ev.evaluate_run(frames, source, source.actor)
    parameters = Parameters().replace(laplacian__w1=0.2)
    path = write_report(
        frames,
        source,
        source.actor,
        tmp_path / "new",
        source,
        evaluation=evaluation,
        correctives=correctives,
        parameters=parameters,
    )
    assert path == tmp_path / "new" / "report.html"
    html = path.read_text(encoding="utf-8")
    for title in (
        "The tracked face",
        "The personal rig",
        "Animation",
        "Retargeting",
        "Learning on the fly",
        "Errors against the truth",
        "Time per stage",
        "Parameters",
    ):
        assert f"<h2>{title}</h2>" in html
    page = Resources()
    page.feed(html)
    assert "http" not in html and "script" not in page.tags and "link" not in page.tags
    assert all(value.startswith(("data:image/webp;base64,", "data:image/png;base64,", "#")) for value in page.found)
    assert html.count('alt="corrective ') == 2
    assert html.count("<svg") == html.count("</svg>") == 5
    assert "a &lt;smiling&gt; head" in html and "<smiling>" not in html
    for name in source.actor.expression_names:
        assert name in html.replace("\u200b", "")
    assert "1 of 8 frames were skipped or lost" in html and "the depth map is empty" in html
    assert re.search(r"<td class=changed>0.2</td>", html) and "1 changed from the default" in html
    repeat = evaluation.summary("v4", ev.REPEAT)
    assert f"<b>{repeat['surface_p95']:.2f} mm</b>" in html


def test_retargeting_section_holds_figures_pictures_and_costs(run, tmp_path):
    source, frames = run
    names = source.actor.expression_names
    truth = np.clip(np.random.default_rng(1).normal(0.2, 0.3, (20, 23)), 0, 1)
    found = {INITIAL: truth + 0.1, PLAIN: truth - 0.12, RESOLVED: truth + 0.05}
    known = KnownCoefficients(names, np.arange(20) / 30, truth, found)
    still = [replace(frame, index=k) for k, frame in enumerate([frames[0]] * 12 + frames)]
    html = write_report(still, None, source.actor, tmp_path, known=known, still_frames=12, character="ogre").read_text()
    start = html.index("<h2>Retargeting</h2>")
    part = html[start : html.index("<h2>", start + 5)]
    assert re.search(r"initial</td><td>0.1000.*plain fit to v4</td><td>0.1200.*re-solved</td><td>0.0500", part)
    assert "is 50% lower" in part and "23 of 23 expressions" in part
    assert part.count("<svg") == 3  # errors by expression, curves against the truth, step responses
    for name, lag in (("none", "0 ms"), *((name, None) for name in COMPARED)):
        row = re.search(rf"<td>{re.escape(name)}</td><td>([\d.]+)</td><td>([^<]+)</td>", part)
        assert row and (lag is None or row[2] == lag), name
    for text in ("initial", "re-solved", "re-solved, with correctives"):
        assert f'alt="ogre: {text}"' in part
    images = [
        np.asarray(Image.open(io.BytesIO(base64.b64decode(data))), int) for data in re.findall(r"webp;base64,([^\"]+)", part)
    ]
    assert len(images) % 4 == 0 and all((image.std(axis=(0, 1)) > 10).all() for image in images)
    assert np.abs(images[1] - images[3]).max() > 20  # initial and with correctives are different pictures


def test_costs_of_smoothing_are_left_out_where_no_still_face_is_known(run, tmp_path):
    html = write_report(run[1], None, run[0].actor, tmp_path).read_text(encoding="utf-8")
    assert "Frames where the two differ" in html
    assert "jitter against lag" not in html and "known coefficients" not in html


def test_pictures_are_images_and_the_preview_moves(run, tmp_path):
    source, frames = run
    html = write_report(frames, source, source.actor, tmp_path).read_text(encoding="utf-8")
    images = [Image.open(io.BytesIO(base64.b64decode(data))) for data in re.findall(r"webp;base64,([^\"]+)", html)]
    moving = [image for image in images if getattr(image, "n_frames", 1) > 1]
    assert len(moving) == 1 and moving[0].width == 900
    assert len(images) > 3 + len(source.actor.expression_names)
    first = np.asarray(moving[0].convert("RGB"), int)
    moving[0].seek(moving[0].n_frames - 1)
    assert np.abs(np.asarray(moving[0].convert("RGB"), int) - first).mean() > 0.2


def test_report_without_source_or_truth(run, tmp_path):
    source, frames = run
    html = write_report(frames, None, source.actor, tmp_path).read_text(encoding="utf-8")
    assert "Errors against the truth" not in html and "The tracked face" not in html
    assert "Time per stage" in html


def test_truth_is_scored_where_no_evaluation_is_given(run, tmp_path):
    source, frames = run
    html = write_report(frames, None, source.actor, tmp_path, source).read_text(encoding="utf-8")
    assert "Errors against the truth" in html
    scored = ev.evaluate_run(frames, source, source.actor, STAGES).summary("v4", ev.REPEAT)
    # v4 passes through float32 here, hence the rounded figures
    row = re.search(r"<td>repeat</td><td>v4</td><td>([\d.]+)</td><td>([\d.]+)</td>", html)
    assert float(row[1]) == pytest.approx(scored["surface_median"], abs=0.006)
    assert float(row[2]) == pytest.approx(scored["surface_p95"], abs=0.006)


def test_report_of_a_saved_result_is_that_of_its_frames(run, tmp_path):
    """Also in the times of stages that a lost frame did not reach: they are unknown, not zero."""
    source, frames = run
    Result.of_frames(frames, source.actor, keep_stages=True).save(tmp_path / "result.npz")
    saved = Result.load(tmp_path / "result.npz")
    assert saved.parameters == Parameters().to_json() and not saved.tracked[4]
    pages = [write_report(given, source, source.actor, tmp_path, source).read_text() for given in (frames, saved)]
    assert pages[0] == pages[1]


def test_a_result_needs_every_frame_of_its_source(run):
    with pytest.raises(ParameterError, match="frame 2 is in place 1"):
        Result.of_frames([run[1][0], *run[1][2:]], run[0].actor)


def test_chosen_frames_are_tracked_and_apart(run):
    result = Result.of_frames(run[1], run[0].actor)
    chosen = expressive_frames(result, 3, spacing=2)
    assert chosen == sorted(chosen) and result.tracked[chosen].all() and min(np.diff(chosen)) >= 2
    assert 3 in chosen or 6 in chosen  # the full smile
    window = liveliest_window(result, 5)
    assert list(window) == [3, 4, 5, 6, 7]  # the smile of the repeat comes and goes there


def test_empty_run_is_refused(run, tmp_path):
    with pytest.raises(AdaptiveFaceError, match="no frame"):
        write_report([], None, run[0].actor, tmp_path)
