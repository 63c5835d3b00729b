"""Control panels next to the object, in one browser tab.

What is shown and in which colours, sliders for two constants with the model's prediction and
misfit, the cameras' pictures over time, support and contacts set by clicking, and the ball that a
click presses into the object.
"""

import threading
from typing import Any

import numpy as np

from palpate.errors import PalpateError
from palpate.estimation import FitResult, at_constants
from palpate.figures import MODULI, modulus_span
from palpate.geometry import closest_points
from palpate.pipeline import FittedProbing
from palpate.records import ModulusMap, length_unit, modulus_unit
from palpate.shapes import Vector3
from palpate.viewer.clicking import (
    Draft,
    Pressed,
    draft_files,
    flat_face,
    force_text,
    place_ball,
    press,
    triangles_near,
    write_draft,
)
from palpate.viewer.drawings import LikelihoodPlot, camera_picture, frames
from palpate.viewer.stage import (
    FIELDS,
    MEASURED,
    PREDICTED,
    Stage,
    coloured_field,
    length_colours,
    scale_html,
    text_html,
)
from palpate.viewer.subject import BackgroundWork, with_prediction

# Initial drawn length of the largest displacement, as a fraction of the object's size.
_SHOWN = 0.06
_MAX_MAGNIFICATION = 50
# Range of the shear modulus, as a factor either way, and number of steps of its slider.
_FACTOR, _STEPS = 3.0, 300
_NU_STEP, _LARGEST_NU = 0.001, 0.499
# Duration of each picture when played [s].
_PACE = 0.4
_MAX_FLOW_MAGNIFICATION = 30
_PRESS, _CONTACT, _FACE, _HOLD, _FREE = _CLICKS = (
    "presses the object", "sets the contact of the probing", "holds the flat face",
    "holds what is near", "frees what is near",
)  # fmt: skip
_CLOSED, _CUTS, _THROUGH = "no", ("across x", "across y", "across z"), "as if of glass"
# Initial radius of "near", as a fraction of the object's size.
_NEAR = 0.06
# Radius of the ball, depth of a click, and largest depth, as fractions of the object's size.
_RADIUS, _DEPTH, _DEEPEST = 0.12, 0.02, 0.1


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
        names = [probing.name for probing in background.probings] or ["-"]
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
        for probing in self._background.probings:
            if probing.name == name:
                return self._override.get(name, probing)
        return None

    def override(self, probings: dict[str, FittedProbing]) -> None:
        """Show probings with predictions at other constants; an empty dict: as fitted."""
        self._override = probings
        self.draw()

    def _initial_magnification(self) -> int:
        displacement = [probing.displacement for probing in self._background.probings]
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
        probing = self.shown
        if probing is None:
            return
        magnification, what = float(self.magnification.value), self.field.value
        field = coloured_field(probing, what)
        self._stage.draw_points(field, magnification)
        self._stage.draw_probings(self._background.probings, probing.name)
        self._draw_body(probing, what, magnification)
        known = field is not None
        self.scale.content = ""
        if field is not None:
            self.scale.content = scale_html(_numbers(field.top, field.unit), field.cmap)
        self.note.content = "" if known else text_html(_why(what), italic=True)

    def _draw_body(self, probing: FittedProbing, what: str, magnification: float) -> None:
        """Draw the surface deformed by the model; coloured if that displacement is selected."""
        if probing.surface is None:
            self._stage.draw_body(np.zeros_like(self._stage.subject.session.mesh.vertices), None)
            return
        colours = length_colours(probing.surface)[0] if what == PREDICTED else None
        self._stage.draw_body(magnification * probing.surface, colours)


def _why(what: str) -> str:
    """Why a field has no values, for the note."""
    if what == MEASURED:
        return "nothing is measured in this probing yet"
    return "not known before the session is fitted; the fit may still be running"


def _numbers(top: float, unit: str) -> tuple[str, str, str]:
    """Below a colour bar from 0."""
    return "0", f"{top / 2:.3g}", f"{top:.3g} {unit} and more"


