"""Find out what drives the face of a glTF or VRM file, from its JSON alone.

The curve of an ARKit name drives the morph targets of that name. VRM's expressions also take part if they have ARKit names
("perfect sync"). VRM's presets (:mod:`adaptiveface.retargeting.vrm_presets`) are driven if no ARKit shape of the file shows
the same.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..formats.gltf.container import GltfContainer, extensions, extras
from .arkit import ARKIT_NAMES, canonical_name
from .shape_names import arkit_row, driven_shapes
from .vrm_presets import preset_name, preset_row

MAX_TARGETS = 2000
MAX_EXPRESSIONS = 1000


@dataclass
class Expression:
    """Morph targets that move together.

    Attributes
    ----------
    name : str
        Name in the file.
    row : (52,)
        Weights of the ARKit curves. All are zero if nothing drives the expression.
    binds : dict
        Weight of each target at full activation, by (mesh, morph target).
    """

    name: str
    row: np.ndarray
    binds: dict[tuple[int, int], float] = field(default_factory=dict)

    @property
    def driven(self) -> bool:
        """Whether any curve drives it."""
        return bool(self.row.any())


@dataclass
class FaceRig:
    """The E expressions of a file.

    Attributes
    ----------
    expressions : list of Expression
        All of them, driven or not.
    counts : dict
        Number of morph targets by mesh.
    notes : list of str
        What stays at rest and why, one line each.
    empty : set
        (mesh, morph target) of targets that move nothing.
    """

    expressions: list[Expression]
    counts: dict[int, int]
    notes: list[str]
    empty: set[tuple[int, int]]

    def activations(self, curves: np.ndarray) -> np.ndarray:
        """(F, E) weights in [0, 1] of the expressions for ARKit curves (F, 52)."""
        return np.clip(np.asarray(curves, float) @ np.array([e.row for e in self.expressions]).T, 0.0, 1.0)

    @property
    def parts(self) -> tuple[str, ...]:
        """Names of undriven expressions whose targets belong to driven ones, or move nothing."""
        moved = {bind for e in self.expressions if e.driven for bind in e.binds} | self.empty
        return tuple(e.name for e in self.expressions if not e.driven and moved & e.binds.keys())

    def driven_targets(self, mesh: int) -> list[int]:
        """Morph targets of a mesh that a curve drives."""
        return sorted({target for e in self.expressions if e.driven for m, target in e.binds if m == mesh})

    def target_weights(self, mesh: int, activations: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """(F, T) weights of a mesh's morph targets for ``activations`` (F, E). Undriven ones keep ``rest`` (T,)."""
        mixture = np.zeros((len(self.expressions), self.counts[mesh]))
        for row, expression in zip(mixture, self.expressions, strict=True):
            for (number, target), weight in expression.binds.items() if expression.driven else ():
                if number == mesh:
                    row[target] += weight
        out = activations @ mixture
        still = np.setdiff1d(np.arange(self.counts[mesh]), self.driven_targets(mesh))
        out[:, still] = rest[still]
        return out


def face_rig(file: GltfContainer) -> FaceRig:
    """Read the rig of a file.

    Raises :class:`FileFormatError` if the file has no morph targets, or none that a curve could drive.
    """
    names = {mesh: target_names(file, entry) for mesh, entry in enumerate(file.items("meshes"))}
    counts = {mesh: len(listed) for mesh, listed in names.items() if listed}
    if not counts:
        raise file.error("no mesh has morph targets; export it with its shape keys (blend shapes)")
    expressions: dict[str, Expression] = {}
    notes: dict[str, None] = {}
    empty = {(mesh, target) for mesh in counts for target in range(counts[mesh]) if _moves_nothing(file, mesh, target)}
    for mesh in counts:
        live = [target for target in range(counts[mesh]) if (mesh, target) not in empty]
        chosen, said = driven_shapes([names[mesh][target] for target in live])
        rows: dict[int, np.ndarray | None] = {live[number]: row for number, row in chosen.items()}
        rows |= {target: arkit_row(names[mesh][target]) for m, target in empty if m == mesh}
        notes |= dict.fromkeys(said)
        for target, name in enumerate(names[mesh]):
            _add(expressions, name, rows.get(target), (mesh, target))
    hollow = [e.name for e in expressions.values() if e.driven and e.binds.keys() <= empty]
    if hollow:
        notes[f"move nothing in this file: {', '.join(hollow)}"] = None
    _add_vrm(file, expressions, notes, counts, empty)
    if not any(expression.driven for expression in expressions.values()):
        some = ", ".join(list(dict.fromkeys(name for mesh in counts for name in names[mesh]))[:8])[:200]
        raise file.error(
            f"no morph target has an ARKit name such as jawOpen, and there is no VRM preset such as aa (targets: {some})"
        )
    return FaceRig(list(expressions.values()), counts, list(notes), empty)


def _add(expressions: dict[str, Expression], name: str, row: np.ndarray | None, bind: tuple[int, int]) -> None:
    """Add a morph target to the expression with the same row or, if it is undriven, with the same name."""
    key = f"driven {row.nonzero()[0].tolist()}" if row is not None else name
    expression = expressions.setdefault(key, Expression(name, np.zeros(len(ARKIT_NAMES)) if row is None else row))
    expression.binds[bind] = 1.0
    if expression.name != name:  # halves, or another spelling in another mesh
        expression.name = canonical_name(name) or name


