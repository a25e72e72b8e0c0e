"""Live Link Face's datagrams in both directions, ``live livelink``, takes that are streamed, and what avatars are sent."""

from __future__ import annotations

import socket
import struct
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from export_scene import received
from scipy.spatial.transform import Rotation

from adaptiveface import cli
from adaptiveface.errors import ParameterError, SensorError
from adaptiveface.export.messages import (
    FACE_CAP,
    NECK_SHARE,
    OFFSETS,
    FaceState,
    VmcAvatar,
    osc_messages,
    read_avatar,
    vmc_messages,
)
from adaptiveface.formats.gltf.container import GltfContainer
from adaptiveface.formats.gltf.edit import GltfEdit
from adaptiveface.livelink import ARKIT_NAMES, LiveLinkTake, read_take, write_take
from adaptiveface.livelink.convention import eye_angles
from adaptiveface.livelink.packet import LiveLinkFrame, decode, encode
from adaptiveface.livelink.receiver import LOOPBACK, LiveLinkReceiver, is_livelink, parse_address
from adaptiveface.retargeting.vrm_presets import PRESETS, VRM0_NAMES

AVATARS = Path(__file__).resolve().parents[2] / "shared/avatars"
#: The order of Unreal's EARFaceBlendShape around the pairs that the CSV has the other way round.
UNREAL = {15: "jawLeft", 16: "jawRight", 17: "jawOpen", 21: "mouthLeft", 22: "mouthRight", 51: "tongueOut"}


def frame(k: int = 0, device: str = "phone", **curves: float) -> LiveLinkFrame:
    values = np.linspace(0, 1, 52)
    for name, value in curves.items():
        values[ARKIT_NAMES.index(name)] = value
    return LiveLinkFrame(47_000.0 + k / 60, True, values, np.array([0.1, -0.2, 0.3]), np.arange(6) / 10, "me", device)


def by_hand(values: list[float], number: int = 2_820_000, part: float = 0.25) -> bytes:
    """A datagram as the app writes it, built field by field."""
    device = b"DC1B61D4-0000-4000-8000-0123456789AB"
    head = b"\x06" + b"\x00\x00\x00\x24" + device + b"\x00\x00\x00\x06" + b"iPhone"
    return head + struct.pack(">ifii", number, part, 60, 1) + b"\x3d" + struct.pack(">61f", *values)


# ---- datagrams ----


def test_datagram_by_hand():
    values = [k / 100 for k in range(61)]
    got = decode(by_hand(values))
    assert (got.device, got.subject, got.tracked) == ("DC1B61D4-0000-4000-8000-0123456789AB", "iPhone", True)
    assert got.time == pytest.approx(47_000 + 0.25 / 60)
    for place, name in UNREAL.items():
        assert got.curves[ARKIT_NAMES.index(name)] == pytest.approx(place / 100), name
    np.testing.assert_allclose(got.head, [0.52, 0.53, 0.54], atol=1e-6)
    np.testing.assert_allclose(got.eyes, np.arange(55, 61) / 100, atol=1e-6)
    again = encode(LiveLinkFrame(got.time, True, got.curves, got.head, got.eyes, got.subject, got.device))
    assert again[: len(again) - 245 - 16] == by_hand(values)[: len(again) - 245 - 16]
    np.testing.assert_allclose(np.frombuffer(again[-244:], ">f4"), values, atol=1e-6)
    assert 264 <= len(again) <= 774


def test_datagrams_there_and_back():
    sent = frame(3)
    got = decode(encode(sent))
    for name in ("curves", "head", "eyes"):
        np.testing.assert_allclose(getattr(got, name), getattr(sent, name), atol=1e-6)
    assert got.time == pytest.approx(sent.time, abs=1e-4) and got.subject == "me"
    lost = decode(encode(LiveLinkFrame(1.0, False, sent.curves, sent.head, sent.eyes)))
    assert not lost.tracked and not lost.curves.any()


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\x06",
        b"\x05" + by_hand([0] * 61)[1:],
        by_hand([0] * 61)[:-1],
        by_hand([0] * 61)[:200],
        by_hand([np.nan] * 61),
        b"\x06\x7f\xff\xff\xff" + bytes(100),
        b"\x06\xff\xff\xff\xff" + bytes(100),
        bytes(4000),
        b'{"json": 1}' * 30,
        by_hand([0] * 61)[:51] + struct.pack(">ifii", 0, 0.0, 0, 1) + bytes(245),
        by_hand([0] * 61)[:51] + struct.pack(">ifii", 0, np.inf, 60, 1) + bytes(245),
    ],
)
def test_broken_datagrams_have_a_reason(data):
    with pytest.raises(ValueError, match=r"\w"):
        decode(data)


