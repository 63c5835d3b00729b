"""Display controls: probing, colour-coded quantity, magnification of the displacement."""

from typing import Any

import numpy as np

from palpate.pipeline import FittedProbing
from palpate.viewer.background_work import BackgroundWork
from palpate.viewer.colours import FIELDS, MEASURED, PREDICTED, coloured_field
from palpate.viewer.markup import scale_html, text_html
from palpate.viewer.stage import Stage, length_colours

# Initial drawn length of the largest displacement, as a fraction of the object's size.
_SHOWN = 0.06
_MAX_MAGNIFICATION = 50


class LookPanel:
    """Display controls.

    Parameters
    ----------
    gui : GuiApi of viser           of the tab
    background : BackgroundWork
    stage : Stage
    """

    def __init__(self, gui: Any, background: BackgroundWork, stage: Stage) -> None:
        self._background, self._stage = background, stage
        self._override: dict[str, FittedProbing] = {}
        names = [one.name for one in background.probings] or ["-"]
        self.probing = gui.add_dropdown("probing", names, hint="Which push is shown.")
        self.field = gui.add_dropdown("colours", FIELDS)
        self.scale = gui.add_html("")
        self.note = gui.add_html("")
        self.magnification = gui.add_slider(
            "deformation drawn, times", 0, _MAX_MAGNIFICATION, 1, self._initial_magnification()
        )
        self.view = gui.add_dropdown("seen from", stage.views)
        self.view.on_update(lambda _: stage.look_from(self.view.value))
        self.toggles = {
            name: gui.add_checkbox(name, name != "arrows")
            for name in ("points", "arrows", "probings", "cameras")
        }
        for control in (self.probing, self.field, self.magnification, *self.toggles.values()):
            control.on_update(lambda _: self.draw())
        self.probing.on_update(lambda _: self._draw_cameras())
        stage.draw_cameras(names[0])

    def _draw_cameras(self) -> None:
        with self._stage.lock:
            self._stage.draw_cameras(self.probing.value)

    @property
    def shown(self) -> FittedProbing | None:
        """The selected probing, with the prediction at the sliders' constants if set."""
        name = self.probing.value
        for one in self._background.probings:
            if one.name == name:
                return self._override.get(name, one)
        return None

    def override(self, probings: dict[str, FittedProbing]) -> None:
        """Show probings with predictions at other constants; an empty dict: as fitted."""
        self._override = probings
        self.draw()

    def _initial_magnification(self) -> int:
        displacement = [one.displacement for one in self._background.probings]
        largest = max((float(np.nanmax(np.abs(m), initial=0.0)) for m in displacement), default=0.0)
        if not largest:
            return 1
        return int(
            np.clip(round(_SHOWN * self._stage.size / (1e3 * largest)), 1, _MAX_MAGNIFICATION)
        )

    def draw(self) -> None:
        """Redraw everything."""
        with self._stage.lock:
            self._draw()

    def _draw(self) -> None:
        for name, toggle in self.toggles.items():
            self._stage.show(name, toggle.value)
        one = self.shown
        if one is None:
            return
        magnification, what = float(self.magnification.value), self.field.value
        field = coloured_field(one, what)
        self._stage.draw_points(field, magnification)
        self._stage.draw_probings(self._background.probings, one.name)
        self._draw_body(one, what, magnification)
        known = field is not None
        self.scale.content = scale_html(field.top, field.unit, field.cmap) if field else ""
        self.note.content = "" if known else text_html(_why(what), italic=True)

    def _draw_body(self, one: FittedProbing, what: str, magnification: float) -> None:
        """Draw the surface deformed by the model; coloured if that displacement is selected."""
        if one.surface is None:
            self._stage.draw_body(np.zeros_like(self._stage.subject.session.mesh.vertices), None)
            return
        colours = length_colours(one.surface)[0] if what == PREDICTED else None
        self._stage.draw_body(magnification * one.surface, colours)


def _why(what: str) -> str:
    """Why a field has no values, for the note."""
    if what == MEASURED:
        return "nothing is measured in this probing yet"
    return "not known before the session is fitted; the fit may still be running"
