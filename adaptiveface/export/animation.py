"""Define what every exporter writes: a mesh with named morph targets, their weights and the head's motion over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..geometry.mesh import transform_points
from ..model.actor import Actor
from ..renamed import renamed
from ..result import Result
from ..retargeting.character import Character
from ..retargeting.retarget import Performance
from ..runtime.timing import frame_rate, increasing, time_codes
from .components import Meshes, frame_blocks, principal_targets

#: Metres in a millimetre. glTF, USD and the streams use metres.
METRES = 1e-3
#: Skin colour (sRGB) of a mesh without colours.
SKIN = (204, 168, 149)
#: Camera frame (y down, z forward) to the frame of glTF and USD (y up, z towards the viewer).
CAMERA_TO_VIEW = np.diag([1.0, -1.0, -1.0])
#: Share of the head's rotation that the neck of an avatar takes. The head's bone adds the rest.
NECK_SHARE = 0.4


@renamed
@dataclass(frozen=True)
class AnimatedMesh:
    """F frames of a mesh with V vertices and E morph targets.

    Attributes
    ----------
    neutral : (V, 3)
        Head frame, mm.
    triangles : (T, 3)
        Vertex numbers.
    target_names : (E,)
        Names of the morph targets.
    targets : (E, V, 3)
        Displacements at weight 1, mm.
    weights : (F, E)
        Of the targets in every frame.
    timestamps : (F,)
        Strictly increasing from 0, s.
    head_pose : (F, 4, 4)
        Head frame to view frame (x right, y up, z towards the viewer), mm.
    colours : (V, 3) uint8 or None
        sRGB.
    inside : AnimatedMesh or None
        Parts inside the head. They share its motion, and have their own targets and weights.
    """

    name: str
    neutral: np.ndarray
    triangles: np.ndarray
    target_names: tuple[str, ...]
    targets: np.ndarray
    weights: np.ndarray
    timestamps: np.ndarray
    head_pose: np.ndarray
    colours: np.ndarray | None = None
    inside: AnimatedMesh | None = None

    def __len__(self) -> int:
        return len(self.weights)

    @property
    def description(self) -> str:
        """Name, size, length and number of shapes in words."""
        return f"{self.name}, {size_text(self.neutral)}, {len(self)} frames, {len(self.target_names)} shapes"

    @property
    def fps(self) -> float:
        """Frames per second."""
        return frame_rate(self.timestamps)

    def shape(self, frame: int, posed: bool = False) -> np.ndarray:
        """(V, 3) mm in the head frame or, with the head's motion, in the view frame."""
        flat = self.targets.reshape(len(self.targets), self.neutral.size)
        vertices = self.neutral + (self.weights[frame] @ flat).reshape(-1, 3)
        return transform_points(self.head_pose[frame], vertices) if posed else vertices

    @property
    def whole_triangles(self) -> np.ndarray:
        """(T + T', 3) triangles of the skin and of the inside parts, whose vertices follow those of the skin."""
        if self.inside is None:
            return self.triangles
        return np.concatenate([self.triangles, self.inside.triangles + len(self.neutral)])

    @property
    def whole_colours(self) -> np.ndarray | None:
        """(V + V', 3) uint8 sRGB of the skin and of the inside parts; None if neither has colours."""
        if self.inside is None:
            return self.colours
        skin = np.tile(np.array(SKIN, np.uint8), (len(self.neutral), 1)) if self.colours is None else self.colours
        return np.concatenate([skin, self.inside.colours])

    def whole_shape(self, frame: int) -> np.ndarray:
        """(V + V', 3) mm in the view frame: the vertices of the skin, then those of the inside parts."""
        skin = self.shape(frame, posed=True)
        return skin if self.inside is None else np.concatenate([skin, self.inside.shape(frame, posed=True)])

    @property
    def codes(self) -> np.ndarray:
        """(F,) times in frames at :attr:`fps`. They are whole numbers if the times fit the rate."""
        return time_codes(self.timestamps, self.fps)

    @property
    def centre(self) -> np.ndarray:
        """(3,) median position of the head in the view frame, mm, which files put at the origin."""
        return np.median(self.head_pose[:, :3, 3], axis=0)


def size_text(vertices: np.ndarray) -> str:
    """Width, height and depth of vertices (V, 3) in mm."""
    return "{:.0f} x {:.0f} x {:.0f} mm".format(*np.ptp(vertices, axis=0))


def view_motion(head_pose: np.ndarray) -> np.ndarray:
    """Convert poses (F, 4, 4) from head-to-camera to head-to-view."""
    out = np.array(head_pose, float)
    out[:, :3] = CAMERA_TO_VIEW @ out[:, :3]
    return out


def character_animation(character: Character, performance: Performance) -> AnimatedMesh:
    """Animate a character. Shapes that nothing drives are kept, with weight 0.

    The head turns about the origin. It is therefore moved there if its file has it elsewhere, as on top of an avatar's body.
    """
    low, high = character.neutral.min(axis=0), character.neutral.max(axis=0)
    outside = ((low > 0) | (high < 0)).any()
    neutral = character.neutral - (low + high) / 2 if outside else character.neutral
    return AnimatedMesh(
        character.name,
        neutral,
        character.triangles,
        character.expression_names,
        character.expressions,
        character.weights(performance.curves),
        increasing(performance.timestamps),
        view_motion(performance.head_pose),
        character.colours,
    )


