"""Measure in a real browser how the notebooks feel: ``python tests/browser/measure.py [live | line]``.

``live``: only the live view; ``line``: only turning and playback, over a line of 100 ms and 20 Mbit/s.

Prints the median time from a slider's movement to the new picture on the page, the pictures per second of a head that is
turned (with an idle and a busy kernel), of a playback that learns, and of the live view.
On synthetic input, with software rendering; the machine's load is printed beside them.
"""

from __future__ import annotations

import math
import os
import statistics
import sys
import tempfile
import time
from pathlib import Path

import lab
from line import slow_line

STEPS, SECONDS = 25, 8.0

#: Moves a slider by one key press and waits for the next picture of the face; returns milliseconds.
_STEP = """async ([slider, key]) => {
  const handle = document.querySelector(slider + ' .noUi-handle'), before = window.loads.face.length;
  handle.focus();
  const start = performance.now();
  handle.dispatchEvent(new KeyboardEvent('keydown', {key, bubbles: true, cancelable: true}));
  while (window.loads.face.length === before && performance.now() - start < 5000) await new Promise(r => setTimeout(r, 1));
  return window.loads.face.length > before ? window.loads.face[before] - start : NaN; }"""


#: Drags the first face for so many milliseconds, a move per screen refresh; returns pictures per second.
_TURN = """async milliseconds => {
  const face = document.querySelector('.adaptiveface-face'), box = face.getBoundingClientRect();
  face.setPointerCapture = () => {};
  const send = (type, x) => face.dispatchEvent(
    new PointerEvent(type, {pointerId: 1, button: 0, clientX: x, clientY: box.y + 100, bubbles: true}));
  const start = performance.now();
  send('pointerdown', box.x + 200);
  window.loads.turned = [];
  for (let k = 0; performance.now() - start < milliseconds; k++) {
    send('pointermove', box.x + 200 + 80 * Math.sin(k / 20));
    await new Promise(requestAnimationFrame);
  }
  send('pointerup', box.x + 200);
  const times = window.loads.turned;
  return (times.length - 1) / (times.at(-1) - times[0]) * 1000; }"""


def slider_to_pixels(page, parameter: str) -> list[float]:
    """Milliseconds from a key press on a slider to the face's new picture, ``STEPS`` times."""
    times = []
    # The last frame, where everything has been learned.
    page.evaluate(_STEP, [".adaptiveface-frame", "End"])
    for step in range(STEPS):
        key = "ArrowLeft" if step % 10 < 5 else "ArrowRight"
        times.append(page.evaluate(_STEP, [f".adaptiveface-{parameter.replace('.', '-')}", key]))
        page.wait_for_timeout(700)  # the background run, too, draws: start from rest
    return times


def playback_rate(page, button: str) -> float:
    """Pictures per second that the browser decodes while the performance plays."""
    page.locator(button).first.click()
    rate = lab.pictures_per_second(page, SECONDS)
    page.locator(".adaptiveface-play").first.click()
    return rate


def rotation_rate(page, busy: bool) -> float:
    """Pictures per second while a pointer drags the face to and fro; ``busy``: the kernel computes all the while."""
    if busy:
        work = "import time, numpy as np; end = time.time() + 8\nwhile time.time() < end: np.linalg.svd(np.ones((300, 300)))"
        page.evaluate(
            "code => { window.jupyterapp.shell.currentWidget.sessionContext.session.kernel.requestExecute({code}); }", work
        )
    rate = page.evaluate(_TURN, 1000 * SECONDS / 2)
    page.wait_for_function("() => window.jupyterapp.shell.currentWidget.sessionContext.session.kernel.status === 'idle'")
    return rate


