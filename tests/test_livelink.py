"""Live Link Face: a real take read and written back, signs and axes, broken and unusual files, takes that drive characters."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from written import read_glb_animation

from adaptiveface import cli
from adaptiveface.errors import FileFormatError
from adaptiveface.export.arkit_csv import head_angles, read_arkit_csv, write_arkit_csv
from adaptiveface.geometry.mesh import rotation_vector_matrix
from adaptiveface.livelink import ARKIT_NAMES, LiveLinkTake, read_take, write_take
from adaptiveface.livelink.convention import angles, eye_angles, rotations
from adaptiveface.livelink.take import HEADER
from adaptiveface.livelink.timecode import timecode

REAL = Path(__file__).resolve().parents[2] / "shared/recordings/people/arkit/range_of_motion.csv"
real = pytest.mark.skipif(not REAL.is_file(), reason="the real take is not here")


@pytest.fixture(scope="module")
def take() -> LiveLinkTake:
    return read_take(REAL)


def small_take(frames: int = 90, fps: float = 30.0, start: float = 47_584.5) -> LiveLinkTake:
    rng = np.random.default_rng(0)
    curves = rng.uniform(0, 1.003, (frames, 52))
    head = rng.uniform(-0.5, 0.5, (frames, 3))
    return LiveLinkTake(start + np.arange(frames) / fps, curves, head, eye_angles(curves), np.ones(frames, bool))


def assert_same(a: LiveLinkTake, b: LiveLinkTake, tolerance: float = 1e-6) -> None:
    for name in ("timestamps", "curves", "head", "eyes"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=tolerance, err_msg=name)
    np.testing.assert_array_equal(a.tracked, b.tracked)


# ---- the real take ----


@real
def test_real_take_comes_back_as_it_was(take, tmp_path):
    write_take(tmp_path / "again.csv", take)
    assert_same(take, read_take(tmp_path / "again.csv"))
    write_arkit_csv(tmp_path / "performance.csv", read_arkit_csv(REAL))
    assert_same(take, read_take(tmp_path / "performance.csv"), 1e-3)
    first = (tmp_path / "performance.csv").read_text().splitlines()[1]
    assert first.startswith("13:13:04:31.652,61,0.123647012")
    assert len(take) == 4030 and np.median(np.diff(take.timestamps)) == pytest.approx(1 / 30, abs=1e-4)


@real
def test_eyes_of_the_real_take_follow_from_its_curves(take):
    """Gains and signs: a wrong sign makes a slope of -1, a wrong gain another slope."""
    made = eye_angles(take.curves)
    for k, name in enumerate(("left yaw", "left pitch", "left roll", "right yaw", "right pitch", "right roll")):
        slope = np.polyfit(made[:, k], take.eyes[:, k], 1)[0]
        correlation = np.corrcoef(made[:, k], take.eyes[:, k])[0, 1]
        if "roll" in name:  # of the measured yaw and pitch: the eyes of the take squint a little at rest
            yaw, pitch = take.eyes[:, k - 2], take.eyes[:, k - 1]
            slope = (yaw * pitch) @ take.eyes[:, k] / np.sum((yaw * pitch) ** 2)
            correlation = np.corrcoef(yaw * pitch, take.eyes[:, k])[0, 1]
        assert slope == pytest.approx(1, abs=0.04), name
        assert correlation > 0.99, name


@real
def test_real_take_drives_a_character(tmp_path, capsys):
    assert cli.main(["export", str(REAL), "--character", "hag", "--out", str(tmp_path / "hag.glb")]) == 0
    assert "4030 frames" in capsys.readouterr().out
    mesh, curves = read_glb_animation(tmp_path / "hag.glb"), read_take(REAL).curves
    for name in ("tongueOut", "eyeLookInLeft", "mouthDimpleRight", "browOuterUpLeft"):
        weights = mesh.weights[:, mesh.target_names.index(name)]
        np.testing.assert_allclose(weights, curves[:, ARKIT_NAMES.index(name)].clip(0, 1), atol=1e-4)
        assert weights.max() > 0.5


# ---- signs and axes ----


@pytest.mark.parametrize(("axis", "index", "sign"), [((0, 1, 0), 0, -1), ((1, 0, 0), 1, 1), ((0, 0, 1), 2, -1)])
def test_signs_of_the_head(axis, index, sign):
    """Turned to the subject's left (about +y): yaw below zero. Nodding (about +x): pitch above zero. Top of the head
    towards the subject's right (about +z): roll below zero."""
    turn = rotation_vector_matrix(0.3 * np.array(axis, float))
    expected = np.zeros(3)
    expected[index] = sign * 0.3
    np.testing.assert_allclose(angles(turn), expected, atol=1e-12)
    rigid = np.eye(4)
    rigid[:3, :3] = np.diag([1.0, -1.0, -1.0]) @ turn
    np.testing.assert_allclose(head_angles(rigid[None])[0], expected, atol=1e-12)