def test_random_bytes_never_do_more():
    rng = np.random.default_rng(0)
    good = bytearray(by_hand([0.5] * 61))
    for _ in range(3000):
        data = good.copy()
        for at in rng.integers(0, len(data), rng.integers(1, 6)):
            data[at] = rng.integers(256)
        try:
            decode(bytes(data[: rng.integers(len(data) + 1)]))
        except ValueError:
            continue


@pytest.mark.parametrize(
    ("text", "address"),
    [
        ("livelink", (LOOPBACK, 11111)),
        ("livelink:", (LOOPBACK, 11111)),
        ("livelink:12000", (LOOPBACK, 12000)),
        ("livelink:0.0.0.0:11111", ("0.0.0.0", 11111)),
        ("livelink:192.168.1.7", ("192.168.1.7", 11111)),
        ("livelink:[::1]:5000", ("::1", 5000)),
    ],
)
def test_addresses(text, address):
    assert is_livelink(text) and parse_address(text) == address


@pytest.mark.parametrize("text", ["livelink:0", "livelink:70000", "livelink:h:x"])
def test_bad_addresses(text):
    with pytest.raises(ParameterError, match="from 1 to 65535"):
        parse_address(text)


# ---- receiving ----


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind((LOOPBACK, 0))
        return probe.getsockname()[1]


class Phone(threading.Thread):
    """Sends datagrams to a port until it is told to stop."""

    def __init__(self, port: int, datagrams: list[bytes], pause: float = 0.004) -> None:
        super().__init__(daemon=True)
        self.port, self.datagrams, self.pause = port, datagrams, pause
        self.start()

    def run(self) -> None:
        time.sleep(0.5)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
            for data in self.datagrams:
                sender.sendto(data, (LOOPBACK, self.port))
                time.sleep(self.pause)


def test_receiver_follows_one_phone_and_counts_the_rest():
    with LiveLinkReceiver(port=free_port()) as receiver:
        other = [encode(frame(k, "other")) for k in range(3)]
        Phone(receiver.port, [b"noise", encode(frame(0)), *other, encode(frame(2)), encode(frame(1)), encode(frame(3))])
        got, until = [], time.monotonic() + 60
        while len(got) < 3 and time.monotonic() < until:
            got += list(receiver.frames(0.2))
        assert [round((f.time - 47_000) * 60) for f in got] == [0, 2, 3]
        assert receiver.bad == 1 and receiver.late == 1 and receiver.others == {"me"} and receiver.subject == "me"
        with pytest.raises(SensorError, match="cannot listen"), LiveLinkReceiver(port=receiver.port):
            pass


def test_a_sender_whose_clock_stands_still_is_taken_by_arrival():
    with LiveLinkReceiver(port=free_port()) as receiver:
        Phone(receiver.port, [encode(frame(0, jawOpen=k / 10)) for k in range(10)], pause=0.02)
        got, until = [], time.monotonic() + 60
        while len(got) < 10 and time.monotonic() < until:
            got += list(receiver.frames(0.2))
        assert [round(f.curves[ARKIT_NAMES.index("jawOpen")] * 10) for f in got] == list(range(10)) and receiver.late == 0
        steps = np.diff([f.time for f in got])
        assert (steps > 0).all() and steps.sum() > 0.15


def send_when_listening(monkeypatch, datagrams: list[bytes]) -> None:
    """A phone that begins when the command has opened its port, however long that takes."""
    enter = LiveLinkReceiver.__enter__

    def enter_and_send(self):
        receiver = enter(self)
        Phone(receiver.port, datagrams)
        return receiver

    monkeypatch.setattr(LiveLinkReceiver, "__enter__", enter_and_send)


