"""Let a user's own avatar perform: copy its file, and add an animation."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import ParameterError
from ..files import check_no_input
from ..formats import UNITS
from ..formats.gltf.container import extensions
from ..formats.gltf.edit import GltfEdit
from ..formats.gltf.file import GltfFile
from ..formats.gltf.nodes import Nodes
from ..retargeting.character import Character
from ..retargeting.face_rig import FaceRig, face_rig
from ..retargeting.gltf_character import OpenFace, open_face, rest_weights
from ..retargeting.retarget import Performance
from ..runtime.timing import increasing
from .avatar_motion import avatar_motion, local_rotation

#: Name of the animation that is added. It gets a number if the file already has one of that name.
ANIMATION = "performance"


class Avatar:
    """A .glb, .gltf or .vrm file that can perform.

    ``character`` is its face. It has no vertices, and its notes say why, if the meshes are compressed and the library that
    opens them is not installed. Raises :class:`FileFormatError` for a malformed file, or one in which curves can drive nothing.
    """

    def __init__(self, path: str | Path, unit: float | None = None) -> None:
        self.unit = UNITS["m"] if unit is None else unit
        self.file = GltfFile(Path(path))
        self.face: OpenFace | None = None
        with self.file.errors():
            self.rig: FaceRig = face_rig(self.file)
            self.nodes = Nodes(self.file)
            closed = self.file.compressed.obstacle()
            if closed is None:
                self.face = open_face(self.file, self.nodes, self.rig, self.unit)
                self.character = self.face.character
            else:
                self.character = self._closed(closed)

    def _closed(self, reason: str) -> Character:
        note = f"{self.file.path}: its meshes are passed on unopened; it {reason}"
        names = tuple(expression.name for expression in self.rig.expressions)
        return Character(
            self.file.path.stem,
            np.zeros((0, 3)),
            np.zeros((0, 3), np.int32),
            names,
            np.zeros((len(names), 0, 3)),
            notes=(*self.rig.notes, note),
            mix=np.array([e.row for e in self.rig.expressions]),
            parts=self.rig.parts,
        )

    def write(self, out: Path, performance: Performance) -> list[str]:
        """Write the file with the performance added, whole or not at all.

        Parameters
        ----------
        out : Path
            The file to write. Its suffix is .glb, .gltf or, for a VRM file, .vrm.
        performance : Performance
            What the avatar performs.

        Returns
        -------
        list of str
            Notes about what does not move, and why.

        Raises
        ------
        ParameterError
            The name has another suffix.
        AdaptiveFaceError
            The name is the avatar's own file, or the file cannot be written.
        """
        self._check(Path(out))
        with self.file.errors():
            edit = GltfEdit(self.file, out)
            faces = [n for n in self.nodes.shown if self.rig.driven_targets(self.nodes.entries[n].get("mesh", -1))]
            if not faces:
                raise self.file.error("the meshes of its scene have no morph targets that a curve could drive")
            motion = avatar_motion(self.file, self.nodes, self.face, set(faces), performance, self.unit)
            activations = self.rig.activations(performance.curves)
            tracks = [(node, "weights", self._weights(node, activations)) for node in faces] + motion.tracks
            for node, _, _ in motion.tracks:
                self._movable(edit.document["nodes"][node], node)
            before = [animation.get("name") for animation in self.file.items("animations")]
            name = next(n for n in (ANIMATION, *(f"{ANIMATION} {k}" for k in range(2, len(before) + 3))) if n not in before)
            edit.add_animation(name, increasing(performance.timestamps), tracks)
        edit.save()
        kept = [f"its {len(before)} animations are kept; the last one, '{name}', is new"] if before else []
        return motion.notes + edit.notes + kept

    def _weights(self, node: int, activations: np.ndarray) -> np.ndarray:
        rest = rest_weights(self.file, self.nodes, self.rig, node)
        return self.rig.target_weights(self.nodes.entries[node]["mesh"], activations, rest)

    def _movable(self, entry: dict, node: int) -> None:
        """Split a node's matrix into translation, rotation and scale: a node that moves may not have a matrix (glTF 3.11)."""
        if entry.pop("matrix", None) is None:
            return
        from scipy.spatial.transform import Rotation

        local, turn = self.nodes.local[node], local_rotation(self.nodes, node)
        entry["translation"] = local[:3, 3].tolist()
        entry["rotation"] = Rotation.from_matrix(turn).as_quat().tolist()
        entry["scale"] = np.diag(turn.T @ local[:3, :3]).tolist()

    def _check(self, out: Path) -> None:
        suffix = out.suffix.lower()
        vrm = {"VRM", "VRMC_vrm"} & extensions(self.file.document).keys()
        if suffix not in (".glb", ".gltf", ".vrm") or suffix == ".vrm" and not vrm:
            what = ".glb, .gltf or .vrm" if vrm else ".glb or .gltf"
            raise ParameterError(f"{out}: with the character {self.file.path.name} the output's name must end in {what}")
        check_no_input(out, [self.file.path])