def test_signs_agree_with_unreals_rotator():
    """The engine's own arithmetic: ARKit's quaternion becomes (-z, x, y, -w), then yaw, pitch and roll of a rotator."""
    from scipy.spatial.transform import Rotation

    for turn in Rotation.random(50, random_state=1):
        qx, qy, qz, qw = turn.as_quat()
        x, y, z, w = -qz, qx, qy, -qw
        rotator = [
            np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)),
            np.arcsin(np.clip(2 * (z * x - w * y), -1, 1)),
            np.arctan2(-2 * (w * x + y * z), 1 - 2 * (x * x + y * y)),
        ]
        np.testing.assert_allclose(angles(turn.as_matrix()), rotator, atol=1e-6)


def test_angles_there_and_back():
    some = np.random.default_rng(2).uniform(-1.2, 1.2, (40, 2, 3))
    np.testing.assert_allclose(angles(rotations(some)), some, atol=1e-9)


def test_eyes_look_where_the_curves_say():
    curves = np.zeros((1, 52))
    for name in ("eyeLookOutLeft", "eyeLookInRight"):  # both to the subject's left, which is +x
        curves[0, ARKIT_NAMES.index(name)] = 1.0
    t = LiveLinkTake(np.zeros(1), curves, np.zeros((1, 3)), eye_angles(curves), np.ones(1, bool))
    gaze = rotations(t.eyes.reshape(-1, 2, 3))[0, :, :, 2]
    np.testing.assert_allclose(gaze[:, 0], np.sin(0.605), atol=1e-9)
    curves = np.zeros((1, 52))
    curves[0, [ARKIT_NAMES.index(f"eyeLookDown{side}") for side in ("Left", "Right")]] = 1.0
    t = LiveLinkTake(np.zeros(1), curves, np.zeros((1, 3)), eye_angles(curves), np.ones(1, bool))
    np.testing.assert_allclose(rotations(t.eyes.reshape(-1, 2, 3))[0, :, 1, 2], -np.sin(0.556), atol=1e-9)


@pytest.mark.parametrize("kind", ["one-euro", "kalman"])
def test_smoothing_takes_the_eyes_with_it(tmp_path, kind):
    rng = np.random.default_rng(5)
    base = small_take()
    noisy = LiveLinkTake(base.timestamps, 0 * base.curves, base.head, 0.2 + rng.normal(0, 0.02, (90, 6)), base.tracked)
    write_take(tmp_path / "take.csv", noisy)
    assert cli.main(["export", str(tmp_path / "take.csv"), "--format", "arkit-csv", "--filter", kind]) == 0
    smooth = read_take(tmp_path / "take-arkit.csv").eyes
    assert smooth[20:].std(axis=0).max() < 0.9 * noisy.eyes[20:].std(axis=0).max()
    assert smooth[20:].mean() == pytest.approx(0.2, abs=0.01)


# ---- files of other kinds ----


def lines_of(take: LiveLinkTake, folder: Path) -> list[str]:
    write_take(folder / "base.csv", take)
    return (folder / "base.csv").read_text().splitlines()


def test_unusual_but_good_files(tmp_path):
    base = small_take()
    lines = lines_of(base, tmp_path)
    order = np.random.default_rng(1).permutation(63)
    shuffled = "\n".join(",".join(line.split(",")[k] for k in order) for line in lines)
    variants = {
        "windows": "\ufeff" + "\r\n".join(lines) + "\r\n",
        "lower case": "\n".join([lines[0].lower(), *lines[1:]]),
        "shuffled": shuffled,
        "semicolons": "\n".join(line.replace(",", ";") for line in lines),
        "tabs": "\n".join(line.replace(",", "\t") for line in lines),
        "blank lines": "\n\n".join(lines),
        "further columns": "\n".join(f"{line},{'Extra' if k == 0 else 7}" for k, line in enumerate(lines)),
        "quotes": "\n".join(",".join(f'"{word}"' for word in line.split(",")) for line in lines),
        "drop frame": "\n".join(line[:8] + ";" + line[9:] if k else line for k, line in enumerate(lines)),
    }
    for name, text in variants.items():
        (tmp_path / "variant.csv").write_bytes(text.encode())
        try:
            assert_same(base, read_take(tmp_path / "variant.csv"))
        except FileFormatError as error:
            pytest.fail(f"{name}: {error}")
    comma = [";".join(w if k == 0 else w.replace(".", ",") for k, w in enumerate(line.split(","))) for line in lines]
    (tmp_path / "variant.csv").write_text("\n".join([lines[0].replace(",", ";"), *comma[1:]]))
    assert_same(base, read_take(tmp_path / "variant.csv"))


def test_absent_columns_are_zero_and_named(tmp_path):
    lines = lines_of(small_take(), tmp_path)
    (tmp_path / "short.csv").write_text("\n".join(",".join(line.split(",")[:54]) for line in lines))
    short = read_take(tmp_path / "short.csv")
    assert short.absent == HEADER[54:] and not short.head.any() and short.curves[:, -1].any()


