"""Sliders for two constants: the model's prediction at them, and its misfit."""

from typing import Any

import numpy as np

from palpate.errors import PalpateError
from palpate.estimation import FitResult, ModelState
from palpate.pipeline import FittedProbing
from palpate.records import length_unit, modulus_unit
from palpate.viewer.background_work import BackgroundWork
from palpate.viewer.drawings import LikelihoodPlot
from palpate.viewer.markup import text_html
from palpate.viewer.panels.look import LookPanel
from palpate.viewer.subject import with_prediction

# Range of the shear modulus, as a factor either way, and number of steps of its slider.
_FACTOR, _STEPS = 3.0, 300
_NU_STEP, _LARGEST_NU = 0.001, 0.499


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
        low, high = (_short(best * factor / self._unit) for factor in (1 / _FACTOR, _FACTOR))
        gui = self._gui
        self.modulus = gui.add_slider(
            f"shear modulus, {name}",
            low,
            high,
            _short((high - low) / _STEPS),
            _short(best / self._unit),
        )
        nu = float(np.clip(estimate.poisson_ratio.value, 0.0, _LARGEST_NU))
        self.ratio = gui.add_slider("Poisson's ratio", 0.0, _LARGEST_NU, _NU_STEP, round(nu, 3))
        back = gui.add_button("back to the estimate")
        self._plot = LikelihoodPlot(fitted.likelihood)
        self._image = gui.add_image(self._plot.marked(nu, best), format="png")
        for slider in (self.modulus, self.ratio):
            slider.on_update(lambda _: self._ask())
        back.on_click(lambda _: self._back(nu, _short(best / self._unit)))
        self._tell(nu, best, None)

    def _back(self, nu: float, modulus: float) -> None:
        """Return to the constants of the fit, not to the sliders' nearest steps."""
        self.modulus.value, self.ratio.value = modulus, round(nu, 3)
        self._look.override({})
        self._tell(nu, modulus * self._unit, None)

    def _ask(self) -> None:
        """Compute and show the model's prediction at the sliders' constants."""
        fitted = self._background.fitted
        if fitted is None or fitted.model is None:
            return
        nu, modulus = float(self.ratio.value), float(self.modulus.value) * self._unit
        try:
            state = fitted.model.at(nu, modulus)
        except PalpateError as error:
            self.text.content = text_html(str(error), italic=True)
            return
        found = {one.name: one for one in state.probings}
        self._look.override(
            {one.name: with_prediction(one, found[one.name]) for one in self._background.probings}
        )
        self._tell(nu, modulus, state)

    def _tell(self, nu: float, modulus: float, state: ModelState | None) -> None:
        """Update the numbers next to the sliders, and the cross in the plot."""
        young = 2.0 * modulus * (1.0 + nu) / self._unit
        misfit = 0.0 if state is None else max(state.misfit, 0.0)
        name = modulus_unit(self._unit)[1]
        self.text.content = text_html(
            " above that of the best constants; 6 is the edge of the 95 % region where noise is"
            f" independent\nE = {young:.4g} {name}; {rms_text(self._look.shown)}",
            bold=f"misfit {misfit:.1f}",
        )
        if self._plot is not None:
            self._image.image = self._plot.marked(nu, modulus)


def _short(number: float) -> float:
    """Round to four digits, for readable sliders."""
    return float(f"{number:.4g}")


def rms_text(one: FittedProbing | None) -> str:
    """Root mean square residual of a probing, without outliers, as text.

    Parameters
    ----------
    one : FittedProbing or None

    Returns
    -------
    str                             empty if there is no probing
    """
    if one is None:
        return ""
    used = np.isfinite(one.displacement).all(axis=1) & (one.weight.max(axis=1) >= 0.1)
    left = np.linalg.norm((one.displacement - one.predicted)[used], axis=1)
    rms = float(np.sqrt(np.mean(left**2))) if used.any() else 0.0
    factor, unit = length_unit(rms)
    return f"rms difference in {one.name}: {rms / factor:.3g} {unit}"
