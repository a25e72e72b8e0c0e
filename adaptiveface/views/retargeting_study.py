"""Show for notebook 09 the actor and characters side by side, driven by sliders or by the tracked performance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import ipywidgets as widgets
import numpy as np

from ..geometry.mesh import rotation_vector_matrix
from ..insides import make_insides
from ..parameters import BlendshapeParameters
from ..pipeline import one_thread
from ..report.pictures import SKIN, completed
from ..retargeting import BUILT_IN
from ..retargeting.arkit import arkit_weights
from ..retargeting.character import Character
from ..retargeting.correctives import transferred_correctives
from ..retargeting.loading import load_character
from ..retargeting.portrait import FACING, portrait
from ..studies.session import Session
from ..tracking.resolve import SparseResolve
from ..tracking.types import TrackedFrame
from .charts import LiveChart
from .kernel import Displayed, on_main_thread, shown_errors
from .pictures import encode
from .player import Player
from .sliders import TypedNumbers, ValueSlider, linear_steps
from .turntable import Turntable

#: The package's default price of an expression, mm.
SPARSITY = BlendshapeParameters().sparsity
#: Modes of driving the faces.
SLIDERS, INITIAL, RESOLVED, CORRECTIVES = "sliders", "initial", "re-solved", "re-solved + correctives"
#: One character driven in all three modes instead of all characters in one of them (the paper's figure 8).
COMPARED = "compare on one"
_STYLE, _WIDE = {"description_width": "130px"}, widgets.Layout(width="290px")


class RetargetingStudy(Displayed):
    """The actor's final mesh v4 and characters in one 3D view, which the mouse turns. Display its ``widget``.

    Coefficients come from the sliders, or from the frame that the player shows. ``COMPARED`` shows one character with initial
    coefficients, with re-solved ones, and with the correctives. The chart compares initial and re-solved coefficients of one
    expression.

    Parameters
    ----------
    session : Session
        The performance.
    results : sequence of TrackedFrame
        Of its frames.
    characters : sequence of str
        Names of built-in characters, or files.
    pane : int
        Width and height of each face, pixels.
    expressions : (A, N, 3), optional
        Expressions to which the coefficients belong, mm (:attr:`.Tracker.expressions`); those of the actor by default.
    """

    def __init__(
        self,
        session: Session,
        results: Sequence[TrackedFrame],
        characters: Sequence[str] = BUILT_IN,
        pane: int = 250,
        expressions: np.ndarray | None = None,
    ) -> None:
        self.actor, self.pane = session.actor, pane
        self.results = [result for result in results if result is not None and result.tracked]
        names = self.actor.expression_names[: len(self.results[0].coefficients)]
        if expressions is not None:
            self.actor = replace(self.actor, blendshapes=expressions, expression_names=tuple(names))
        self.names, self._table = tuple(names), arkit_weights(names)
        self.initial = np.array([r.coefficients_initial for r in self.results])
        self.resolved = self._resolved(SPARSITY)
        self.characters = [load_character(name) for name in characters]
        self._self = Character("actor", self.actor.neutral, self.actor.triangles, names, self.actor.blendshapes[: len(names)])
        self._insides = make_insides(self.actor.neutral, self.actor.triangles)
        self._added: dict[str, np.ndarray] = {}
        self._make_widget(session.fps)
        self._redraw()

    def _make_widget(self, fps: float) -> None:
        self.mode = widgets.ToggleButtons(
            options=[RESOLVED, INITIAL, CORRECTIVES, COMPARED, SLIDERS], style={"button_width": "auto"}
        )
        self.sliders = {
            name: ValueSlider(linear_steps(0, 1, 0.05), 0, description=name, style=_STYLE, layout=_WIDE) for name in self.names
        }
        names = [character.name for character in self.characters]
        self.compared = widgets.Dropdown(options=names, description="compare on", style=_STYLE, layout=_WIDE)
        self.expression = widgets.Dropdown(options=self.names, description="chart", style=_STYLE, layout=_WIDE)
        self.player = Player(len(self.results), lambda index: self.draw(), fps)
        self.chart = LiveChart(
            (INITIAL, RESOLVED),
            (0, len(self.results) - 1),
            (-0.02, 1.02),
            "frame",
            "coefficient",
            "initial against re-solved",
            size=(460, 200),
        )
        self.message = widgets.HTML()
        self.view = Turntable(width=self.pane * (1 + len(self.characters)), height=self.pane, name="adaptiveface-characters")
        redraw = on_main_thread(self._redraw)
        for control in (self.mode, self.compared, self.expression):
            control.observe(lambda change: redraw(), "value")
        self.view.observe(lambda change: redraw(), ["camera", "background"])
        for slider in self.sliders.values():
            slider.observe(lambda change: self._to_sliders(redraw), "value")
        sliders = list(self.sliders.values())
        box = widgets.VBox([*sliders, TypedNumbers(sliders)], layout=widgets.Layout(max_height="240px", overflow="auto"))
        box.add_class("adaptiveface-numbers")
        below = widgets.HBox(
            [box, widgets.VBox([self.compared, self.expression, self.chart.widget])],
            layout=widgets.Layout(flex_flow="row wrap"),
        )
        self.widget = widgets.VBox([self.view, self.mode, self.player.widget, self.message, below])

    def resolve(self, sparsity: float = SPARSITY) -> np.ndarray:
        """Re-solve every frame with another price on expressions, mm, show it, and return the coefficients (F, A)."""
        self.resolved = self._resolved(sparsity)
        self._added.clear()
        self._redraw()
        return self.resolved

    def _resolved(self, sparsity: float) -> np.ndarray:
        resolve = SparseResolve.of(
            self.actor, self.names, BlendshapeParameters(sparsity=sparsity, expression_prior=0.0)
        )  # the price alone
        return np.array([resolve(r.v4, r.coefficients) for r in self.results])

    def _to_sliders(self, redraw) -> None:
        if self.mode.value != SLIDERS:
            self.mode.value = SLIDERS  # this redraws
        else:
            redraw()

    def _redraw(self) -> None:
        with shown_errors(lambda text: setattr(self.message, "value", text)), one_thread():
            self.draw()

    def coefficients(self, index: int, mode: str | None = None) -> np.ndarray:
        """(A,) coefficients that drive the characters at a frame, in the chosen mode or in another one."""
        mode = mode or self.mode.value
        if mode == SLIDERS:
            return np.array([slider.value for slider in self.sliders.values()])
        return (self.initial if mode == INITIAL else self.resolved)[index]

    def faces(self, index: int) -> list[tuple[Character, np.ndarray, str]]:
        """The faces on show, each with its mesh (V, 3) in the head frame, mm, and its title.

        The actor comes first, followed by every character once, or by one character three times.
        """
        mode = self.mode.value
        own = self._self.shape(self.coefficients(index)) if mode == SLIDERS else self.results[index].v4
        out = [(self._self, own, "actor")]
        if mode == COMPARED:
            one = next(c for c in self.characters if c.name == self.compared.value)
            return out + [(one, self._driven(one, index, m), m) for m in (INITIAL, RESOLVED, CORRECTIVES)]
        return out + [(character, self._driven(character, index, mode), character.name) for character in self.characters]

    def shapes(self, index: int) -> list[np.ndarray]:
        """The meshes of :meth:`faces`, each (V, 3) in the head frame, mm."""
        return [shape for _, shape, _ in self.faces(index)]

    def _driven(self, character: Character, index: int, mode: str) -> np.ndarray:
        shape = character.shape(character.weights(self._table.curves(self.coefficients(index, mode)[None]))[0])
        if mode == CORRECTIVES and character.shares_topology(self.actor.triangles):
            shape[: character.skin] += self._correctives(character)[index]
        return shape

    def _correctives(self, character: Character) -> np.ndarray:
        """(F, V, 3) transferred v4 - v1 of every frame, mm, computed on first use."""
        if character.name not in self._added:
            self.message.value = f"transferring the correctives to the {character.name} ..."
            v4 = np.stack([result.v4 for result in self.results])
            neutral = character.neutral[: character.skin]
            self._added[character.name] = transferred_correctives(
                self.actor.neutral, self._self.shape(self.resolved), v4, neutral, self.actor.triangles
            )
            self.message.value = ""
        return self._added[character.name]

    def picture(self) -> np.ndarray:
        """Draw all n faces at the player's frame from the same side, on the page's colour: (pane, n pane, 3) uint8."""
        index = self.player.index
        turn, tilt, zoom = self.view.camera
        red, green, blue = background = self.view.background
        ink = (60, 60, 60) if sum(background) > 384 else (225, 225, 225)
        rotation = FACING if self.mode.value == SLIDERS else self.results[index].head_pose[:3, :3]
        for axis, degrees in ((0, tilt), (1, -turn)):
            rotation = rotation @ rotation_vector_matrix(np.radians(degrees) * np.eye(3)[axis])
        panes = []
        for face, shape, title in self.faces(index):
            if face is self._self:
                face, shape = self._with_insides(shape)
            pane = portrait(face, shape, self.pane, rotation, rays=1, zoom=zoom, background=(red, green, blue))
            panes.append(cv2.putText(pane, title, (6, 16), cv2.FONT_HERSHEY_SIMPLEX, 0.42, ink, 1, cv2.LINE_AA))
        return np.hstack(panes)

    def _with_insides(self, skin: np.ndarray) -> tuple[Character, np.ndarray]:
        """The actor with eyes, teeth and tongue as a character to draw, and the vertices of both."""
        plain = np.tile(np.array(SKIN, float), (len(skin), 1))
        vertices, triangles, colours = completed(self._insides, skin, self.actor.triangles, plain)
        return replace(self._self, triangles=triangles, colours=colours.astype(np.uint8)), vertices

    def draw(self) -> None:
        """Draw all faces and the chart."""
        self.view.value = encode(self.picture())
        k = self.names.index(self.expression.value)
        self.chart.update(self.player.index, **{INITIAL: self.initial[:, k], RESOLVED: self.resolved[:, k]})

    def close(self) -> None:
        """Stop playing."""
        self.player.close()


__all__ = ["COMPARED", "CORRECTIVES", "INITIAL", "RESOLVED", "SLIDERS", "RetargetingStudy"]