def test_live_livelink_keeps_a_take_and_sends_on(tmp_path, capsys, monkeypatch):
    pytest.importorskip("pythonosc", reason="the extra 'osc' is not installed")
    port, out = free_port(), tmp_path / "take.csv"
    listener = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    listener.bind((LOOPBACK, 0))
    frames = [frame(k, jawOpen=k / 40) for k in range(40)]
    lost = LiveLinkFrame(47_000 + 40 / 60, False, np.zeros(52), np.zeros(3), np.zeros(6), "me", "phone")
    send_when_listening(monkeypatch, [encode(f) for f in [*frames, lost]])
    vmc = str(listener.getsockname()[1])
    assert cli.main(["live", f"livelink:{port}", "--headless", "--seconds", "5", "--out", str(out), "--vmc", vmc]) == 0
    said = capsys.readouterr().out
    assert "this machine only" in said and "0.0.0.0:11111" in said and "41 frames of 'me', 1 without a face" in said
    take = read_take(out)
    assert len(take) == 41 and list(np.flatnonzero(~take.tracked)) == [40]
    np.testing.assert_allclose(take.curves[:40], [f.curves for f in frames], atol=1e-6)
    np.testing.assert_allclose(take.eyes[:40], [f.eyes for f in frames], atol=1e-6)
    np.testing.assert_allclose(np.diff(take.timestamps), 1 / 60, atol=1e-4)
    jaw = [m[1][1] for m in received(listener) if m[0] == "/VMC/Ext/Blend/Val" and m[1][0] == "JawOpen"]
    assert len(jaw) > 10  # what the listener's buffer holds
    np.testing.assert_allclose(jaw, np.arange(len(jaw)) / 40, atol=1e-6)
    assert cli.main(["export", str(out), "--character", "baby", "--format", "arkit-csv"]) == 0
    listener.close()


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        (["--out", "x.npz"], "must end in .csv"),
        (["--actor", "a.npz"], "--actor needs a sensor with depth"),
        (["--record", "x"], "--record needs"),
        (["--seconds", "1"], "no frame came"),
        (["--vmc", "h:0"], "1 to 65535"),
        (["--vmc-avatar", "nobody.vrm", "--vmc"], "nobody.vrm: no such file"),
    ],
)
def test_live_livelink_refuses_in_one_line(tmp_path, monkeypatch, capsys, options, reason):
    monkeypatch.chdir(tmp_path)
    assert cli.main(["live", f"livelink:{free_port()}", *options]) == cli.EXIT_ERROR
    error = capsys.readouterr().err
    assert reason in error and error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_a_take_is_streamed_as_live_link_face_sends_it(tmp_path, capsys):
    curves = np.random.default_rng(4).uniform(0, 1, (20, 52))
    take = LiveLinkTake(50_000 + np.arange(20) / 30, curves, curves[:, :3] - 0.5, eye_angles(curves), np.arange(20) != 7)
    write_take(tmp_path / "take.csv", take)
    take = read_take(tmp_path / "take.csv")
    with LiveLinkReceiver(port=free_port()) as receiver:
        command = ["stream", str(tmp_path / "take.csv"), "--livelink", str(receiver.port), "--fast"]
        assert cli.main(command) == 0
        got = list(receiver.frames(0.5))
    assert [f.tracked for f in got] == take.tracked.tolist()
    for k in np.flatnonzero(take.tracked):
        np.testing.assert_allclose(got[k].curves, take.curves[k], atol=1e-6)
        np.testing.assert_allclose(got[k].head, take.head[k], atol=1e-6)
        np.testing.assert_allclose(got[k].eyes, take.eyes[k], atol=1e-6)
        assert got[k].time == pytest.approx(take.timestamps[k], abs=1e-3)
    assert f"Live Link Face to {LOOPBACK}" in capsys.readouterr().out


# ---- avatars ----


def bones(messages: list) -> dict[str, list[float]]:
    return {values[0]: values[1:] for name, values in messages if name == "/VMC/Ext/Bone/Pos"}


def faces(messages: list) -> dict[str, float]:
    return {values[0]: values[1] for name, values in messages if name == "/VMC/Ext/Blend/Val"}


def state(**curves: float) -> FaceState:
    values = np.zeros(52)
    for name, value in curves.items():
        values[ARKIT_NAMES.index(name)] = value
    turn = Rotation.from_rotvec([0.1, 0.4, -0.2]).as_matrix()
    return FaceState(1.0, True, values, turn, np.array([0.1, 0.2, -0.3]))


def unity(values: list[float]) -> np.ndarray:
    """(3, 3) in Unity's axes, which mirror x."""
    return Rotation.from_quat(values[3:]).as_matrix()


def test_neck_and_head_turn_together_and_stay_in_their_place():
    """A displacement in the bone's own place made the head sink into the neck."""
    messages = vmc_messages(state())
    got = bones(messages)
    assert list(got) == ["Head", "Neck", "LeftEye", "RightEye"]
    mirror = np.diag([-1.0, 1.0, 1.0])
    both = unity(got["Neck"]) @ unity(got["Head"])
    np.testing.assert_allclose(both, mirror @ state().rotation @ mirror, atol=1e-6)
    turn = Rotation.from_matrix(state().rotation).magnitude()
    neck = Rotation.from_matrix(unity(got["Neck"])).magnitude()
    assert neck == pytest.approx(NECK_SHARE * turn, abs=1e-6)
    for bone, (x, y, z) in OFFSETS.items():
        np.testing.assert_allclose(got[bone][:3], [-x, y, z], atol=1e-9)
    assert not any(name == "/VMC/Ext/Root/Pos" for name, _ in messages)
    moving = dict(vmc_messages(state(), VmcAvatar(moves=True)))
    assert moving["/VMC/Ext/Root/Pos"] == ["root", -0.1, 0.2, -0.3, 0.0, 0.0, 0.0, 1.0]
    np.testing.assert_allclose(bones(vmc_messages(state(), VmcAvatar(moves=True)))["Head"], got["Head"])


