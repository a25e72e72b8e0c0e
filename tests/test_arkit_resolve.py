"""ARKit's shapes with their halves, solved from final meshes of the 23-expression tracker."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from export_scene import tracked_result

from adaptiveface import cli
from adaptiveface.errors import ParameterError
from adaptiveface.geometry.mesh import transform_points
from adaptiveface.livelink import ARKIT_NAMES, read_take
from adaptiveface.model.blendshapes import deformation_transfer
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.parameters import Parameters
from adaptiveface.retargeting.arkit_resolve import ArkitResolve, has_units, unit_names
from adaptiveface.retargeting.retarget import retarget

#: One-sided and small shapes that the 23 expressions cannot say.
FACES = (
    {"browDownLeft": 0.8},
    {"mouthPressRight": 0.7, "mouthPressLeft": 0.7},
    {"eyeWideLeft": 0.9, "eyeWideRight": 0.9},
    {"eyeSquintRight": 0.8},
    {"mouthDimpleLeft": 0.8},
    {"noseSneerRight": 0.9},
    {"jawOpen": 0.5, "mouthClose": 0.4},
    {"mouthFrownLeft": 0.8, "mouthSmileRight": 0.6},
    {"cheekSquintLeft": 0.7, "eyeBlinkLeft": 0.9},
    {},
)


@pytest.fixture(scope="module")
def scene():
    """Actor, a result whose meshes are those faces exactly, and their curves (F, 52)."""
    actor, result, _ = tracked_result(frames=len(FACES))
    model = embedded_face_model()
    shapes = deformation_transfer(model.mean, actor.neutral, model.triangles, model.expressions)
    truth = np.zeros((len(FACES), 52))
    for row, face in zip(truth, FACES, strict=True):
        for name, value in face.items():
            row[ARKIT_NAMES.index(name)] = value
    units = truth[:, [ARKIT_NAMES.index(name) for name in model.expression_names]]
    v4 = actor.neutral + np.tensordot(units, shapes, axes=1)
    vertices = [transform_points(m.astype(float), v) for m, v in zip(result.head_pose, v4, strict=True)]
    return actor, replace(result, vertices=np.array(vertices, np.float32)), truth


def test_halves_and_small_shapes_are_found(scene):
    actor, result, truth = scene
    found = retarget(result, "arkit", actor=actor).curves
    assert np.sqrt(np.mean((found - truth) ** 2)) < 0.02
    for frame, face in enumerate(FACES):
        for name, value in face.items():
            assert found[frame, ARKIT_NAMES.index(name)] == pytest.approx(value, abs=0.16), (face, name)
    before = retarget(result, actor=actor).curves  # by the 23: both sides alike, and nothing of the small shapes
    assert np.sqrt(np.mean((before - truth) ** 2)) > 0.06
    assert before[0, ARKIT_NAMES.index("browDownLeft")] == before[0, ARKIT_NAMES.index("browDownRight")]


def test_units_are_arkit_names_without_gaze():
    assert len(unit_names()) == 43 and set(unit_names()) < set(ARKIT_NAMES)
    assert not any(name.startswith("eyeLook") for name in unit_names())


def test_the_run_s_own_parameters_hold(scene):
    actor, result, _ = scene
    capped = replace(result, parameters=Parameters().replace(blendshapes__upper=0.3).to_json())
    assert retarget(capped, "arkit", actor=actor).curves.max() == pytest.approx(0.3, abs=1e-6)


def test_actors_on_other_meshes_are_refused(scene):
    actor, result, _ = scene
    other = replace(actor, triangles=actor.triangles[:, ::-1].copy())
    assert has_units(actor) and not has_units(other) and not has_units(None)
    with pytest.raises(ParameterError, match="not the face model's"):
        ArkitResolve(other)
    with pytest.raises(ParameterError, match="--actor"):
        retarget(result, "arkit")


def test_export_uses_them_where_the_rig_is_there(scene, tmp_path, capsys):
    actor, result, truth = scene
    result.save(tmp_path / "result.npz")
    command = ["export", str(tmp_path / "result.npz"), "--format", "arkit-csv"]
    assert cli.main(command) == 0
    alone = read_take(tmp_path / "result-arkit.csv").curves
    actor.save(tmp_path / "actor.npz")
    assert cli.main(command) == 0
    curves = read_take(tmp_path / "result-arkit.csv").curves
    assert np.sqrt(np.mean((curves - truth) ** 2)) < 0.02
    for name in ("mouthPressLeft", "eyeWideRight", "mouthDimpleLeft", "eyeSquintRight", "mouthClose"):
        assert curves[:, ARKIT_NAMES.index(name)].max() > 0.25 and not alone[:, ARKIT_NAMES.index(name)].any()
    assert cli.main([*command, "--coefficients", "resolved"]) == 0
    paper = read_take(tmp_path / "result-arkit.csv").curves
    assert not paper[:, ARKIT_NAMES.index("mouthPressLeft")].any()
    capsys.readouterr()
    assert cli.main([*command, "--coefficients", "arkit", "--correctives"]) == cli.EXIT_ERROR
    assert "--correctives" in capsys.readouterr().err
