"""A small tracked result with known truth for the tests of retargeting and export: no tracking needed."""

from __future__ import annotations

import socket
from pathlib import Path

import numpy as np
from scenes import exact_actor

from adaptiveface.export.animation import AnimatedMesh, actor_animation, character_animation
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.model.actor import Actor
from adaptiveface.parameters import Parameters
from adaptiveface.result import Result
from adaptiveface.retargeting.arkit import ARKIT_NAMES, arkit_weights
from adaptiveface.retargeting.loading import load_character
from adaptiveface.retargeting.retarget import retarget
from adaptiveface.synthetic.script import HeadMotion, performance
from adaptiveface.tracking.types import STAGE_NAMES

FRAMES = 24


def known_coefficients(actor: Actor, frames: int = FRAMES, seed: int = 3) -> np.ndarray:
    """(F, A) coefficients of a performance."""
    names = ARKIT_NAMES
    return arkit_weights(actor.expression_names).coefficients(performance(seed, names, frames))


def fields(neutral: np.ndarray, frontal: np.ndarray, count: int, seed: int) -> np.ndarray:
    """(count, N, 3) mm: smooth bumps on the face that no expression knows."""
    rng = np.random.default_rng(seed)
    centres = neutral[rng.choice(np.flatnonzero(frontal), count)]
    distance = np.linalg.norm(neutral[None] - centres[:, None], axis=2)
    return np.exp(-((distance / 14.0) ** 2))[:, :, None] * rng.normal(size=(count, 1, 3)) * frontal[None, :, None]


def tracked_result(seed: int = 0, frames: int = FRAMES) -> tuple[Actor, Result, np.ndarray]:
    """Actor, result and v4 (F, N, 3) in the head frame: coefficients, correctives and a drifting remainder."""
    actor = exact_actor(seed)
    rng = np.random.default_rng(seed)
    x = known_coefficients(actor, frames)
    correctives = fields(actor.neutral, actor.frontal, 4, seed).reshape(4, -1)
    correctives = np.linalg.qr(correctives.T)[0].T.reshape(4, *actor.neutral.shape)
    flat = actor.blendshapes.reshape(len(x.T), -1)
    v4 = actor.neutral + (x @ flat).reshape(frames, -1, 3)
    v4 = v4 + np.tensordot(rng.normal(0, 20, (frames, 4)), correctives, axes=1)
    v4 = v4 + np.tensordot(rng.normal(0, 0.7, (frames, 12)), fields(actor.neutral, actor.frontal, 12, seed + 1), axes=1)
    motion = HeadMotion(seed, 0, 30.0, 600.0)
    rigid = np.stack([motion.pose(f) for f in range(frames)])
    vertices = np.stack([transform_points(m, v) for m, v in zip(rigid, v4, strict=True)]).astype(np.float32)
    zeros = np.zeros(frames, np.float32)
    result = Result(
        vertices=vertices,
        triangles=actor.triangles,
        frontal=actor.frontal,
        tracked=np.ones(frames, bool),
        skipped=np.zeros(frames, bool),
        timestamps=np.arange(frames) / 30.0,
        head_pose=rigid.astype(np.float32),
        coefficients=x.astype(np.float32),
        coefficients_initial=np.clip(x + 0.05, 0, 1).astype(np.float32),
        expression_names=actor.expression_names,
        feature_vertices=actor.feature_vertices,
        feature_ids=actor.feature_ids,
        corrective_updates=np.zeros(frames, np.int32),
        sample_state=np.full(frames, 2, np.int8),
        residual=zeros,
        anchor_distance=zeros,
        adaptive_distance=zeros,
        reasons=("",) * frames,
        stage_ms=np.zeros((frames, len(STAGE_NAMES)), np.float32),
        stage_names=STAGE_NAMES,
        parameters=Parameters().to_json(),
        correctives=correctives.astype(np.float32),
    )
    return actor, result, v4


def received(listener: socket.socket) -> list:
    """The OSC messages (address, arguments) that reach a socket until it is quiet."""
    from pythonosc.osc_bundle import OscBundle

    messages = []
    listener.settimeout(0.5)
    try:
        while True:
            data = listener.recv(65536)
            assert len(data) <= 1472
            messages += [(m.address, list(m.params)) for m in OscBundle(data)]
    except TimeoutError:
        return messages


def animated_meshes() -> dict[str, AnimatedMesh]:
    """The tracked actor and a character that it drives."""
    actor, result, _ = tracked_result()
    return {"actor": actor_animation(result, actor), "hag": character_animation(load_character("hag"), retarget(result))}


def save_run(folder: Path, actor: Actor, result: Result) -> Path:
    """Write actor.npz and result.npz as ``adaptiveface track`` does; the folder."""
    actor.save(folder / "actor.npz")
    result.save(folder / "result.npz")
    return folder