def actor_animation(result: Result, actor: Actor | None = None, tolerance: float = 0.045) -> AnimatedMesh:
    """Animate the actor's own mesh so that every vertex of every frame is within ``tolerance`` mm of v4.

    With the actor's rig, the targets are its blendshapes (weighted by the re-solved coefficients), the learned correctives,
    and as many principal components of the residual as the tolerance requires. There is a residual because v4 contains the
    final deformation, which follows the 2D features and lies in no basis. Without the rig, the mesh is the mean of all
    frames, and the targets are principal components. All weights are in [0, 1] (:func:`in_slider_range`). Raises
    :class:`FileFormatError` when actor and result do not belong together.
    """
    size = result.vertices.shape[1]
    names, targets, weights = [], np.zeros((0, size, 3)), np.zeros((len(result), 0))
    if actor is not None:
        names, neutral, targets, weights = _rig(result, actor)
    else:
        neutral = sum(meshes.sum(axis=0) for _, meshes in result.head_blocks()) / len(result)
    if actor is not None and result.correctives is not None and len(result.correctives):
        rest = _without(result, neutral, targets, weights)
        shape, amount = _projected(rest, len(result), result.correctives.astype(float))
        names += [f"corrective{k:02d}" for k in range(len(shape))]
        targets, weights = np.concatenate([targets, shape]), np.column_stack([weights, amount])
    shape, amount = principal_targets(_without(result, neutral, targets, weights), len(result), tolerance)
    names += [f"residual{k:03d}" for k in range(len(shape))]
    targets, weights = np.concatenate([targets, shape]), np.column_stack([weights, amount])
    mesh = AnimatedMesh(
        "actor",
        neutral,
        result.triangles,
        tuple(names),
        targets,
        weights,
        increasing(result.timestamps),
        view_motion(result.head_pose),
    )
    return in_slider_range(mesh)


def with_correctives(mesh: AnimatedMesh, displacements: np.ndarray | Meshes, tolerance: float = 0.2) -> AnimatedMesh:
    """Add displacements to a mesh as further morph targets, within ``tolerance`` mm.

    ``displacements`` is an array (F, V, 3), mm, or a function that returns those of given frames.
    """
    meshes = displacements if callable(displacements) else displacements.__getitem__
    shape, amount = principal_targets(meshes, len(mesh), tolerance)
    names = tuple(f"corrective{k:02d}" for k in range(len(shape)))
    rich = replace(
        mesh,
        target_names=mesh.target_names + names,
        targets=np.concatenate([mesh.targets, shape]),
        weights=np.column_stack([mesh.weights, amount]),
    )
    return in_slider_range(rich)


def in_slider_range(mesh: AnimatedMesh) -> AnimatedMesh:
    """The same motion with weights in [0, 1], the range of the sliders of Blender and USD.

    A target whose weights run from a < 0 to b is scaled by b - a, and its weights are shifted by a. One further target,
    "offset", with weight 1, compensates for what that adds to every frame. Neither the neutral nor the linear interpolation
    between keys changes.
    """
    low = np.minimum(mesh.weights.min(axis=0, initial=0.0), 0.0)
    span = np.maximum(mesh.weights.max(axis=0, initial=0.0) - low, 1.0)
    if not low.any() and (span == 1.0).all():
        return mesh
    offset = np.tensordot(low, mesh.targets, axes=1)
    return replace(
        mesh,
        target_names=(*mesh.target_names, "offset"),
        targets=np.concatenate([mesh.targets * span[:, None, None], offset[None]]),
        weights=np.column_stack([(mesh.weights - low) / span, np.ones(len(mesh))]),
    )


def _rig(result: Result, actor: Actor):
    rig = result.rig(actor)
    rows = [rig.expression_names.index(name) for name in result.expression_names]
    coefficients = np.clip(result.coefficients.astype(float), 0.0, 1.0)  # the residual takes what lies outside
    return list(result.expression_names), rig.neutral, rig.blendshapes[rows], coefficients


def _without(result: Result, neutral: np.ndarray, targets: np.ndarray, weights: np.ndarray) -> Meshes:
    """The part of the final meshes, in the head frame, that the targets leave over."""
    flat = targets.reshape(len(targets), neutral.size)

    def rest(frames: np.ndarray) -> np.ndarray:
        """(f, N, 3) mm of frames (f,)."""
        return result.head_meshes(frames) - neutral - (weights[frames] @ flat).reshape(len(frames), -1, 3)

    return rest


def _projected(rest: Meshes, count: int, correctives: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Orthonormal correctives (K, N, 3) scaled to a largest weight of 1 -> targets (K, N, 3), weights (F, K)."""
    flat = correctives.reshape(len(correctives), -1)
    amount = np.concatenate([rest(frames).reshape(len(frames), -1) @ flat.T for frames in frame_blocks(count)])
    scale = np.maximum(np.abs(amount).max(axis=0), 1e-9)
    return correctives * scale[:, None, None], amount / scale
