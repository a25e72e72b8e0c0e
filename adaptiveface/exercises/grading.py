"""How a learner's function is judged: random cases, the exact answer, and a list of mistakes known by their answers.

A mistake is recognised by doing it: the grader computes what each known mistake would answer and compares. What matches
no mistake is described by its properties (shape, bounds, orthonormality) and by its distance to the exact answer.
"""

from __future__ import annotations

import copy
import functools
import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import ParameterError
from ..parameters import Parameters
from ..tracking.stages import Stages
from .calling import TIME_LIMIT, OutOfTime, call, where
from .trial import Trial, run_trial

#: Letters in a line of a message: JupyterLab breaks longer lines within words.
LINE = 100

#: Keyword arguments of one call of the learner's function.
Case = dict[str, Any]


def drawn(seed: int, count: int) -> Callable[[Callable[[np.random.Generator, int], Case]], Callable[[], list[Case]]]:
    """Decorator: a function that draws case ``number`` becomes one that draws ``count`` of them, always the same."""

    def decorate(draw: Callable[[np.random.Generator, int], Case]) -> Callable[[], list[Case]]:
        @functools.wraps(draw)
        def cases() -> list[Case]:
            rng = np.random.default_rng(seed)
            return [draw(rng, number) for number in range(count)]

        del cases.__wrapped__  # it is called without arguments
        return cases

    return decorate


class Wrong(Exception):
    """An answer that cannot be compared at all; its text says why, in words for the learner."""


@dataclass(frozen=True)
class Mistake:
    """A mistake people make: what to say, and the answer it gives in a case."""

    words: str
    answer: Callable[..., Any]


def switched(function: Callable[..., Any]) -> Callable[..., Callable[..., Any]]:
    """Makes the mistakes of a ``function`` that goes wrong by its keywords: ``by(half=True)`` answers as it does with them."""
    return functools.partial(functools.partial, function)


@dataclass(frozen=True)
class Grade:
    """``findings``: what is wrong, in words (none: right); ``cases``: how many were run; ``started``: not a stub."""

    exercise: str
    findings: tuple[str, ...]
    cases: int
    started: bool = True

    @property
    def passed(self) -> bool:
        """Whether nothing is wrong."""
        return not self.findings

    def __str__(self) -> str:
        if self.passed:
            return f"{self.exercise}: right on all {self.cases} random cases."
        findings = (
            textwrap.fill(finding, LINE, initial_indent="  - ", subsequent_indent="    ", break_long_words=False)
            for finding in self.findings
        )
        return "\n".join([f"{self.exercise}: not yet.", *findings])

    __repr__ = __str__


@dataclass(frozen=True)
class Report:
    """The grade and, for a function that passed, the tracker's run with it."""

    grade: Grade
    trial: Trial | None = None

    @property
    def passed(self) -> bool:
        """Right on the random cases, and the tracker follows the face with it."""
        return self.grade.passed and (self.trial is None or self.trial.passed)

    def __str__(self) -> str:
        return "\n".join(str(part) for part in (self.grade, self.trial) if part is not None)

    __repr__ = __str__


