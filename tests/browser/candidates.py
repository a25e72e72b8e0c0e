"""Three ways to draw heads in a notebook, side by side: ``python tests/browser/candidates.py``, a table in Markdown.

Ours (three.js or the painter, :mod:`adaptiveface.views.heads`), k3d, and pyvista's client view, each in JupyterLab in a real
browser, with the embedded mesh (7,000 vertices with a value each) in two and in four linked panes and 6,000 points in the last
one. The kernel sends 30 frames a second. Needs ``pip install k3d`` beside the extra ``notebooks``; what is not installed is
passed over, and words choose candidates by name. Software rendering, and what else runs, counts: compare within one run.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import lab

FRAMES, SECONDS, FIRST = 45, 3.0, 120.0

#: Notes when something is drawn on any canvas, once for each task of the page, in every frame of it.
_COUNT = """(() => {
  window.drawnAt = [];
  let open = true;
  const note = () => {
    if (!open) return;
    open = false;
    window.drawnAt.push(Date.now());
    setTimeout(() => { open = true; }, 0);
  };
  const watch = (type, names) => {
    for (const name of type ? names : []) {
      const known = type.prototype[name];
      type.prototype[name] = function (...given) { note(); return known.apply(this, given); };
    }
  };
  const calls = ["drawElements", "drawArrays", "drawElementsInstanced", "drawArraysInstanced"];
  watch(window.WebGLRenderingContext, calls);
  watch(window.WebGL2RenderingContext, calls);
  watch(window.CanvasRenderingContext2D, ["putImageData"]);
})()"""

_START = """
import asyncio, time
import numpy as np
from adaptiveface.model.face_model import embedded_face_model
model = embedded_face_model()
jaw = model.expressions[model.expression_names.index("jawOpen")]
cloud = model.mean[np.linspace(0, len(model.mean) - 1, 6000).astype(int)]
def head(frame, pane):
    share = 0.5 - 0.5 * np.cos(frame / 5 + pane)
    return model.mean + share * jaw, np.linalg.norm(share * jaw, axis=1)
"""

_OURS = """
from adaptiveface.views import FaceView
view = FaceView(model.mean, model.triangles, [str(k) for k in range(PANES)], limits=(0, 20), label="mm", pane=(250, 275))
view._image.renderer = "RENDERER"
def show(frame):
    for pane in range(PANES):
        view.show(pane, *head(frame, pane))
    view.show_points(PANES - 1, cloud, cloud[:, 2])
    view.refresh()
show(0)
"""
_K3D = """
import ipywidgets as widgets, k3d
from k3d.colormaps import matplotlib_color_maps as maps
panes = []
for pane in range(PANES):
    plot = k3d.plot(height=275, grid_visible=False, menu_visibility=False, camera_auto_fit=False, colorbar_object_id=0)
    plot.camera = [0, 0, 420, 0, 0, 0, 0, 1, 0]
    vertices, values = head(0, pane)
    mesh = k3d.mesh(vertices.astype("f4"), model.triangles.astype("u4"), attribute=values.astype("f4"),
                    color_map=maps.Viridis, color_range=[0, 20], flat_shading=False)
    plot += mesh
    panes.append((plot, mesh))
height = cloud[:, 2].astype("f4")
points = k3d.points(cloud.astype("f4"), attribute=height, color_map=maps.Viridis, point_size=1.0, shader="flat")
panes[-1][0].__iadd__(points)
links = [widgets.jslink((panes[0][0], "camera"), (plot, "camera")) for plot, _ in panes[1:]]
box = widgets.HBox([plot for plot, _ in panes])
for plot, _ in panes:
    plot.layout.width = "250px"
def show(frame):
    for pane, (_, mesh) in enumerate(panes):
        vertices, values = head(frame, pane)
        with mesh.hold_sync():
            mesh.vertices, mesh.attribute = vertices.astype("f4"), values.astype("f4")
"""
_PYVISTA = """
import pyvista as pv
plotter = pv.Plotter(shape=(1, PANES), window_size=(250 * PANES, 275), notebook=True)
meshes = []
for pane in range(PANES):
    plotter.subplot(0, pane)
    vertices, values = head(0, pane)
    mesh = pv.PolyData.from_regular_faces(vertices.astype("f4"), model.triangles)
    mesh["mm"] = values.astype("f4")
    plotter.add_mesh(mesh, scalars="mm", clim=(0, 20), smooth_shading=True, show_scalar_bar=False)
    meshes.append(mesh)
cloud_mesh = pv.PolyData(cloud.astype("f4"))
plotter.add_mesh(cloud_mesh, scalars=cloud[:, 2], point_size=3, show_scalar_bar=False)
plotter.link_views()
plotter.view_xy()
def show(frame):
    for pane, mesh in enumerate(meshes):
        vertices, values = head(frame, pane)
        mesh.points[:] = vertices
        mesh["mm"][:] = values
        mesh.GetPoints().Modified(); mesh.GetPointData().GetScalars().Modified(); mesh.Modified()
    viewer.update()
