"""Compare the tracker's stages with other libraries on the tracker's own inputs, if those libraries are installed.

Every comparison takes the inputs of one stage in real frames, and times the stage and its peer on them in turn, with one
thread each. A peer's preparation of each frame (point clouds and normals from the depth map, stacking of rows) is left out of
its time, in its favour. Work that both do once for all frames (factorisations) is left out for both.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps

import numpy as np
import scipy.sparse as sp
from scipy.optimize import lsq_linear

from ..geometry.mesh import transform_points
from ..model.actor import Actor
from ..parameters import Parameters
from ..tracking.adaptive_pca import AdaptiveModel
from ..tracking.expression import BlendshapeFit, add_rows
from ..tracking.laplacian import LaplacianDeformation
from ..tracking.rigid import RigidTracker
from ..tracking.stages import Stages
from ..tracking.tracker import FaceTracker
from ..tracking.types import SampleState

#: CPU seconds of this process, which other programs on the machine do not lengthen. If that clock is too coarse (16 ms on
#: Windows), these are elapsed seconds.
cpu_clock = time.process_time if time.get_clock_info("process_time").resolution < 1e-4 else time.perf_counter

INSTALL = "pip install 'adaptiveface[bench]'"


@dataclass(frozen=True)
class Comparison:
    """Median CPU times of one stage and of a peer on the same inputs, ms.

    ``peer_ms`` is None if the peer is not installed. ``agreement`` says in words how far the two results lie apart; it is ""
    if they solve the problem differently.
    """

    stage: str
    peer: str
    ours_ms: float
    peer_ms: float | None
    agreement: str = ""


@dataclass(frozen=True)
class Recorded:
    """The arguments of the tracker's stages in order, as one list of tuples per stage."""

    tracker: FaceTracker
    align: list
    fit: list
    solve: list
    rows: list
    prefactored: list
    learn: list


class Notes:
    """Keeps copies of the positional arguments of calls while it is ``on``."""

    def __init__(self, on: bool = False) -> None:
        self.on = on
        self.calls: list[tuple] = []

    def noting(self, method: Callable) -> Callable:
        """Wrap ``method`` so that its calls are noted."""

        @wraps(method)
        def noted(instance, *arguments, **options):
            """Call the method, and note a copy of its arguments."""
            if self.on:
                self.calls.append(tuple(a.copy() if isinstance(a, np.ndarray) else a for a in arguments))
            return method(instance, *arguments, **options)

        return noted


def record(actor: Actor, frames, count: int, parameters: Parameters | None = None) -> Recorded:
    """Track ``frames``, and keep the arguments of the stages that have a peer in the last ``count`` frames.

    Samples are kept from all frames, because the state of the model comes from all of them.
    """
    aligned, fitted, solved, rows, prefactored = notes = Notes(), Notes(), Notes(), Notes(), Notes()
    learned = Notes(on=True)
    note_rows = rows.noting(lambda _, *arguments: add_rows(*arguments))
    note_right = prefactored.noting(lambda _, right: None)

    class Rigid(RigidTracker):
        align = aligned.noting(RigidTracker.align)

    class Fit(BlendshapeFit):
        fit, solve, add_rows = fitted.noting(BlendshapeFit.fit), solved.noting(BlendshapeFit.solve), note_rows

    class Deformation(LaplacianDeformation):
        """Notes the right-hand sides (n, 3) of its solves."""

        def precondition(self, right, correction):
            """Solve as usual, after noting ``right`` (n, 3)."""
            note_right(self, right)
            return super().precondition(right, correction)

    class Model(AdaptiveModel):
        parts = learned.noting(AdaptiveModel.parts)

    stages = Stages(rigid=Rigid, blendshapes=Fit, deformation=Deformation.of, adaptive_pca=Model)
    # The inputs of a fit are solved again afterwards, so its expressions must stay the same.
    parameters = (parameters or Parameters()).replace(personal_blendshapes__on=False)
    tracker = FaceTracker(actor, parameters, stages)
    for number, frame in enumerate(frames):
        for entry in notes:
            entry.on = number >= len(frames) - count
        tracker.track(frame)
    for entry in (*notes, learned):
        entry.on = False
    return Recorded(tracker, aligned.calls, fitted.calls, solved.calls, rows.calls, prefactored.calls, learned.calls)


def load_peers() -> list[str]:
    """Import the installed peers, so that a thread limit set afterwards reaches them, and return their names."""
    return [name for name in ("open3d", "igl", "sklearn.decomposition") if _optional(name) is not None]


def compare_all(recorded: Recorded, limit: int = 40) -> list[Comparison]:
    """Make every comparison on at most ``limit`` calls."""
    comparisons = (rigid_icp, bounded_solve, blendshape_fit, prefactored_solve, incremental_pca)
    return [compare(recorded, limit) for compare in comparisons]