@dataclass(frozen=True)
class Exercise:
    """One exercise: its words for the learner, and the package's side, which grades an answer.

    Attributes
    ----------
    name : str
        Of the function that the learner writes.
    notebook : str
        Where the exercise is set.
    task : str
        The function's signature, its arrays with their shapes, and what it returns.
    hints : tuple of str
        Three steps, of which only the last one holds a formula.
    mistakes : tuple of Mistake
        Wrong answers that are recognised.
    cases : callable
        Makes the random cases.
    truth : callable
        ``truth(**case)`` is the exact answer.
    parse : callable
        ``parse(answer, case)`` brings an answer to a comparable form or raises :class:`Wrong`.
    near : callable
        ``near(a, b, case)`` tells whether two parsed answers are the same.
    describe : callable
        ``describe(answer, truth, case)`` says how far an unknown wrong answer is off.
    make_stages : callable or None
        ``make_stages(function)``: the tracker's stages, one of which calls the function. None where no stage does.
    faults : callable
        ``faults(answer, case)`` names broken properties.
    parameters : Parameters or None
        With which the tracker runs on the function; our defaults where it is None.
    iterative : bool
        Whether people solve it by iterations, which may diverge.
    limit : float
        Seconds that one call may take.
    """

    name: str
    notebook: str
    task: str
    hints: tuple[str, str, str]
    mistakes: tuple[Mistake, ...]
    cases: Callable[[], list[Case]]
    truth: Callable[..., Any]
    parse: Callable[[Any, Case], Any]
    near: Callable[[Any, Any, Case], bool]
    describe: Callable[[Any, Any, Case], str] = lambda answer, truth, case: scale_hint(answer, truth)
    make_stages: Callable[[Callable], Stages] | None = None
    faults: Callable[[Any, Case], list[str]] = lambda answer, case: []
    parameters: Parameters | None = None
    iterative: bool = False
    limit: float = TIME_LIMIT

    def hint(self, step: int = 1) -> str:
        """A hint, ``step`` 1, 2 or 3: where to look, what to do, and the formula."""
        if step not in (1, 2, 3):
            raise ParameterError(f"hint({step!r}): the hints of {self.name} are numbered 1, 2 and 3")
        return _Words(textwrap.fill(f"Hint {step} of 3: {self.hints[step - 1]}", LINE, break_long_words=False))

    def grade(self, function: Callable) -> Grade:
        """Run ``function`` on the random cases and say what is wrong; never raises for what the function does."""
        cases = self.cases()
        answers, findings = [], []
        for number, case in enumerate(cases):
            try:
                answers.append(self._answer(function, case))
            except _NotStarted:
                return Grade(self.name, (f"nothing was returned: write the function's body. {self.task}",), len(cases), False)
            except Wrong as wrong:
                text = str(wrong)
                if self.iterative and "NaN or infinite" in text:
                    text += ": the iteration diverges, its values grow until they are no numbers any more"
                return Grade(self.name, (f"{text} (case {number + 1} of {len(cases)})",), len(cases))
            except OutOfTime as slow:
                text = f"{slow} (case {number + 1} of {len(cases)}): does its loop end? {_SLOW}"
                return Grade(self.name, (text,), len(cases))
            except Exception as error:  # noqa: BLE001 - whatever the learner's code raises is a finding
                place = where(error, function)
                text = f"it raised {type(error).__name__}: {error}{place} (case {number + 1} of {len(cases)})"
                return Grade(self.name, (text,), len(cases))
        truths = [self.parse(self.truth(**case), case) for case in cases]
        if self.iterative and any(map(_far_too_large, answers, truths)):
            findings.append("the iteration diverges: its values are thousands of times too large; is the step too long?")
        for answer, case in zip(answers, cases, strict=True):
            findings += [] if findings else self.faults(answer, case)
            if findings:
                break
        right = [self.near(a, t, c) for a, t, c in zip(answers, truths, cases, strict=True)]
        if not all(right):
            findings += [self._recognised(answers, truths, cases) or self._unknown(answers, truths, cases, right)]
        return Grade(self.name, tuple(findings), len(cases))

    def _answer(self, function: Callable, case: Case) -> Any:
        """The parsed answer; a copy of the case goes in, so that a function that changes its inputs is found out."""
        given = copy.deepcopy(case)
        answer = call(function, given, self.limit)
        if answer is None:
            raise _NotStarted
        if not _same(given, case):
            raise Wrong("it writes into its input arrays: the tracker still needs them, work on copies")
        return self.parse(answer, case)

    def _recognised(self, answers, truths, cases) -> str | None:
        """The words of the first known mistake that gives these answers in every case."""
        for mistake in self.mistakes:
            try:
                with np.errstate(all="ignore"):
                    made = [self.parse(mistake.answer(**case), case) for case in cases]
            except Wrong:  # this mistake gives no numbers here
                continue
            if all(self.near(m, t, c) for m, t, c in zip(made, truths, cases, strict=True)):
                continue
            if all(self.near(a, m, c) for a, m, c in zip(answers, made, cases, strict=True)):
                return mistake.words
        return None

    def _unknown(self, answers, truths, cases, right: list[bool]) -> str:
        first = right.index(False)
        count = f"wrong in {right.count(False)} of {len(cases)} cases"
        return f"{count}; case {first + 1}: {self.describe(answers[first], truths[first], cases[first])}"

    def stages(self, function: Callable) -> Stages:
        """Stages for a tracker that calls ``function`` instead of the package's own: ``FaceTracker(actor, stages=...)``."""
        if self.make_stages is None:
            raise ParameterError(f"{self.name}: the tracker calls no such function")
        return self.make_stages(function)

    def track(self, function: Callable, images=None, actor=None, parameters=None, frames: int = 16) -> Trial:
        """Track ``frames`` frames with ``function`` and with the package's own, and compare.

        ``images`` (list of :class:`~adaptiveface.geometry.frame.RgbdFrame`) of ``actor``: a built-in performance when None.
        ``parameters``: those of the exercise when None.
        """
        return run_trial(self.stages(function), images, actor, parameters or self.parameters, frames)

    def check(self, function: Callable, **options) -> Report:
        """Grade ``function`` and, if it is right, track with it (``options`` as in :meth:`track`)."""
        grade = self.grade(function)
        return Report(grade, self.track(function, **options) if grade.passed and self.make_stages else None)


