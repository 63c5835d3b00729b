"""The fitted model, evaluated at constants other than the estimate (for interactive sliders)."""

from dataclasses import dataclass

from palpate.estimation.intervals import fitted_errors, predicted_points, predicted_surface
from palpate.estimation.observations import ProbeObservations
from palpate.estimation.search import Misfit, total_loss
from palpate.shapes import Points, Vertices


@dataclass(frozen=True, slots=True, eq=False)
class PredictedProbing:
    """Prediction of one probing at given constants.

    Attributes
    ----------
    name : str
    predicted : (n, 3) float [m]            with the true force and errors that fit best there
    residual : (n, 3) float [m]             measured minus predicted, NaN where not measured
    surface : (v, 3) float [m] or None      displacement of all vertices of the model's mesh
    """

    name: str
    predicted: Points
    residual: Points
    surface: Vertices | None


@dataclass(frozen=True, slots=True, eq=False)
class ModelState:
    """Predictions and misfit of the model at given constants.

    Attributes
    ----------
    misfit : float                  minus twice the log likelihood, above its minimum
    probings : tuple of PredictedProbing
    """

    misfit: float
    probings: tuple[PredictedProbing, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FittedModel:
    """The model of a fit, with its noise levels.

    Attributes
    ----------
    misfit : Misfit                 at the noise levels of its minimum
    lowest : float                  minimum of the misfit
    """

    misfit: Misfit
    lowest: float

    @property
    def observations(self) -> tuple[ProbeObservations, ...]:
        """Its probings."""
        return tuple(probe.observations for probe in self.misfit.probes)

    def at(self, poisson_ratio: float, shear_modulus: float) -> ModelState:
        """Evaluate the model at other constants; takes a few milliseconds.

        Parameters
        ----------
        poisson_ratio : float [-]       within the range of the fit
        shear_modulus : float [Pa]      > 0

        Returns
        -------
        ModelState

        Raises
        ------
        NotConvergedError               the true force of a probing did not converge
        """
        errors, local = self.misfit.at_best_forces(poisson_ratio, shear_modulus, with_slope=False)
        constants = poisson_ratio, shear_modulus
        probings = []
        for linearised in local:
            probe = linearised.rows.observations
            _, sigmas = fitted_errors(self.misfit, linearised, errors)
            predicted = predicted_points(linearised, constants, linearised.shift, sigmas)
            load = linearised.rows.load(shear_modulus, linearised.shift)
            surface = predicted_surface(probe, poisson_ratio, load)
            residual = probe.displacement - predicted
            probings.append(PredictedProbing(probe.name, predicted, residual, surface))
        return ModelState(total_loss(local, errors) - self.lowest, tuple(probings))
