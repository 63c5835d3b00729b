"""The fitted model, evaluated at constants other than the estimate (for interactive sliders)."""

from dataclasses import dataclass

from palpate.estimation.intervals import fitted_errors, predicted_points, predicted_surface
from palpate.estimation.observations import ProbeObservations
from palpate.estimation.search import Minimum, Misfit, total_loss
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
    observations : tuple of ProbeObservations
    misfit : Misfit                 of these
    lowest : float                  minimum of the misfit
    """

    observations: tuple[ProbeObservations, ...]
    misfit: Misfit
    lowest: float

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
        value = total_loss(local, errors)
        probings = []
        for probe, linearised in zip(self.observations, local, strict=True):
            _, sigmas = fitted_errors(self.misfit, linearised, errors)
            constants = poisson_ratio, shear_modulus
            predicted = predicted_points(probe, constants, linearised, linearised.shift, sigmas)
            load = linearised.rows.load(shear_modulus, linearised.shift)
            surface = predicted_surface(probe, poisson_ratio, load)
            residual = probe.displacement - predicted
            probings.append(PredictedProbing(probe.name, predicted, residual, surface))
        return ModelState(value - self.lowest, tuple(probings))


def fitted_model(
    probes: tuple[ProbeObservations, ...], misfit: Misfit, minimum: Minimum
) -> FittedModel:
    """Make the model of a fit that can be evaluated at other constants.

    Parameters
    ----------
    probes : tuple of ProbeObservations
    misfit : Misfit                 of these, at the noise levels of its minimum
    minimum : Minimum

    Returns
    -------
    FittedModel
    """
    return FittedModel(probes, misfit, total_loss(minimum.probes, minimum.errors))
