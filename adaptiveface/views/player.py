"""Play a performance: play, pause, scrub, loop, speed. The kernel drives, and a slow view skips frames."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable

import ipywidgets as widgets

from .kernel import BackgroundTask, on_main_thread, shown_errors

#: Rate at which the slider follows the playback, per second. A step of it costs the page as much as half a head.
SLIDER_PER_SECOND = 6.0


class Player:
    """Steps through the frames of a performance. Display its ``widget``.

    Set ``longest_step`` to limit the number of frames from one picture to the next. A slow view then plays slower instead of
    skipping more frames.

    Parameters
    ----------
    count : int
        Number of frames.
    on_frame : callable
        ``on_frame(index)`` draws a frame.
    fps : float
        Frames per second at normal speed.
    """

    def __init__(self, count: int, on_frame: Callable[[int], None], fps: float = 30.0) -> None:
        self.on_frame, self.fps, self.drawn = on_frame, fps, 0
        self._task = BackgroundTask()
        self._index, self._slider_due = 0, 0.0
        self.longest_step: int | None = None
        self.button = widgets.ToggleButton(False, description="play", icon="play", layout=widgets.Layout(width="90px"))
        self.button.add_class("adaptiveface-play")
        self.slider = widgets.IntSlider(
            0, min=0, max=max(count - 1, 0), description="frame", layout=widgets.Layout(width="360px")
        )
        self.slider.add_class("adaptiveface-frame")
        self.loop = widgets.Checkbox(True, description="loop", indent=False, layout=widgets.Layout(width="60px"))
        self.speed = widgets.Dropdown(
            options=[("0.1 x", 0.1), ("0.25 x", 0.25), ("0.5 x", 0.5), ("1 x", 1.0), ("2 x", 2.0)],
            value=1.0,
            layout=widgets.Layout(width="80px"),
        )
        self.status = widgets.HTML()
        self.status.add_class("adaptiveface-status")
        self._draw_on_main = on_main_thread(self._draw)
        self.slider.observe(lambda _: self._moved(), "value")
        toggle = on_main_thread(lambda: self.play() if self.button.value else self.pause())

        def pressed(_change) -> None:
            self._label()
            toggle()

        self.button.observe(pressed, "value")
        self.widget = widgets.HBox(
            [self.button, self.slider, self.loop, self.speed, self.status], layout=widgets.Layout(flex_flow="row wrap")
        )

    @property
    def index(self) -> int:
        """The frame that is shown."""
        return self._index

    def go_to(self, index: int) -> None:
        """Show a frame."""
        self.slider.value = index
        self._moved()  # the slider may have this value already, because it lags behind the playback

    def _moved(self) -> None:
        """React to a slider that was not moved by the playback."""
        if self.slider.value != self._index:
            self._index = self.slider.value
            self._draw_on_main()

    def play(self) -> None:
        """Start. A running event loop is needed, as in a notebook."""
        if not self._task.running:
            self._task.start(self._run())
            self.button.value = True

    def pause(self) -> None:
        """Stop at the current frame."""
        self.button.value = False
        self._task.stop()

    close = pause

    def _label(self) -> None:
        """Label the button with what it will do."""
        self.button.description = self.button.icon = "pause" if self.button.value else "play"

    def _draw(self) -> None:
        with shown_errors(lambda text: setattr(self.status, "value", text)):
            self.on_frame(self._index)
            self.drawn += 1

    async def _run(self) -> None:
        """Play, and skip frames if drawing is slower than the performance."""
        begin, first, drawn, position = time.perf_counter(), self._index, self.drawn, self._index
        if first >= self.slider.max:
            first = position = 0
        shown, speed = None, self.speed.value
        try:
            while True:
                if speed != self.speed.value or (shown is not None and self._index != shown):
                    begin, first, speed = time.perf_counter(), self._index, self.speed.value  # the slider was moved by hand
                position = first + int((time.perf_counter() - begin) * self.fps * speed)
                if shown is not None and self.longest_step is not None and position > shown + self.longest_step:
                    begin, first = time.perf_counter(), shown + self.longest_step
                    position = first
                if position > self.slider.max:
                    if shown != self.slider.max:  # the last frame is shown even if a slow view skipped it
                        self._step_to(self.slider.max)
                    if not self.loop.value:
                        return
                    begin, first, position = time.perf_counter(), 0, 0
                if position != shown:
                    self._step_to(position)
                    shown = position
                    if (self.drawn - drawn) % 15 == 0:
                        self._report(begin, first, drawn)
                await asyncio.sleep(0.004)  # gives sliders and other tasks their turn
        finally:
            self.slider.value = self._index
            task = asyncio.current_task()
            if task is None or not task.cancelling():  # a cancelled one may have a successor, to which the button belongs
                self.button.value = False

    def _step_to(self, position: int) -> None:
        self._index, now = position, time.perf_counter()
        if now >= self._slider_due:
            self.slider.value = position
            self._slider_due = now + 1 / SLIDER_PER_SECOND
        self._draw()

    def _report(self, begin: float, first: int, drawn: int) -> None:
        now = time.perf_counter()
        last, self._last = getattr(self, "_last", None), (now, self.drawn)
        if last and self.drawn > last[1]:
            self.status.value = f"{(self.drawn - last[1]) / max(now - last[0], 1e-9):.0f} pictures/s"
