"""Controls of the ball: a click presses it into the object, dragging presses deeper."""

from typing import Any

import numpy as np

from palpate.errors import PalpateError
from palpate.shapes import Vector3
from palpate.viewer.background_work import BackgroundWork
from palpate.viewer.markup import scale_html, text_html
from palpate.viewer.panels.look import LookPanel
from palpate.viewer.stage import Stage, length_colours
from palpate.viewer.touch import Pressed, force_text, place_ball, press

# Radius of the ball, depth of a click, and largest depth, as fractions of the object's size.
_RADIUS, _DEPTH, _DEEPEST = 0.12, 0.02, 0.1


class TouchPanel:
    """Controls of the ball.

    Parameters
    ----------
    gui : GuiApi of viser           of the tab
    background : BackgroundWork
    stage : Stage
    look : LookPanel                redraws the object when the ball is removed
    """

    def __init__(self, gui: Any, background: BackgroundWork, stage: Stage, look: LookPanel) -> None:
        self._background, self._stage, self._look = background, stage, look
        self.pressed: Pressed | None = None
        size = stage.size
        self.text = gui.add_html("")
        self.scale = gui.add_html("")
        self.radius = gui.add_slider(
            "ball's radius, mm", _round(0.02 * size), _round(0.4 * size), _round(0.005 * size),
            _round(_RADIUS * size),
        )  # fmt: skip
        self.depth = gui.add_slider(
            "depth, mm", 0.0, _round(_DEEPEST * size), _round(0.001 * size), _round(_DEPTH * size)
        )
        self.away = gui.add_button("take the ball away")
        self.depth.on_update(lambda _: self._press_deeper())
        self.away.on_click(lambda _: self.release())
        self.update()

    def update(self) -> None:
        """Update the text on whether the object can be touched yet."""
        if self.pressed is None:
            known = self._background.green is not None
            how = "Click on the object to press it; drag to press deeper."
            if known and self._background.assumed:
                how += " Nothing was estimated: G 20 kPa and nu 0.3 are assumed."
            if known and self._background.touch_text:
                how += f" {self._background.touch_text}."
            self.text.content = (
                text_html(how) if known else text_html(self._background.touch_text, italic=True)
            )

    def put(self, point: Vector3) -> None:
        """Press the ball at a point of the surface at rest [m], to the slider's depth."""
        green = self._background.green
        if green is None:
            self.update()
            return
        with self._stage.lock:
            try:
                ball = place_ball(green, point, 1e-3 * float(self.radius.value))
                self.pressed = press(green, ball, 1e-3 * float(self.depth.value))
            except PalpateError as error:
                self.text.content = text_html(str(error), italic=True)
                return
            self._show(self.pressed)

    def deepen(self, way: float) -> None:
        """Press as deep as the pointer was dragged [m]."""
        deepest = 1e-3 * float(self.depth.max)
        self.depth.value = 1e3 * float(np.clip(way, 0.0, deepest))
        self._press_deeper()

    def _press_deeper(self) -> None:
        green = self._background.green
        if green is None or self.pressed is None:
            return
        with self._stage.lock:
            depth = 1e-3 * float(self.depth.value)
            if depth == self.pressed.depth:
                return
            try:
                self.pressed = press(green, self.pressed, depth)
            except PalpateError as error:
                self.text.content = text_html(str(error), italic=True)
                return
            self._show(self.pressed)

    def _show(self, pressed: Pressed) -> None:
        """Show the deformed object, true to scale."""
        colours, _, top = length_colours(pressed.displacement)
        self._stage.draw_points(None, 1.0)
        self._stage.show("probings", False)
        self._stage.draw_body(pressed.displacement, colours)
        force, end, warning = force_text(pressed).partition("\n")
        self._stage.draw_ball(
            pressed.centre, pressed.state.tools[0].tool.bounding_radius, pressed.force, force
        )
        self.text.content = text_html(end + warning, bold=force)
        self.scale.content = scale_html(top, "mm", "viridis")

    def release(self) -> None:
        """Remove the ball and show the object as before."""
        with self._stage.lock:
            self.pressed = None
            self._stage.clear_ball()
            self.scale.content = ""
        self.update()
        self._look.draw()


def _round(length: float) -> float:
    """Round to two digits, for readable sliders."""
    return float(f"{length:.2g}")