def _moves_nothing(file: GltfContainer, mesh: int, target: int) -> bool:
    """Whether a morph target is a stub. Exporters write stubs for names without a shape."""
    for primitive in file.items("meshes")[mesh]["primitives"]:
        targets = primitive.get("targets") or []
        if target < len(targets) and "POSITION" in targets[target]:
            entry = file.item("accessors", targets[target]["POSITION"])
            bounds = [*(entry.get("min") or [1]), *(entry.get("max") or [1])]
            if ("bufferView" in entry or "sparse" in entry) and any(bounds):
                return False
    return True


def _add_vrm(file: GltfContainer, expressions: dict[str, Expression], notes: dict, counts: dict[int, int], empty: set) -> None:
    """Add VRM's expressions: first those with ARKit names, then presets for movements that no ARKit shape shows."""
    found = vrm_expressions(file)
    shown = (e.row for e in expressions.values() if not e.binds.keys() <= empty)
    covered = sum(shown, np.zeros(len(ARKIT_NAMES)))
    sync = [(name, binds) for name, _, binds in found if canonical_name(name) and _valid(binds, counts)]
    chosen, _ = driven_shapes([name for name, _ in sync])
    before = covered.copy()
    for number, row in chosen.items():
        if not before[row > 0].any():
            name, binds = sync[number]
            expressions[f"expression {name}"] = Expression(name, row, _valid(binds, counts))
            covered += row
    if not found:  # VRoid Studio's targets in a file without its VRM part
        found = [(e.name, preset_name(e.name), e.binds) for e in expressions.values() if e.name.startswith("Fcl_")]
    presets = {preset: (name, _valid(binds, counts)) for name, preset, binds in reversed(found) if preset}
    presets = {preset: entry for preset, entry in presets.items() if entry[1] and not covered[preset_row(preset) > 0].any()}
    halves = {"blinkLeft", "blinkRight"} & presets.keys()
    if "blink" in presets and halves:
        left = ["blink"] if len(halves) == 2 else sorted(halves)
        notes[f"not driven, because the eyes would close twice: {', '.join(presets.pop(p)[0] for p in left)}"] = None
    taken = {expression.name for expression in expressions.values()}
    for preset, (name, binds) in presets.items():
        expressions[f"preset {preset}"] = Expression(preset if name in taken else name, preset_row(preset), binds)
    if presets:
        notes[f"driven as VRM presets: {', '.join(sorted(name for name, _ in presets.values()))}"] = None


def _valid(binds: dict[tuple[int, int], float], counts: dict[int, int]) -> dict[tuple[int, int], float]:
    return {
        (mesh, target): weight
        for (mesh, target), weight in binds.items()
        if 0 <= target < counts.get(mesh, 0) and np.isfinite(weight) and abs(weight) <= 10
    }


def target_names(file: GltfContainer, mesh: dict) -> list[str]:
    """Names of a mesh's morph targets, from the places where exporters write them; [] for a mesh without targets."""
    primitives = mesh["primitives"]
    if not all(isinstance(primitive["attributes"], dict) for primitive in primitives):
        raise file.error("a primitive's attributes are no object")
    count = max((len(p.get("targets") or ()) for p in primitives), default=0)
    if count > MAX_TARGETS:
        raise file.error(f"{count} morph targets; at most {MAX_TARGETS} are read")
    places = [extras(place).get("targetNames") for place in (mesh, *primitives)]
    listed = next((names for names in places if names), None)
    if listed is None:  # each target's own extras, or the name of its accessor
        targets: list[dict] = next((p["targets"] for p in primitives if p.get("targets")), [])
        listed = [extras(target).get("name") or _accessor_name(file, target) for target in targets]
        listed = [name if isinstance(name, str) else f"target{k}" for k, name in enumerate(listed)]
    if not isinstance(listed, list) or not all(isinstance(name, str) and len(name) <= 256 for name in listed):
        raise file.error("extras.targetNames is not a list of short names")
    if count and len(listed) != count:
        raise file.error(f"{len(listed)} target names for {count} morph targets")
    return listed if count else []


def _accessor_name(file: GltfContainer, target: dict):
    return file.item("accessors", target["POSITION"]).get("name") if "POSITION" in target else None


def vrm_expressions(file: GltfContainer) -> list[tuple[str, str | None, dict[tuple[int, int], float]]]:
    """Read the expressions of VRM 0.x and 1.0.

    Each is a tuple of its name, its VRM 1.0 preset or None, and its weights by (mesh, morph target).
    """
    found = []
    groups = _object(extensions(file.document), "VRM", "blendShapeMaster").get("blendShapeGroups") or []
    for group in groups[:MAX_EXPRESSIONS]:
        binds = {(b["mesh"], b["index"]): float(b["weight"]) / 100 for b in group.get("binds") or ()}
        name, preset = str(group.get("name") or ""), str(group.get("presetName") or "")
        known = preset_name(preset if preset.lower() not in ("", "unknown") else name)
        found.append((name or preset, known, binds))
    expressions = _object(extensions(file.document), "VRMC_vrm", "expressions")
    for kind in ("preset", "custom"):
        for name, expression in list(_object(expressions, kind).items())[:MAX_EXPRESSIONS]:
            binds = {}
            for bind in expression.get("morphTargetBinds") or ():
                binds[file.item("nodes", bind["node"]).get("mesh"), bind["index"]] = float(bind["weight"])
            found.append((name, preset_name(name) if kind == "preset" else None, binds))
    return found


def _object(value: dict, *keys: str) -> dict:
    """The object at the end of a path of keys, or {} if there is none."""
    for key in keys:
        below = value.get(key)
        value = below if isinstance(below, dict) else {}
    return value