class InsidePanel:
    """Cuts the object open, or shows it as if of glass, with its modulus inside.

    Parameters
    ----------
    gui : GuiApi of viser           of the tab
    stage : Stage                   of an object that is not the same everywhere
    modulus : ModulusMap            its
    """

    def __init__(self, gui: Any, stage: Stage, modulus: ModulusMap) -> None:
        self._stage, self._nodes = stage, modulus.nodes
        estimate = stage.subject.estimate
        base = "mean" if estimate is not None and estimate.field is not None else "rest"
        self.axis = gui.add_dropdown("cut open", (_CLOSED, *_CUTS, _THROUGH))
        self.at = gui.add_slider("cut at, share of the side", 0.0, 1.0, 0.02, 0.5)
        span = modulus_span(modulus)
        ends = (f"1/{span:.3g}", "1", f"{span:.3g} times the {base}")
        gui.add_html(scale_html(ends, MODULI))
        if not modulus.is_known.all():
            gui.add_html(text_html("Grey: the data do not tell the modulus.", italic=True))
        for control in (self.axis, self.at):
            control.on_update(lambda _: self.draw())

    def draw(self) -> None:
        """Redraw the object: whole, cut, or with the parts that differ inside."""
        with self._stage.lock:
            if self.axis.value == _CLOSED:
                self._stage.close()
            elif self.axis.value == _THROUGH:
                self._stage.draw_through()
            else:
                axis = _CUTS.index(self.axis.value)
                low, high = self._nodes[:, axis].min(), self._nodes[:, axis].max()
                self._stage.draw_cut(axis, float(low + self.at.value * (high - low)))


class MaterialPanel:
    """Sliders for shear modulus and Poisson's ratio.

    Parameters
    ----------
    gui : GuiApi of viser           of the tab
    background : BackgroundWork
    look : LookPanel                shows the model's prediction
    """

    def __init__(self, gui: Any, background: BackgroundWork, look: LookPanel) -> None:
        self._gui, self._background, self._look = gui, background, look
        self.text = gui.add_html(text_html(background.model_text, italic=True))
        self.modulus: Any = None
        self.ratio: Any = None
        self._plot: LikelihoodPlot | None = None
        self._image: Any = None

    def update(self) -> None:
        """Show the progress of the model, and the sliders once it is ready."""
        fitted = self._background.fitted
        if fitted is None:
            self.text.content = text_html(self._background.model_text, italic=True)
        elif self.modulus is None:
            self._add_sliders(fitted)

    def _add_sliders(self, fitted: FitResult) -> None:
        estimate = fitted.estimate
        best = estimate.shear_modulus.value
        self._unit, name = modulus_unit(best)
        start = _rounded(best / self._unit, 4)
        low, high = (_rounded(best * factor / self._unit, 4) for factor in (1 / _FACTOR, _FACTOR))
        gui = self._gui
        self.modulus = gui.add_slider(
            f"shear modulus, {name}", low, high, _rounded((high - low) / _STEPS, 4), start
        )
        nu = float(np.clip(estimate.poisson_ratio.value, 0.0, _LARGEST_NU))
        self.ratio = gui.add_slider("Poisson's ratio", 0.0, _LARGEST_NU, _NU_STEP, round(nu, 3))
        back = gui.add_button("back to the estimate")
        self._plot = LikelihoodPlot(fitted.likelihood)
        self._image = gui.add_image(self._plot.marked(nu, best), format="png")
        for slider in (self.modulus, self.ratio):
            slider.on_update(lambda _: self._ask())
        back.on_click(lambda _: self._back(nu, start))
        self._show_numbers(nu, best)

    def _back(self, nu: float, modulus: float) -> None:
        """Return to the constants of the fit, not to the sliders' nearest steps."""
        self.modulus.value, self.ratio.value = modulus, round(nu, 3)
        self._look.override({})
        self._show_numbers(nu, modulus * self._unit)

    def _ask(self) -> None:
        """Compute and show the model's prediction at the sliders' constants."""
        fitted = self._background.fitted
        if fitted is None or fitted.model is None:
            return
        nu, modulus = float(self.ratio.value), float(self.modulus.value) * self._unit
        try:
            held = at_constants(fitted.model, nu, modulus)
        except PalpateError as error:
            self.text.content = text_html(str(error), italic=True)
            return
        shown = enumerate(self._background.probings)
        self._look.override(
            {probing.name: with_prediction(probing, held, k) for k, probing in shown}
        )
        self._show_numbers(nu, modulus, held.value - fitted.model.value)

    def _show_numbers(self, nu: float, modulus: float, misfit: float = 0.0) -> None:
        """Update the numbers next to the sliders, and the cross in the plot."""
        young = 2.0 * modulus * (1.0 + nu) / self._unit
        name = modulus_unit(self._unit)[1]
        self.text.content = text_html(
            " above that of the best constants; 6 is the edge of the 95 % region where noise is"
            f" independent\nE = {young:.4g} {name}; {rms_text(self._look.shown)}",
            bold=f"misfit {max(misfit, 0.0):.1f}",
        )
        if self._plot is not None:
            self._image.image = self._plot.marked(nu, modulus)