def test_lost_faces_repeat_the_last_one(tmp_path):
    lines = lines_of(small_take(), tmp_path)
    for k in (1, 2, 20, 21):
        lines[k] = lines[k].split(",")[0] + ",0" + "," * (61 if k % 2 else 0)
    (tmp_path / "lost.csv").write_text("\n".join(lines))
    lost = read_take(tmp_path / "lost.csv")
    assert list(np.flatnonzero(~lost.tracked)) == [0, 1, 19, 20]
    np.testing.assert_array_equal(lost.curves[[0, 1, 19, 20]], lost.curves[[2, 2, 18, 18]])
    write_take(tmp_path / "again.csv", lost)
    np.testing.assert_array_equal(read_take(tmp_path / "again.csv").tracked, lost.tracked)


@pytest.mark.parametrize("fps", [24, 25, 30, 50, 60])
def test_timecodes_of_other_rates(tmp_path, fps):
    base = small_take(frames=5 * fps, fps=fps, start=100.0)
    rows = [line.split(",", 1)[1] for line in lines_of(base, tmp_path)[1:]]
    codes = [f"00:01:{40 + k // fps:02d}:{k % fps:02d}.000" for k in range(5 * fps)]
    text = [",".join(HEADER), *(f"{c},{r}" for c, r in zip(codes, rows, strict=True))]
    (tmp_path / "rate.csv").write_text("\n".join(text))
    np.testing.assert_allclose(read_take(tmp_path / "rate.csv").timestamps, base.timestamps, atol=1e-6)


@pytest.mark.parametrize("fps", [0.5, 2, 10, 29.97, 90])
def test_our_own_timecodes_at_any_rate_and_over_midnight(tmp_path, fps):
    base = small_take(frames=200, fps=fps, start=86_399.0)
    rows = lines_of(base, tmp_path)
    again = read_take(tmp_path / "base.csv")
    np.testing.assert_allclose(again.timestamps, base.timestamps, atol=2e-5)
    wrapped = [rows[0], *("00:00" + row[5:] if row.startswith("24:00") else row for row in rows[1:])]
    if fps > 5:
        (tmp_path / "wrapped.csv").write_text("\n".join(wrapped))
        np.testing.assert_allclose(read_take(tmp_path / "wrapped.csv").timestamps, base.timestamps, atol=2e-5)
    assert timecode(3723.5125) == "01:02:03:30.750"


@pytest.mark.parametrize(
    ("body", "reason"),
    [
        ("00:00:00:00.000,0" + "," * 61, "never found"),
        ("00:00:00:00.000,61" + ",inf" * 61, "line 2: values that are not"),
        ("00:00:00:00.000,61" + ",x" * 61, "line 2: a timecode"),
        ("1e9:0:0:0,61" + ",0" * 61, "line 2: a timecode"),
        ("00:00:00:00.000,61" + ",0" * 60, "line 2: 62 columns instead of 63"),
        ("00:00:00:00.000,61" + ",0" * 60 + ",", "line 2: a timecode and numbers"),
    ],
)
def test_broken_rows_are_named(tmp_path, body, reason):
    (tmp_path / "bad.csv").write_text(",".join(HEADER) + "\n" + body + "\n")
    with pytest.raises(FileFormatError, match=reason):
        read_take(tmp_path / "bad.csv")


def test_what_is_no_take(tmp_path):
    for name, content in (("empty", b""), ("binary", bytes(range(256))), ("other", b"a,b\n1,2\n")):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(FileFormatError, match=name):
            read_take(tmp_path / name)
    with pytest.raises(FileFormatError, match="not a regular file"):
        read_take(tmp_path)


# ---- the command ----


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ([], "no mesh of its own"),
        (["--character", "hag", "--correctives"], "--correctives needs a tracked result"),
        (["--character", "hag", "--source", "synthetic"], "--source needs"),
        (["--character", "nobody"], "neither built in"),
    ],
)
def test_export_of_a_take_refuses_in_one_line(tmp_path, capsys, options, reason):
    write_take(tmp_path / "take.csv", small_take())
    assert cli.main(["export", str(tmp_path / "take.csv"), *options]) == cli.EXIT_ERROR
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == 1


@pytest.mark.parametrize("command", [["track"], ["capture"], ["convert"]])
def test_other_commands_say_what_a_take_is_for(tmp_path, capsys, command):
    write_take(tmp_path / "take.csv", small_take())
    out = {"track": "r.npz", "capture": "a.npz", "convert": "folder"}[command[0]]
    assert cli.main([*command, str(tmp_path / "take.csv"), "--out", str(tmp_path / out)]) == cli.EXIT_ERROR
    assert "adaptiveface export" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["arkit-csv", "gif", "obj"])
def test_takes_become_every_format(tmp_path, kind):
    write_take(tmp_path / "take.csv", small_take(frames=6))
    assert cli.main(["export", str(tmp_path / "take.csv"), "--character", "baby", "--format", kind, "--smooth"]) == 0
    assert len([path for path in tmp_path.iterdir() if path.name.startswith("take-")]) == 1
