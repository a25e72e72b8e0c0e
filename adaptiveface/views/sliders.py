"""Make sliders over exact numbers. Every slider for a number with decimals is made here.

A FloatSlider divides its range into steps from the lower end. When it is shown, the browser rounds the value to those
steps, in percentages of the range, and sends the result back: 2.5 on steps of 10 becomes 0, and 20 becomes
19.999999999999996. A :class:`ValueSlider` holds a list of numbers, and the browser only ever sends a position in it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path

import anywidget
import ipywidgets as widgets
import numpy as np
import traitlets

#: Approximate number of steps of a linear slider, and per decade of a logarithmic one.
LINEAR_STEPS, STEPS_PER_DECADE = 200, 10


class ValueSlider(widgets.SelectionSlider):
    """A slider over a list of numbers. If ``value`` is set to a number between them, it becomes another step."""

    def __init__(self, values: Iterable[float], value: float, **options) -> None:
        value = float(value)
        super().__init__(options=_labelled([*values, value]), value=value, **options)
        self.add_class(f"adaptiveface-number-{self.model_id}")  # by this class TypedNumbers finds it

    @property
    def numbers(self) -> tuple[float, ...]:
        """All steps in ascending order."""
        return tuple(number for _, number in self.options)

    @traitlets.validate("value")
    def _validate_value(self, proposal) -> float:
        value = float(proposal["value"])
        if not math.isfinite(value):
            raise traitlets.TraitError(f"{self.description}: {value} is not a finite number")
        if value not in self._options_values:
            current = self.value
            self._initializing_traits_ = True  # otherwise ipywidgets selects the first step
            try:
                self.options = _labelled([*self._options_values, value])
            finally:
                self._initializing_traits_ = False
            self.index = self._options_values.index(current)
        return value


class TypedNumbers(anywidget.AnyWidget):
    """Makes the numbers beside ``sliders`` editable. For a number beyond an end, the slider goes to that end.

    This widget is invisible. It must be in the box of class ``adaptiveface-numbers`` that holds the sliders.
    """

    _esm = Path(__file__).resolve().parents[1] / "assets" / "typed_numbers.js"

    def __init__(self, sliders: Iterable[widgets.Widget]) -> None:
        super().__init__(layout=widgets.Layout(display="none"))
        self._sliders = {slider.model_id: slider for slider in sliders if isinstance(slider, ValueSlider)}
        self.on_msg(lambda _, content, buffers: self.type(content.get("slider"), content.get("text")))

    def type(self, slider: str | None, text: str | None) -> None:
        """React to ``text`` that was typed beside the slider with this model id. Text that is no number changes nothing."""
        try:
            number = float(str(text).replace("\u2212", "-").replace(",", "."))
        except ValueError:
            return
        chosen = self._sliders.get(slider)
        if chosen is not None and math.isfinite(number):
            chosen.value = min(max(number, chosen.numbers[0]), chosen.numbers[-1])


def linear_steps(low: float, high: float, step: float | None = None) -> list[float]:
    """Return the multiples of ``step`` from ``low`` to ``high`` and both ends.

    The default step is a round number of about 1/200 of the range.
    """
    step = step or _round_up((high - low) / LINEAR_STEPS)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return sorted({float(low), float(high), *(float(f"{k * step:.12g}") for k in range(first, last + 1))})


def log_steps(low: float, high: float, known: Iterable[float] = ()) -> list[float]:
    """Return ten steps per decade from ``low`` to ``high`` and both ends.

    If zero is allowed, it comes first. The decades then begin at 0.001, or at a tenth of the least ``known`` value.
    """
    bottom = low if low > 0 else min([1e-3, *(0.1 * k for k in known if k > 0)])
    first, last = np.log10(bottom), np.log10(high)
    steps = {float(f"{10**e:.3g}") for e in np.linspace(first, last, round(STEPS_PER_DECADE * (last - first)) + 1)}
    return sorted({float(low), float(high), *(s for s in steps if low <= s <= high)})


def _round_up(step: float) -> float:
    """The next larger number of 1, 2, 5, 10, 20, 50, ... and their decimal fractions."""
    decade = 10.0 ** math.floor(math.log10(step))
    return next(float(f"{k * decade:.12g}") for k in (1, 2, 5, 10) if k * decade >= step * (1 - 1e-9))


def _labelled(numbers: Iterable[float]) -> list[tuple[str, float]]:
    return [(short(number), number) for number in sorted({float(number) for number in numbers})]


def short(value) -> str:
    """Write a value with six digits, or with all of its digits if there are more."""
    if not isinstance(value, float):
        return str(value)
    return f"{value:g}" if float(f"{value:g}") == value else f"{value:.12g}"