def live_view(folder: Path, address: str) -> None:
    """The live notebook on the synthetic sensor, with MediaPipe finding the features of every frame beside it."""
    name = "live_sensor.ipynb"
    text = (lab.NOTEBOOKS / name).read_text(encoding="utf-8")
    if text.count("LiveView(SOURCE, ACTOR, ") != 1:
        raise RuntimeError(f"{name}: the view's line has changed")
    (folder / name).write_text(text.replace("LiveView(SOURCE, ACTOR, ", "LiveView(SOURCE, ACTOR, detect=True, "), "utf-8")
    with lab.chromium_page() as page:
        lab.open_notebook(page, address, name)
        started = lab.cell_with(name, "views.LiveView(")
        lab.run_cells(page, started - 1)
        start = time.monotonic()
        lab.run_cells(page, started)
        lab.wait_for_text(page, ".adaptiveface-live-status", "tracking", 180)
        page.evaluate("() => { window.loads.face = []; }")
        page.wait_for_function("() => window.loads.face.length > 0")
        first = time.monotonic() - start
        print(f"{name}: first tracked picture after {first:.1f} s, scan included (load {os.getloadavg()[0]:.1f})", flush=True)
        page.wait_for_timeout(3000)
        rate = lab.pictures_per_second(page, 2 * SECONDS)
        figures = page.locator(".adaptiveface-live-figures").inner_text()
        print(f"{name}: {rate:.1f} pictures/s with MediaPipe beside it (load {os.getloadavg()[0]:.1f}); {figures}", flush=True)
        lab.run_code(page, "view.close()")


def over_a_line(address: str, names) -> None:
    """Turning and playback when the server is 100 ms away, behind 20 Mbit/s."""
    with slow_line(int(address.rpartition(":")[2])) as port:
        for name in names:
            with lab.chromium_page() as page:
                lab.open_notebook(page, f"http://127.0.0.1:{port}", name)
                lab.run_cells(page, lab.cell_with(name, "views.StageExplorer("))
                page.wait_for_timeout(3000)
                turning = rotation_rate(page, busy=True)
                page.wait_for_timeout(1500)
                playing = playback_rate(page, ".adaptiveface-play")
                load = f"load {os.getloadavg()[0]:.1f}"
                print(f"{name} over 100 ms, 20 Mbit/s: rotation {turning:.1f}, playback {playing:.1f} pictures/s ({load})")


def main() -> None:
    names = ("05_laplacian_deformation.ipynb", "06_incremental_pca.ipynb")
    with tempfile.TemporaryDirectory() as folder, lab.jupyter_lab(Path(folder), names) as address:
        if "line" in sys.argv[1:]:
            over_a_line(address, names)
            return
        live_view(Path(folder), address)
        for name, parameter in zip(names, ("laplacian.w2", "adaptive_pca.K"), strict=True):
            if "live" in sys.argv[1:]:
                break
            with lab.chromium_page() as page:
                lab.open_notebook(page, address, name)
                lab.run_cells(page, lab.cell_with(name, "views.StageExplorer("))
                page.wait_for_timeout(3000)
                times = slider_to_pixels(page, parameter)
                same = sum(map(math.isnan, times))  # the picture did not change: nothing was sent
                times = sorted(time for time in times if not math.isnan(time))
                load = f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores"
                print(
                    f"{name}: {parameter} to pixels: median {statistics.median(times):.0f} ms, "
                    f"90th percentile {times[int(0.9 * len(times))]:.0f} ms ({len(times)} steps, {same} without change, {load})"
                )
                for busy, what in ((False, "idle"), (True, "busy")):
                    rate = rotation_rate(page, busy)
                    print(f"{name}: rotation, kernel {what}: {rate:.1f} pictures/s (load {os.getloadavg()[0]:.1f})", flush=True)
                for button, what in (
                    (".adaptiveface-play", "playback"),
                    (".adaptiveface-live", "playback that learns"),
                ):
                    page.wait_for_timeout(1500)
                    rate = playback_rate(page, button)
                    print(f"{name}: {what}: {rate:.1f} pictures/s (load {os.getloadavg()[0]:.1f})", flush=True)


if __name__ == "__main__":
    main()