def rms_text(probing: FittedProbing | None) -> str:
    """Root mean square residual of a probing, without outliers, as text.

    Parameters
    ----------
    probing : FittedProbing or None

    Returns
    -------
    str                             empty if there is no probing
    """
    if probing is None:
        return ""
    used = np.isfinite(probing.displacement).all(axis=1) & (probing.weight.max(axis=1) >= 0.1)
    left = np.linalg.norm((probing.displacement - probing.predicted)[used], axis=1)
    rms = float(np.sqrt(np.mean(left**2))) if used.any() else 0.0
    factor, unit = length_unit(rms)
    return f"rms difference in {probing.name}: {rms / factor:.3g} {unit}"


class PicturesPanel:
    """Controls of the picture sequence.

    Parameters
    ----------
    gui : GuiApi of viser           of the tab
    stage : Stage
    look : LookPanel                selects the probing
    """

    def __init__(self, gui: Any, stage: Stage, look: LookPanel) -> None:
        self._subject, self._look = stage.subject, look
        self._stop = threading.Event()
        rig = self._subject.rig
        if rig is None:
            self.text = gui.add_html(text_html("This session has no pictures.", italic=True))
            return
        self._cameras = [camera.name for camera in rig.cameras]
        self.camera = gui.add_dropdown("camera", self._cameras)
        self.frame = gui.add_slider("picture", 0, 1, 1, 0)
        self.magnification = gui.add_slider("flow drawn, times", 1, _MAX_FLOW_MAGNIFICATION, 1, 5)
        self.play = gui.add_button("play")
        self.image: Any = None
        self._gui = gui
        self.text = gui.add_html("")
        for control in (self.camera, self.frame, self.magnification):
            control.on_update(lambda _: self.draw())
        self.play.on_click(lambda _: self._play())
        look.probing.on_update(lambda _: self._begin())
        self._begin()

    def _begin(self) -> None:
        """Reset the sequence after another probing was selected."""
        count = len(frames(self._subject.session, self._look.probing.value))
        self.frame.max = max(1, count - 1)
        self.frame.value = max(0, count - 1)
        self.draw()

    def draw(self) -> None:
        """Show the selected picture."""
        rig, probing = self._subject.rig, self._look.shown
        if rig is None or probing is None:
            return
        patterns = frames(self._subject.session, probing.name)
        if not patterns:
            self.text.content = text_html(f"{probing.name} has no pictures.", italic=True)
            return
        number = min(int(self.frame.value), len(patterns) - 1)
        last = number == len(patterns) - 1
        seen = camera_picture(
            self._subject.session, rig, self._cameras.index(self.camera.value), patterns[number],
            flow=probing if last else None, magnification=float(self.magnification.value),
        )  # fmt: skip
        if seen is None:
            self.text.content = text_html(f"{patterns[number]} cannot be read.", italic=True)
        elif self.image is None:
            self.image = self._gui.add_image(seen, format="jpeg")
        else:
            self.image.image = seen
        when = "at rest" if number == 0 else f"{number} of {len(patterns) - 1} under load"
        if seen is not None:
            drawn = last and np.isfinite(probing.displacement).all(axis=1).any()
            self.text.content = text_html(
                when + ("; arrows: measured displacement" if drawn else "")
            )

    def _play(self) -> None:
        """Play the pictures once."""
        for number in range(int(self.frame.max) + 1):
            if self._stop.wait(_PACE if number else 0.0):
                return
            self.frame.value = number
            self.draw()

    def close(self) -> None:
        """Stop playing after the tab was closed."""
        self._stop.set()


