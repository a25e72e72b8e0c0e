"""What notebooks 01 and 02 show of the identity prior and of deformation transfer is so."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("ipywidgets", reason="the extra 'notebooks' is not installed")
pytest.importorskip("pyvista", reason="the extra 'notebooks' is not installed")

from adaptiveface import views  # noqa: E402
from adaptiveface.geometry.mesh import cotangent_laplacian  # noqa: E402
from adaptiveface.model.blendshapes import gradient_operator  # noqa: E402
from adaptiveface.studies import prior
from adaptiveface.studies.expression_transfer import LIDS
from adaptiveface.views import transfer_study  # noqa: E402


@pytest.fixture(scope="module")
def session():
    return views.load_session("synthetic", frames=24)


@pytest.fixture(scope="module")
def transfer(session):
    return transfer_study.TransferStudy(session.actor)


def test_without_the_prior_one_frame_is_met_as_well_and_the_head_is_farther_from_the_true_one(session):
    with_prior, without = prior.with_and_without(session, 1)
    assert without.residual < 1.02 * with_prior.residual
    (seen, unseen), (seen_without, unseen_without) = with_prior.median_error(), without.median_error()
    assert seen_without > 2 * seen and unseen_without > 2 * unseen
    assert np.abs(without.identity).max() > 4 > np.abs(with_prior.identity).max()


def test_the_matrix_of_the_transfer_is_the_cotangent_laplacian(session):
    actor = session.actor
    gradient, area = gradient_operator(actor.neutral, actor.triangles)
    matrix = gradient.T @ (np.repeat(area, 3)[:, None] * gradient.toarray()[:, :50])
    assert np.abs(matrix - cotangent_laplacian(actor.neutral, actor.triangles).toarray()[:, :50]).max() < 1e-9


def test_rows_have_the_vertex_and_its_neighbours_and_the_factor_solves(transfer):
    system = transfer.system()
    assert system.matrix.nnz / system.matrix.shape[0] < 7.0
    ordered = system.matrix[system.order][:, system.order].toarray()
    lower = system.factor.toarray()
    pivots = np.linalg.solve(lower, ordered).diagonal()  # L^-1 A = D L^T, whose diagonal is D
    assert np.abs(lower @ np.diag(pivots) @ lower.T - ordered).max() < 1e-9


def test_contact_is_not_transferred_and_copied_displacements_do_worse(transfer):
    for blink in LIDS:
        average, here = transfer.gap(blink)
        assert average < 0.3 < here < transfer.gap(blink, transferred=False)[1]


@pytest.mark.parametrize("name", ["jawOpen", "mouthSmileLeft"])
def test_a_telling_triangle_changes_and_its_pictures_say_what_they_show(transfer, name):
    triangle = transfer.telling_triangle(name)
    assert np.linalg.norm(transfer.change(name)[triangle] - np.eye(3)) > 0.3
    for shown in (transfer.show_correspondence(name, triangle), transfer.show_triangle(name, triangle)):
        assert shown.data.startswith(b"\x89PNG") and str(triangle) in shown.alt
