"""Hyperelastic laws that reduce to Hooke's law at small strain: energy density and derivatives.

Both laws are known as neo-Hookean. They have the same constants but couple volumetric and
deviatoric strain differently, by as much as real soft materials of equal constants may differ.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

Gradient = Float[np.ndarray, "3 3 m q"]
Moduli = Float[np.ndarray, "3 3 3 3 m q"]


@runtime_checkable
class Law(Protocol):
    """An isotropic hyperelastic law, in the deformation gradient F = I + du/dX (row: component of
    the deformed position, column: reference direction) at q quadrature points of m elements,
    (3, 3, m, q)."""

    def density(self, gradient: Gradient) -> Float[np.ndarray, "m q"]:
        """Strain energy per reference volume, (m, q) [Pa]; not finite unless det F > 0."""

    def stress(self, gradient: Gradient) -> Gradient:
        """First Piola-Kirchhoff stress, (3, 3, m, q) [Pa]: derivative of the energy in F."""

    def moduli(self, gradient: Gradient) -> Moduli:
        """Derivative of the stress aA in F_bB, (3, 3, 3, 3, m, q) [Pa]; indices a, A, b, B."""


@dataclass(frozen=True, slots=True)
class NeoHookean:
    """mu/2 (tr C - 3) - mu ln J + lambda/2 (ln J)^2, with C = F^T F and J = det F (`Law`).

    Parameters
    ----------
    mu, lame : float [Pa]           Lame's constants

    Source
    ------
    Bonet and Wood, Nonlinear continuum mechanics for finite element analysis (2nd ed. 2008),
    section 6.4.3.
    """

    mu: float
    lame: float

    def density(self, gradient: Gradient) -> Float[np.ndarray, "m q"]:
        """Of `Law`."""
        log = np.log(_determinant(gradient))
        squares = (gradient**2).sum(axis=(0, 1))
        return 0.5 * self.mu * (squares - 3.0) - self.mu * log + 0.5 * self.lame * log**2

    def stress(self, gradient: Gradient) -> Gradient:
        """Of `Law`."""
        log = np.log(_determinant(gradient))
        return self.mu * gradient + (self.lame * log - self.mu) * _inverse_transposed(gradient)

    def moduli(self, gradient: Gradient) -> Moduli:
        """mu delta_ab delta_AB + (mu - lambda ln J) H_aB H_bA + lambda H_aA H_bB, H = F^-T."""
        inverse = _inverse_transposed(gradient)
        falling = self.mu - self.lame * np.log(_determinant(gradient))
        moduli = self.lame * _outer(inverse, inverse) + falling * _crossed(inverse)
        _add_unit(moduli, self.mu)
        return moduli


@dataclass(frozen=True, slots=True)
class SplitNeoHookean:
    """mu/2 (J^(-2/3) tr C - 3) + K/2 (J - 1)^2: deviatoric and volumetric parts uncoupled (`Law`).

    Parameters
    ----------
    mu, lame : float [Pa]           Lame's constants; K = lambda + 2/3 mu

    Source
    ------
    Holzapfel, Nonlinear solid mechanics (2000), sections 6.4 and 6.5: the neo-Hookean law of
    Abaqus and CalculiX.
    """

    mu: float
    lame: float

    @property
    def bulk(self) -> float:
        """Bulk modulus [Pa]."""
        return self.lame + 2.0 / 3.0 * self.mu

    def density(self, gradient: Gradient) -> Float[np.ndarray, "m q"]:
        """Of `Law`."""
        volume, shear, squares = self._parts(gradient)
        return 0.5 * (shear * squares - 3.0 * self.mu) + 0.5 * self.bulk * (volume - 1.0) ** 2

    def stress(self, gradient: Gradient) -> Gradient:
        """Of `Law`."""
        volume, shear, squares = self._parts(gradient)
        pressure = self.bulk * (volume - 1.0) * volume
        inverse = _inverse_transposed(gradient)
        return shear * gradient + (pressure - shear * squares / 3.0) * inverse

    def moduli(self, gradient: Gradient) -> Moduli:
        """Derivative of the stress, with dJ = J H : dF and dH_aA = -H_aB H_bA dF_bB, H = F^-T."""
        volume, shear, squares = self._parts(gradient)
        inverse = _inverse_transposed(gradient)
        pressure = self.bulk * (volume - 1.0) * volume
        rising = self.bulk * (2.0 * volume - 1.0) * volume
        mixed = _outer(inverse, gradient)
        moduli = (rising + 2.0 / 9.0 * shear * squares) * _outer(inverse, inverse)
        moduli += (shear * squares / 3.0 - pressure) * _crossed(inverse)
        moduli -= 2.0 / 3.0 * shear * (mixed + mixed.transpose(2, 3, 0, 1, 4, 5))
        _add_unit(moduli, shear)
        return moduli

    def _parts(self, gradient: Gradient) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """J, mu J^(-2/3) and tr C."""
        volume = _determinant(gradient)
        return volume, self.mu * volume ** (-2.0 / 3.0), (gradient**2).sum(axis=(0, 1))


def _outer(one: Gradient, other: Gradient) -> Moduli:
    return np.einsum("aAmq,bBmq->aAbBmq", one, other)


def _crossed(inverse: Gradient) -> Moduli:
    return np.einsum("aBmq,bAmq->aAbBmq", inverse, inverse)


def _add_unit(moduli: Moduli, size: float | Float[np.ndarray, "m q"]) -> None:
    """Add `size` times delta_ab delta_AB in place."""
    for a, i in np.ndindex(3, 3):
        moduli[a, i, a, i] += size


def _determinant(gradient: Gradient) -> Float[np.ndarray, "m q"]:
    return np.linalg.det(gradient.transpose(2, 3, 0, 1))


def _inverse_transposed(gradient: Gradient) -> Gradient:
    return np.linalg.inv(gradient.transpose(2, 3, 0, 1)).transpose(3, 2, 0, 1)