class SettingPanel:
    """Choice of what a click does, and buttons to write or discard the changes.

    Parameters
    ----------
    gui : GuiApi of viser           of the tab
    stage : Stage
    look : LookPanel                selects the probing whose contact is set
    """

    def __init__(self, gui: Any, stage: Stage, look: LookPanel) -> None:
        self._gui, self._stage, self._look = gui, stage, look
        self.draft = Draft()
        self.click = gui.add_dropdown("a click", _CLICKS)
        size = stage.size
        self.near = gui.add_slider(
            "near is, mm", _rounded(0.01 * size), _rounded(0.3 * size), _rounded(0.005 * size),
            _rounded(_NEAR * size),
        )  # fmt: skip
        self.text = gui.add_html("")
        write = gui.add_button("write session.toml ...")
        forget = gui.add_button("forget what was set")
        write.on_click(lambda _: self.ask_to_write())
        forget.on_click(lambda _: self._forget())

    @property
    def presses(self) -> bool:
        """Whether a click presses the object."""
        return bool(self.click.value == _PRESS)

    def clicked(self, point: Vector3) -> None:
        """Apply a click at a point of the surface at rest [m]."""
        session, what = self._stage.subject.session, self.click.value
        closest = closest_points(session.mesh, point[None])
        if what == _CONTACT:
            self.draft = self.draft.with_contact(self._look.probing.value, closest.position[0])
        else:
            held = self.draft.support
            held = session.held_triangles if held is None else held
            near = triangles_near(session.mesh, closest.position[0], 1e-3 * float(self.near.value))
            near = np.append(near, closest.triangle[0])
            if what == _FACE:
                held = flat_face(session.mesh, int(closest.triangle[0]))
            elif what == _HOLD:
                held = np.union1d(held, near)
            else:
                held = np.setdiff1d(held, near)
            self.draft = self.draft.with_support(held)
        self._show()

    def _show(self) -> None:
        session, draft = self._stage.subject.session, self.draft
        with self._stage.lock:
            self._stage.mark_support(draft.support)
            self._stage.draw_marks(draft.contacts)
            self._look.draw()
        lines = []
        if draft.support is not None:
            count = len(session.mesh.triangles)
            lines.append(f"support: {len(draft.support)} of {count} triangles")
        for name, point in draft.contacts.items():
            here = ", ".join(f"{x / session.metres_per_unit:.4g}" for x in point)
            lines.append(f"contact of {name}: [{here}]")
        self.text.content = text_html("\n".join(lines)) if lines else ""

    def ask_to_write(self) -> None:
        """Ask whether the changes are to be written, naming the files."""
        try:
            *new, changed = draft_files(self._stage.subject.session, self.draft)
        except PalpateError as error:
            self.text.content = text_html(str(error), italic=True)
            return
        with self._gui.add_modal("Write what was set?") as question:
            what = [f"{changed} is changed.", *(f"{file} is new." for file in new)]
            self._gui.add_html(text_html("\n".join(what)))
            yes, no = self._gui.add_button("write"), self._gui.add_button("do not write")

        def write() -> None:
            question.close()
            self._write()

        yes.on_click(lambda _: write())
        no.on_click(lambda _: question.close())

    def _write(self) -> None:
        try:
            written = write_draft(self._stage.subject.session, self.draft)
        except PalpateError as error:
            self.text.content = text_html(f"not written: {error}", italic=True)
            return
        self.draft = Draft()
        self.text.content = text_html(
            f"Written to {written.path}. Fit the session again, and open it anew."
        )

    def _forget(self) -> None:
        self.draft = Draft()
        self._show()


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
            "ball's radius, mm", _rounded(0.02 * size), _rounded(0.4 * size),
            _rounded(0.005 * size), _rounded(_RADIUS * size),
        )  # fmt: skip
        self.depth = gui.add_slider(
            "depth, mm", 0.0, _rounded(_DEEPEST * size), _rounded(0.001 * size),
            _rounded(_DEPTH * size),
        )  # fmt: skip
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
            pressed.centre, pressed.state.tools[0].tool.reach, pressed.force, force
        )
        self.text.content = text_html(end + warning, bold=force)
        self.scale.content = scale_html(_numbers(top, "mm"), "viridis")

    def release(self) -> None:
        """Remove the ball and show the object as before."""
        with self._stage.lock:
            self.pressed = None
            self._stage.clear_ball()
            self.scale.content = ""
        self.update()
        self._look.draw()


def _rounded(number: float, digits: int = 2) -> float:
    """Round to some digits, for readable sliders."""
    return float(f"{number:.{digits}g}")
