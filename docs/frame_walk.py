"""Walk with a frame from ``adaptiveface track`` to ``result.npz``, and list the calls between files as they are made.

``python docs/frame_walk.py`` prints the list of docs/architecture.md. A recording of one frame is tracked under
:func:`sys.setprofile`. A line is a file that is called from the file above it, with the called functions. The ground floor
(``GROUND``) and the files that only read the command line are left out.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import adaptiveface
from adaptiveface.cli import main as command
from adaptiveface.geometry.camera import Camera
from adaptiveface.model.actor import Actor
from adaptiveface.model.face_model import embedded_face_model
from adaptiveface.sensors.recording import RecordingWriter
from adaptiveface.synthetic.sensor import SyntheticSensor

PACKAGE = Path(adaptiveface.__file__).parent
#: Tools that are called from everywhere; a frame does not pass through them.
GROUND = ("caches", "errors.py", "files", "geometry", "parameters", "renamed.py", "runtime", "livelink")
#: Where the walk begins: the command, after its line has been read.
START = "run_track"
#: The command line's own work beside it.
COMMAND = ("cli/__init__.py", "cli/arguments.py", "cli/notes.py", "cli/speech.py", "export/arguments.py")


@dataclass
class Visit:
    """A call into a file: the functions that are called there, and the calls into other files that follow from it."""

    file: str
    functions: list[str]
    inner: list[Visit] = field(default_factory=list)

    def lines(self, depth: int = 0) -> list[str]:
        """The call and those within it, indented."""
        own = f"{'  ' * depth}{self.file}: {', '.join(self.functions)}"
        inner = [line for visit in self.inner for line in visit.lines(depth + 1)]
        return [own, *inner] if self.functions else inner


class Walk:
    """A profile function that notes the first call from each file into another."""

    def __init__(self) -> None:
        self.root = Visit("", [])
        self._stack: list[tuple[object, Visit]] = []

    def __call__(self, frame, event: str, _) -> None:
        """What :func:`sys.setprofile` calls."""
        path = Path(frame.f_code.co_filename)
        if not path.is_relative_to(PACKAGE):
            return
        if event == "return" and self._stack and self._stack[-1][0] is frame:
            self._stack.pop()
        elif event == "call":
            self._stack.append((frame, self._visit(path.relative_to(PACKAGE).as_posix(), frame.f_code.co_qualname)))

    def _visit(self, file: str, function: str) -> Visit:
        here = self._stack[-1][1] if self._stack else self.root
        if here is self.root and function != START or file in (here.file, *COMMAND) or file.startswith(GROUND):
            return here
        visit = next((visit for visit in here.inner if visit.file == file), None)
        if visit is None:
            here.inner.append(visit := Visit(file, []))
        name = function.rpartition("<locals>.")[2].removesuffix(".__init__").removesuffix(".__call__")
        if name not in visit.functions and "<" not in name and "__" not in name:
            visit.functions.append(name)
        return visit


def walk(run: Callable[[], object]) -> list[str]:
    """The lines of a run."""
    profile = Walk()
    sys.setprofile(profile)
    try:
        run()
    finally:
        sys.setprofile(None)
    return [line for visit in profile.root.inner for line in visit.lines()]


def frame_walk() -> list[str]:
    """The lines of a recording of one frame with features, tracked with an actor."""
    sensor, model = SyntheticSensor(3, "none", neutral_frames=1, frames=1, repeats=1, colour=False), embedded_face_model()
    camera, performer = sensor.camera, sensor.performer
    assert isinstance(camera, Camera)
    with tempfile.TemporaryDirectory() as folder, redirect_stdout(StringIO()), redirect_stderr(StringIO()):
        place = Path(folder)
        with RecordingWriter(place / "take", camera, sensor.fps, sensor.depth_scale) as writer:
            writer.write(sensor.read(0))
        Actor.untransferred(model, performer.neutral[: len(model.mean)]).save(place / "actor.npz")
        words = ["track", str(place / "take"), "--actor", str(place / "actor.npz"), "--out", str(place / "result.npz")]
        command(words)  # what is loaded and compiled once does not belong to a frame's way
        (place / "result.npz").unlink()
        return walk(lambda: command(words))


if __name__ == "__main__":
    print("\n".join(frame_walk()))