def test_eyes_turn_to_the_avatars_own_side():
    """To the subject's left, which is Unity's -x for an avatar that looks along +z; and down."""
    got = bones(vmc_messages(state(eyeLookOutLeft=1.0, eyeLookInRight=1.0)))
    for bone in ("LeftEye", "RightEye"):
        np.testing.assert_allclose(unity(got[bone]) @ [0, 0, 1], [-np.sin(0.605), 0, np.cos(0.605)], atol=1e-6)
    got = bones(vmc_messages(state(eyeLookDownLeft=1.0, eyeLookDownRight=1.0)))
    assert (unity(got["LeftEye"]) @ [0, 0, 1])[1] == pytest.approx(-np.sin(0.556), abs=1e-6)
    measured = FaceState(0.0, True, eyes=np.array([0.3, 0, 0, -0.3, 0, 0]))
    gaze = [(unity(bones(vmc_messages(measured))[b]) @ [0, 0, 1])[0] for b in ("LeftEye", "RightEye")]
    np.testing.assert_allclose(gaze, [np.sin(0.3), -np.sin(0.3)], atol=1e-6)  # positive yaw: to the right


def test_ordinary_avatars_move_their_faces():
    got = faces(vmc_messages(state(jawOpen=0.8, eyeBlinkLeft=1.0, mouthSmileLeft=1.0, mouthSmileRight=1.0)))
    assert {name[0].upper() + name[1:] for name in ARKIT_NAMES} | set(PRESETS) | set(VRM0_NAMES.values()) == set(got)
    assert got["aa"] == got["A"] == pytest.approx(0.8) and got["Blink_L"] == got["blinkLeft"] == 1.0
    assert got["Blink_R"] == 0.0 and got["Joy"] == got["happy"] > 0.5 and got["O"] == 0.0
    assert not set(faces(vmc_messages(state(), VmcAvatar(presets=False)))) & set(PRESETS)
    assert set(faces(vmc_messages(state(), VmcAvatar(arkit=False)))) == set(PRESETS) | set(VRM0_NAMES.values())


@pytest.mark.skipif(not (AVATARS / "ready_player_me.glb").is_file(), reason="the avatars are not here")
def test_a_known_avatar_keeps_its_bones_and_moves_once():
    known = read_avatar(AVATARS / "ready_player_me.glb")
    np.testing.assert_allclose(known.offsets["LeftEye"], [0.0341, 0.0773, 0.0775], atol=1e-3)
    np.testing.assert_allclose(known.offsets["Head"], [0, 0.088, 0.0222], atol=1e-3)
    assert known.arkit and not known.presets


@pytest.mark.parametrize(("extensions", "turned"), [({"VRM": {}}, True), ({"VRM": {}, "VRMC_vrm": {}}, False)])
def test_only_avatars_of_vrm_0_are_turned_round(tmp_path, extensions, turned):
    """A file with both versions of VRM, for readers of either, looks along +z, as the exporter of avatars knows."""
    edit = GltfEdit(GltfContainer(AVATARS / "ready_player_me.glb"), tmp_path / "known.glb")
    edit.document["extensions"] = extensions
    edit.save()
    plain, known = (read_avatar(path).offsets for path in (edit.file.path, edit.out))
    signs = [-1, 1, -1] if turned else [1, 1, 1]
    for bone in ("Head", "Neck", "LeftEye", "RightEye"):
        np.testing.assert_allclose(known[bone], np.multiply(signs, plain[bone]), atol=1e-9)


def test_osc_speaks_face_cap():
    sent = osc_messages(state(jawOpen=0.5, tongueOut=0.25))
    weights = {values[0]: values[1] for name, values in sent if name == "/W"}
    assert sorted(FACE_CAP) == sorted(ARKIT_NAMES) and weights[24] == 0.5 and weights[51] == 0.25 and len(weights) == 52
    named = dict(message for message in sent if message[0] != "/W")
    quaternion = Rotation.from_quat(named["/HRQ"]).as_matrix()
    np.testing.assert_allclose(quaternion, state().rotation, atol=1e-6)
    assert named["/HT"] == pytest.approx([0.1, 0.2, -0.3])
    down = osc_messages(FaceState(0.0, True, rotation=Rotation.from_rotvec([0.2, 0, 0]).as_matrix()))
    np.testing.assert_allclose(dict(down)["/HR"], [-np.degrees(0.2), 0, 0], atol=1e-9)
