"""Gaussian noise: plain least squares, for data without outliers."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation.noise.noise_model import Values


@dataclass(frozen=True, slots=True)
class Gaussian:
    """Independent Gaussian components (`NoiseModel`); one gross error spoils the fit."""

    def loss(self, squared: Values, components: Values) -> Values:
        """d2, whatever the number of components."""
        return squared + np.zeros_like(components)

    def weight(self, squared: Values, components: Values) -> Values:
        """1 everywhere."""
        return np.ones_like(squared + components)

    def weight_slope(self, squared: Values, components: Values) -> Values:
        """0 everywhere."""
        return np.zeros_like(squared + components)
