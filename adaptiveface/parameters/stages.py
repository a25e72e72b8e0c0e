"""The machinery of the parameters: documented fields that check themselves, in stages, in a set; the data is beside it."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import dataclass, field, fields
from typing import Any, Self

from ..errors import ParameterError
from ..renamed import OLD_NAMES, warn


def parameter(
    default, doc: str, *, unit: str = "", section: str = "", low=None, high=None, log=False, choices=(), paper=None, live=None
):
    """A dataclass field with its documentation and range (``low`` to ``high``, ``log`` slider).

    ``paper`` is the paper's value, and ``live`` the one for live tracking, if they differ from the default.
    """
    limits = dict(low=low, high=high, log=log, choices=tuple(choices))
    return field(default=default, metadata=dict(doc=doc, unit=unit, section=section, **limits, paper=paper, live=live))


@dataclass(frozen=True)
class Stage:
    """Checks every field of a stage against its type and range. ``stage``: its name in the set."""

    stage = ""

    def __post_init__(self) -> None:
        for entry in fields(self):
            object.__setattr__(self, entry.name, _checked(self.stage, entry, getattr(self, entry.name)))


def _checked(stage: str, entry: dataclasses.Field, value: Any) -> Any:
    kind: type[Any] = type(entry.default)
    meta, name = entry.metadata, f"{stage}.{entry.name}"
    if isinstance(value, str) and kind is not str:
        value = _parse(name, kind, value)
    if kind is bool:
        if not isinstance(value, bool):
            raise ParameterError(f"{name} = {value!r}: true or false is expected")
        return value
    if kind is str:
        if meta["choices"] and value not in meta["choices"]:
            raise ParameterError(f"{name} = {value!r}: one of {', '.join(meta['choices'])} is expected")
        return value
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ParameterError(f"{name} = {value!r}: a finite number is expected")
    if kind is int and value != int(value):
        raise ParameterError(f"{name} = {value!r}: a whole number is expected")
    low, high = meta["low"], meta["high"]
    if (low is not None and value < low) or (high is not None and value > high):
        raise ParameterError(f"{name} = {value!r} is outside its range {low} to {high} {meta['unit']}".rstrip())
    return kind(value)


def stage_class(entry: dataclasses.Field) -> type[Stage]:
    """The stage's class, which makes a set's field."""
    assert isinstance(entry.default_factory, type)
    return entry.default_factory


def _parse(name: str, kind: type, text: str) -> Any:
    if kind is bool:
        if text.lower() in ("true", "1", "yes", "on"):
            return True
        if text.lower() in ("false", "0", "no", "off"):
            return False
        raise ParameterError(f"{name} = {text!r}: true or false is expected")
    try:
        return float(text)
    except ValueError:
        raise ParameterError(f"{name} = {text!r}: a number is expected") from None


@dataclass(frozen=True)
class StageSet:
    """Stages by name; a frozen dataclass whose fields are made by subclasses of :class:`Stage`."""

    @classmethod
    def paper(cls) -> Self:
        """The paper's literal values wherever a field names one."""
        return cls._of("paper")

    @classmethod
    def live(cls) -> Self:
        """The defaults of live tracking: those of all tracking, but for what lowers the latency and costs no accuracy."""
        return cls._of("live")

    @classmethod
    def _of(cls, use: str) -> Self:
        """The values of the fields for a ``use``, which their metadata names."""
        stages = {}
        for stage in fields(cls):
            kind = stage_class(stage)
            stages[stage.name] = kind(**{f.name: f.metadata[use] for f in fields(kind) if f.metadata[use] is not None})
        return cls(**stages)

    def set(self, **values: Any) -> Self:
        """The earlier name of :meth:`replace`; it works for one more version, with a ``DeprecationWarning``."""
        warn(f"{type(self).__name__}.set", "replace")
        return self.replace(**values)

    def replace(self, **values: Any) -> Self:
        """A copy with fields changed, named ``stage__name`` or passed as ``**{"stage.name": value}``.

        Raises :class:`ParameterError` for an unknown name or a value outside its range.
        """
        stages: dict[str, dict[str, Any]] = {}
        known = {s.name: [f.name for f in fields(getattr(self, s.name))] for s in fields(self)}
        for key, value in values.items():
            stage, _, name = (current := self.current_name(key)).partition(".")
            if stage not in known:
                raise ParameterError(f"unknown stage '{stage}' in '{key}'; stages: {', '.join(known)}")
            if name not in known[stage]:
                raise ParameterError(f"unknown parameter '{key}'; {stage} has: {', '.join(known[stage])}")
            if current != key.replace("__", "."):
                warn(key, current)
            stages.setdefault(stage, {})[name] = value
        return dataclasses.replace(self, **{s: dataclasses.replace(getattr(self, s), **v) for s, v in stages.items()})

    def diff(self, other: Self) -> dict[str, tuple[Any, Any]]:
        """What differs from another set: ``{"laplacian.w2": (value here, value there)}``."""
        return {
            f"{stage.name}.{entry.name}": (here, there)
            for stage in fields(self)
            for entry in fields(getattr(self, stage.name))
            if (here := getattr(getattr(self, stage.name), entry.name))
            != (there := getattr(getattr(other, stage.name), entry.name))
        }

    def to_json(self) -> str:
        """JSON of every parameter, by stage."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Self:
        """The inverse of :meth:`to_json`; raises :class:`ParameterError`."""
        stages = cls.stored(text)
        return cls().replace(**{f"{stage}.{name}": value for stage, values in stages.items() for name, value in values.items()})

    @classmethod
    def current_name(cls, name: str) -> str:
        """Today's "stage.name" of a parameter, also named ``stage__name`` or as an earlier version called it."""
        stage, _, old = name.replace("__", ".").partition(".")
        kinds = {entry.name: stage_class(entry).__name__ for entry in fields(cls)}
        return f"{stage}.{OLD_NAMES.get(kinds.get(stage, ''), {}).get(old, old)}"

    @classmethod
    def stored(cls, text: str) -> dict[str, dict[str, Any]]:
        """The values in a JSON of :meth:`to_json` by stage and name, unchecked; raises :class:`ParameterError`.

        Names of an earlier version are today's here.
        """
        try:
            stages = json.loads(text)
            return {
                stage: {cls.current_name(f"{stage}.{name}").partition(".")[2]: value for name, value in values.items()}
                for stage, values in stages.items()
            }
        except (json.JSONDecodeError, AttributeError) as error:
            raise ParameterError(f"not a JSON object of parameters: {error}") from None

    @classmethod
    def rows(cls) -> list[dict[str, Any]]:
        """One row per parameter: stage, name, default and the field's documentation."""
        stages = [(stage.name, entry) for stage in fields(cls) for entry in fields(stage_class(stage))]
        return [dict(stage=stage, name=entry.name, default=entry.default, **entry.metadata) for stage, entry in stages]