def _in_turn(ours: Callable, peer: Callable | None, inputs: list) -> tuple[float, float | None]:
    """Measure the median CPU ms of both. They take turns, so that both meet the same caches and clock rates."""
    times: tuple[list[float], list[float]] = ([], [])
    for arguments in inputs:
        for function, spent in zip((ours, peer), times, strict=True):
            if function is not None:
                start = cpu_clock()
                function(*arguments)
                spent.append((cpu_clock() - start) * 1e3)
    return float(np.median(times[0])), float(np.median(times[1])) if times[1] else None


def _optional(name: str):
    try:
        return importlib.import_module(name)
    except ImportError:
        return None


def _spread(calls: list, limit: int) -> list:
    return calls[:: max(1, len(calls) // limit)][:limit]


# ---- rigid: point-to-plane ICP ---------------------------------------------------------------------------------------
def rigid_icp(recorded: Recorded, limit: int) -> Comparison:
    """Compare with Open3D's point-to-plane ICP, given the same points, depth map, start, reach and number of iterations.

    Open3D searches nearest neighbours in a k-d tree, whereas the tracker projects into the depth map.
    """
    o3d, p = _optional("open3d"), recorded.tracker.parameters.rigid
    inputs, peer = [], None
    for surface, shape, normals, pose in _spread(recorded.align, limit):
        clouds = (None, None) if o3d is None else _clouds(o3d, surface, transform_points(pose, shape))
        inputs.append((surface, shape, normals, pose, *clouds))
    if o3d is not None:
        registration = o3d.pipelines.registration
        plane = registration.TransformationEstimationPointToPlane()
        # With zero tolerances, it makes exactly as many iterations as the tracker.
        criteria = registration.ICPConvergenceCriteria(0.0, 0.0, p.iterations)

        def peer(surface, shape, normals, pose, source, target):
            """Open3D's registration."""
            return registration.registration_icp(source, target, p.max_correspondence_distance, np.eye(4), plane, criteria)

    def ours(surface, shape, normals, pose, *_):
        """Our fit of the pose."""
        return recorded.tracker.rigid.align(surface, shape, normals, pose)

    return Comparison("rigid", "Open3D point-to-plane ICP", *_in_turn(ours, peer, inputs))


def _clouds(o3d, surface, points: np.ndarray):
    """Convert the tracker's points, and the depth map's points with normals, to Open3D point clouds."""
    v, u = np.nonzero(surface.valid)
    pixels = np.stack([u + surface.origin[0], v + surface.origin[1]], axis=1).astype(float)
    depth = surface.depth[v, u].astype(float)
    gradient_u, gradient_v = surface.gradient_u[v, u].astype(float), surface.gradient_v[v, u].astype(float)
    camera = surface.camera
    along = depth + (pixels[:, 0] - camera.cx) * gradient_u + (pixels[:, 1] - camera.cy) * gradient_v
    normals = np.stack([camera.fx * gradient_u, camera.fy * gradient_v, -along], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    source, target = o3d.geometry.PointCloud(), o3d.geometry.PointCloud()
    source.points = o3d.utility.Vector3dVector(points)
    target.points = o3d.utility.Vector3dVector(camera.back_project(pixels, depth))
    target.normals = o3d.utility.Vector3dVector(normals)
    return source, target


# ---- blendshapes: bounded least squares ------------------------------------------------------------------------------
def bounded_solve(recorded: Recorded, limit: int) -> Comparison:
    """Compare with scipy's ``lsq_linear`` on the normal equations of one round, as the equivalent system R z = R^-T g."""
    fit = recorded.tracker.blendshapes
    inputs = []
    for equations, x in _spread(recorded.solve, limit):
        factor = np.linalg.cholesky(equations.h)
        inputs.append((equations, x, factor.T, np.linalg.solve(factor, equations.g)))

    def ours(equations, x, *_):
        """The pose update and the coefficients (6 + A,) by our bounded solver."""
        x, update_for = fit.solve(equations, x)
        return np.concatenate([update_for(x), x])

    def peer(equations, x, matrix, target):
        """The same by SciPy's bounded least squares."""
        return lsq_linear(matrix, target, _bounds(fit.parameters, len(x)), method="bvls").x

    apart = max(np.abs(ours(*i) - peer(*i))[6:].max() for i in inputs)
    return Comparison("bounded solve", "scipy lsq_linear", *_in_turn(ours, peer, inputs), f"{apart:.0e} apart")


def blendshape_fit(recorded: Recorded, limit: int) -> Comparison:
    """Compare the whole blendshape stage (search, rows, solve) with ``lsq_linear`` on its stacked rows, without search."""
    fit = recorded.tracker.blendshapes
    rounds = len(recorded.solve) // len(recorded.fit)
    systems = _tall_systems(recorded)
    grouped = [systems[k * rounds : (k + 1) * rounds] for k in range(len(recorded.fit))]
    inputs = _spread([(arguments, group) for arguments, group in zip(recorded.fit, grouped, strict=True)], limit)

    def ours(arguments, _):
        """The pose (4, 4) and the coefficients (A,) of a frame by our fit."""
        return fit.fit(*arguments)

    def peer(arguments, group):
        """The solutions of a frame's rounds by SciPy."""
        return [lsq_linear(matrix, target, _bounds(fit.parameters, matrix.shape[1] - 6)).x for matrix, target in group]

    solved = [(peer(*entry)[-1][6:], ours(*entry)[1]) for entry in inputs]
    apart = max(np.abs(theirs - own).max() for theirs, own in solved)
    name = f"scipy lsq_linear on the rows, {rounds} times"
    return Comparison("blendshapes", name, *_in_turn(ours, peer, inputs), f"{apart:.0e} apart")


def _bounds(parameters, count: int):
    """Return the bounds: the pose update is free, and the coefficients are bounded."""
    free, ones = np.full(6, np.inf), np.ones(count)
    return np.concatenate([-free, parameters.lower * ones]), np.concatenate([free, parameters.upper * ones])


def _tall_systems(recorded: Recorded) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return matrix (m, 6 + A) and target (m,) of every solve: the rows given to ``add_rows`` and the diagonal penalties."""
    by_equations: dict[int, list] = {}
    for equations, jacobian, residual, weights, current in recorded.rows:
        by_equations.setdefault(id(equations), []).append((jacobian, residual, weights, current))
    systems = []
    for equations, _ in recorded.solve:
        matrices, targets = [], []
        for jacobian, residual, weights, current in by_equations[id(equations)]:
            root = np.sqrt(weights)
            matrices.append(root[:, None] * jacobian)
            targets.append(root * (jacobian @ current - residual))
        matrix, target = np.concatenate(matrices), np.concatenate(targets)
        penalty = np.sqrt(np.maximum(np.diag(equations.h - matrix.T @ matrix), 1e-12))
        extra = (equations.g - matrix.T @ target) / penalty
        systems.append((np.concatenate([matrix, np.diag(penalty)]), np.concatenate([target, extra])))
    return systems


# ---- laplacian: prefactored solve ------------------------------------------------------------------------------------
def prefactored_solve(recorded: Recorded, limit: int) -> Comparison:
    """Compare with libigl's ``min_quad_with_fixed`` for the same matrix A0, factorised once, and three right-hand sides."""
    deformation, igl = recorded.tracker.deformation, _optional("igl")
    inputs, peer, agreement = _spread(recorded.prefactored, limit), None, ""
    ours = deformation.system.solve
    if igl is not None and hasattr(igl, "min_quad_with_fixed_data"):
        n = deformation.system.smoothing.shape[0]
        matrix = sp.csc_matrix(deformation.system.smoothing + deformation.w1 * sp.identity(n))
        data = igl.min_quad_with_fixed_data()
        igl.min_quad_with_fixed_precompute(matrix, np.zeros(0, np.int64), sp.csc_matrix((0, n), dtype=float), True, data)
        nothing = np.zeros((0, 3))

        def peer(right):  # it minimises z^T A z / 2 + z^T B
            """The solution (n, 3) by libigl; it minimises z^T A z / 2 + z^T B."""
            return igl.min_quad_with_fixed_solve(data, -right, nothing, nothing)

        apart = max(np.abs(ours(*i) - peer(*i)).max() / np.abs(ours(*i)).max() for i in inputs)
        agreement = f"{apart:.0e} apart (relative)"
    return Comparison("prefactored solve", "libigl min_quad_with_fixed", *_in_turn(ours, peer, inputs), agreement)


# ---- adaptive PCA ----------------------------------------------------------------------------------------------------
def incremental_pca(recorded: Recorded, limit: int) -> Comparison:
    """Compare with scikit-learn's ``IncrementalPCA`` on one new valid sample after the samples of the buffer."""
    tracker, decomposition = recorded.tracker, _optional("sklearn.decomposition")
    p = tracker.parameters.adaptive_pca
    model = AdaptiveModel(tracker.actor, tracker.transferred.basis, p)
    judged = [model.parts(*arguments) for arguments in recorded.learn]
    pairs = zip(recorded.learn, judged, strict=True)
    valid = [(*arguments, parts.residual) for arguments, parts in pairs if model.classify(parts) is SampleState.LEARNED]
    split = max(len(valid) - limit, 0)

    def ours(displacement, _):
        """Learn from a displacement (3n,) with our incremental PCA."""
        model.learn(model.parts(displacement))

    for entry in valid[:split]:
        ours(*entry)
    inputs = [(displacement, residual[None]) for displacement, residual in valid[split:]]
    if not inputs:
        return Comparison("adaptive_pca", "no valid sample to learn", float("nan"), None)

    peer = None
    if decomposition is not None and min(model.count, split) >= p.K > 0:
        pca = decomposition.IncrementalPCA(n_components=p.K)
        pca.partial_fit(np.array([residual for _, residual in valid[split - min(model.count, split) : split]]))

        def peer(_, sample):
            """Learn from a sample (1, 3n) with scikit-learn."""
            pca.partial_fit(sample)

    return Comparison("adaptive_pca", "scikit-learn IncrementalPCA", *_in_turn(ours, peer, inputs))