#: Said of a function that takes too long.
_SLOW = "A correct answer takes milliseconds; whole arrays at once are faster than loops over their entries."


class _Words(str):
    """A text that a notebook shows without quotes."""

    __repr__ = str.__str__


def _far_too_large(answer: Any, truth: Any) -> bool:
    if not (isinstance(answer, np.ndarray) and isinstance(truth, np.ndarray)):
        return False
    return bool(np.abs(answer).max(initial=0.0) > 1e3 * max(np.abs(truth).max(initial=0.0), 1e-3))


class _NotStarted(Exception):
    """The function returned None."""


def _same(a: Case, b: Case) -> bool:
    return all(_equal(a[key], b[key]) for key in b)


def _equal(a: Any, b: Any) -> bool:
    if hasattr(b, "__dataclass_fields__"):
        return all(_equal(getattr(a, name), getattr(b, name)) for name in b.__dataclass_fields__)
    return np.array_equal(a, b)


def as_array(answer: Any, shape: tuple[int, ...], what: str) -> np.ndarray:
    """``answer`` as a float array of ``shape``; raises :class:`Wrong` for a wrong shape or values not finite."""
    try:
        array = np.asarray(answer, float)
    except (TypeError, ValueError):
        raise Wrong(f"{what} is not an array of numbers but {type(answer).__name__}") from None
    if array.shape != shape:
        raise Wrong(f"{what} has the wrong shape {array.shape}: {shape} is expected{_shape_hint(array.shape, shape)}")
    if not np.isfinite(array).all():
        raise Wrong(f"{what} holds NaN or infinite values")
    return array


def _shape_hint(given: tuple[int, ...], expected: tuple[int, ...]) -> str:
    if len(given) == 2 and given == expected[::-1]:
        return " (a transpose?)"
    if np.prod(given, initial=1) == np.prod(expected, initial=1):
        return " (the number of values is right: reshape it)"
    return ""


def scale_hint(answer: np.ndarray, truth: np.ndarray) -> str:
    """How a wrong array relates to the right one: a factor, a sign, or only its relative distance."""
    size = float(np.linalg.norm(truth)) or 1.0
    factor = float(np.vdot(answer, truth)) / size**2
    if factor and np.linalg.norm(answer - factor * truth) < 1e-6 * np.linalg.norm(answer):
        what = "the sign and a constant factor are" if factor < 0 else "a constant factor is"
        return f"it is the right answer times {factor:.4g}: {what} wrong"
    return f"off by {np.linalg.norm(answer - truth) / size:.1%} of the right answer's size"