"""
_PLAY = """
for frame in range(1, FRAMES + 1):
    begun = time.perf_counter()
    show(frame)
    await asyncio.sleep(max(0.001, begun + 1 / 30 - time.perf_counter()))
"""
_BUSY = "import time\nend = time.time() + 12\nwhile time.time() < end: np.linalg.svd(np.ones((300, 300)))"


@dataclass(frozen=True)
class Candidate:
    """``make`` prepares in one cell, ``display`` shows in the next; ``page``: an expression that writes a page of its own."""

    name: str
    needs: str
    make: str
    display: str
    page: str = ""


CANDIDATES = (
    Candidate("ours, painter", "anywidget", _OURS.replace("RENDERER", "canvas"), "view.widget"),
    Candidate("ours, three.js", "anywidget", _OURS.replace("RENDERER", "webgl"), "view.widget"),
    Candidate("k3d", "k3d", _K3D, "box", "open('own.html', 'w').write(panes[0][0].get_snapshot())"),
    Candidate(
        "pyvista, client view",
        "trame_vtk",
        _PYVISTA,
        "shown = plotter.show(jupyter_backend='client', return_viewer=True)\n"
        "from trame_pyvista.ui import get_viewer\nviewer = get_viewer(plotter)\nshown",
        "plotter.export_html('own.html')",
    ),
)


@dataclass
class Measured:
    """One row: what is not known stays a dash."""

    name: str
    panes: int
    first: float = float("nan")
    playing: float = float("nan")
    kilobytes: float = float("nan")
    turning: float = float("nan")
    asked: int = -1
    own_page: str = "-"
    nbconvert: str = "-"
    notes: list[str] = field(default_factory=list)


def drawn(page) -> list[float]:
    """ms since 1970 of every picture so far, over all frames of the page."""
    return sorted(time for frame in page.frames for time in frame.evaluate("() => window.drawnAt ?? []"))


def settle(page, seconds: float = 1.5, most: float = 60.0) -> None:
    """Wait until nothing is drawn for a while."""
    end = time.monotonic() + most
    count = -1
    while count != len(drawn(page)) and time.monotonic() < end:
        count = len(drawn(page))
        page.wait_for_timeout(1000 * seconds)


def rate(times: list[float]) -> float:
    """Pictures per second; NaN where too few were counted to tell."""
    return float("nan") if len(times) < 3 else 1000 * (len(times) - 1) / (times[-1] - times[0])


def canvas_of(page):
    """Where the largest canvas is on the page; vtk.js has others far outside."""
    best = None
    for frame in page.frames:
        for canvas in frame.locator("canvas").all():
            box = canvas.bounding_box()
            if box and box["x"] >= 0 and (best is None or box["width"] * box["height"] > best["width"] * best["height"]):
                best = box
    return best


def turn(page, seconds: float) -> tuple[float, float]:
    """Drag on the first pane with the mouse, as fast as the browser takes it: pictures and moves per second."""
    box = canvas_of(page)
    if box is None:
        return float("nan"), 0.0
    x, y = box["x"] + min(120, 0.4 * box["width"]), box["y"] + 0.5 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    start, moves, before = time.monotonic(), 0, time.time() * 1000
    while time.monotonic() - start < seconds:
        moves += 1
        page.mouse.move(x + 50 * ((moves % 40) - 20) / 20, y + (moves % 7))
    spent = time.monotonic() - start
    page.mouse.up()
    settle(page, 1.0, 10.0)  # what was asked for is drawn late on a busy machine
    return rate([t for t in drawn(page) if t > before]), moves / spent


def measure(address: str, folder: Path, candidate: Candidate, panes: int) -> Measured:
    """One candidate with so many panes, in a notebook of its own."""
    import nbformat

    out = Measured(candidate.name, panes)
    name = f"{candidate.name.split(',')[0]}-{candidate.name[-3:]}-{panes}.ipynb"
    cells = [_START, f"PANES, FRAMES = {panes}, {FRAMES}\n{candidate.make}", candidate.display]
    nbformat.write(lab.notebook_of(*cells), folder / name)
    with lab.chromium_page() as page:
        page.context.add_init_script(_COUNT)
        received, outside = [], []
        page.on("websocket", lambda socket: socket.on("framereceived", lambda data: received.append(len(data))))
        page.on("request", lambda r: None if "127.0.0.1" in r.url or "localhost" in r.url else outside.append(r.url))
        lab.open_notebook(page, address, name)
        lab.run_cells(page, 1)
        before = time.time() * 1000
        page.evaluate(
            """() => { const p = window.jupyterapp.shell.currentWidget; p.content.activeCellIndex = 2; p.content.deselectAll();
              window.jupyterapp.commands.execute('notebook:run-cell'); }"""
        )
        end = time.monotonic() + FIRST
        while not [t for t in drawn(page) if t > before] and time.monotonic() < end:
            page.wait_for_timeout(100)
        times = [t for t in drawn(page) if t > before]
        if not times:
            out.notes.append("no picture: " + page.locator(".jp-OutputArea-output").last.inner_text()[:200])
            return out
        settle(page)
        out.first = (times[0] - before) / 1000
        page.locator("canvas, iframe").last.scroll_into_view_if_needed()
        bytes_before, before = sum(received), time.time() * 1000
        error = lab.run_code(page, _PLAY)
        out.notes += [error[-200:]] if "Error" in error else []
        settle(page)
        times = [t for t in drawn(page) if t > before]
        out.playing, out.kilobytes = rate(times), (sum(received) - bytes_before) / FRAMES / 1000
        kernel = "window.jupyterapp.shell.currentWidget.sessionContext.session.kernel"
        page.evaluate(f"code => {{ window.sent = 0; {kernel}.requestExecute({{code}}); }}", _BUSY)
        page.wait_for_timeout(700)
        page.evaluate(f"() => {kernel}.anyMessage.connect((_, m) => {{ if (m.direction === 'send') window.sent += 1; }})")
        out.turning, moves = turn(page, SECONDS)
        out.asked = page.evaluate("() => window.sent")
        out.notes += [] if moves > out.turning else [f"only {moves:.0f} moves/s"]
        page.wait_for_function(f"() => {kernel}.status === 'idle'", timeout=120_000)
        out.notes += [f"asks {outside[0]}"] if outside else []
        if candidate.page:
            lab.run_code(page, candidate.page)
        page.evaluate("() => window.jupyterapp.commands.execute('docmanager:save')")
        page.wait_for_timeout(2500)
        lab.shut_down(page)
    if candidate.page and (folder / "own.html").exists():
        out.own_page = page_alone(folder / "own.html")
        (folder / "own.html").unlink()
    convert = [sys.executable, "-m", "jupyter", "nbconvert", "--to", "html", "--log-level=ERROR", str(folder / name)]
    subprocess.run(convert, check=True, capture_output=True)
    out.nbconvert = page_alone((folder / name).with_suffix(".html"))
    return out


def page_alone(path: Path) -> str:
    """What a page shows without kernel and network: pictures per second of a head that is turned, and its size."""
    size = f"{path.stat().st_size / 1e6:.1f} MB"
    with lab.chromium_page() as page:
        page.context.add_init_script(_COUNT)
        page.route("http*://**", lambda route: route.abort())
        page.goto(path.as_uri())
        settle(page, 2.0, 20.0)
        if not drawn(page):
            return f"no ({size})"
        canvas = canvas_of(page)
        if canvas is None:
            return f"no ({size})"
        page.mouse.wheel(0, max(0, canvas["y"] - 200))
        page.wait_for_timeout(800)
        turning, _ = turn(page, 2.0)
        return f"turns, {turning:.0f}/s ({size})" if turning > 1 else f"a picture ({size})"


def main() -> None:
    """Measure all that are installed, or those whose names contain one of the arguments, and print the table."""
    words, rows = sys.argv[1:] or [""], []
    chosen = [c for c in CANDIDATES if importlib.util.find_spec(c.needs) and any(word in c.name for word in words)]
    with tempfile.TemporaryDirectory() as text:
        folder = Path(text)
        with lab.jupyter_lab(folder) as address:
            for panes in (2, 4):
                for candidate in chosen:
                    rows.append(measure(address, folder, candidate, panes))
                    print(row(rows[-1]), f"load {os.getloadavg()[0]:.1f}", file=sys.stderr, flush=True)
    titles = (
        "",
        "panes",
        "first picture, s",
        "pictures/s",
        "kB/frame",
        "turning, kernel busy",
        "asks the kernel",
        "its own page",
    )
    print("| " + " | ".join((*titles, "nbconvert")) + " |")
    print("|---" * (len(titles) + 1) + "|")
    print("\n".join(map(row, rows)))


def row(r: Measured) -> str:
    """A line of the table; what went wrong at its end."""
    asked = f"{r.asked} messages" if r.asked else "never"
    figures = f"{r.first:.1f} | {r.playing:.1f} | {r.kilobytes:.0f} | {r.turning:.1f} | {asked} | {r.own_page} | {r.nbconvert}"
    return f"| {r.name} | {r.panes} | {figures} |{' ' + '; '.join(r.notes) if r.notes else ''}"


if __name__ == "__main__":
    main()
