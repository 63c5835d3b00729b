"""Creep compliance and relaxation modulus as sums of exponentials, and the response to a force."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.linalg import solve_banded

from palpate.arrays import fix_fields
from palpate.errors import InputError

# Below it (1 - exp(-x)) / x is 1 to double precision, and the quotient is not.
_SMALL = 1e-12


def memory(
    time: Float[np.ndarray, " n"], force: Float[np.ndarray, " n"], constant: float
) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """What a piecewise linear force leaves at its knots, q(t) = int exp(-(t - s) / tau) dF(s).

    On a segment of duration D and with x = D / tau, exactly

        q_next = exp(-x) q + (F_next - F) (1 - exp(-x)) / x.

    Parameters
    ----------
    time : (n,) float [s]           not decreasing; equal times are a step of the force
    force : (n,) float              zero before the first knot
    constant : float [s]            tau, > 0

    Returns
    -------
    q : (n,) float                  in the unit of the force
    derivative : (n,) float         of q to log tau
    """
    x = np.diff(time) / constant
    decay, change = np.exp(-x), np.diff(force)
    mean = np.where(x > _SMALL, -np.expm1(-x) / np.maximum(x, _SMALL), 1.0)
    # The recursion is a system with one diagonal below its own: solved in order, by LAPACK.
    band = np.vstack([np.ones(len(time)), np.append(-decay, 0.0)])
    q = solve_banded((1, 0), band, np.append(force[0], change * mean))
    slope = x * decay * q[:-1] + change * (mean - decay)
    return q, solve_banded((1, 0), band, np.append(0.0, slope))


@dataclass(frozen=True, slots=True, eq=False)
class RelaxationModulus:
    """G(t) = long_term + sum_i terms_i exp(-t / times_i): force over a displacement that is held.

    Parameters
    ----------
    long_term : float               G_inf
    terms : (m,) float              G_i, same unit, >= 0
    times : (m,) float [s]          relaxation times rho_i
    """

    long_term: float
    terms: Float[np.ndarray, " m"]
    times: Float[np.ndarray, " m"]

    @property
    def instantaneous(self) -> float:
        """G_0 = G_inf + sum_i G_i."""
        return float(self.long_term + self.terms.sum())

    def at(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """G at times after the displacement began, (n,) [s]."""
        return self.long_term + np.exp(-time[:, None] / self.times) @ self.terms

    def loss_angle(self, frequency: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """Angle by which the displacement lags behind a force that oscillates [rad]: that of
        G_inf + sum_i G_i i w rho_i / (1 + i w rho_i), with w = 2 pi frequency [Hz].

        Source
        ------
        Ferry, Viscoelastic properties of polymers (3rd ed. 1980), chapter 3
        """
        turned = 2j * np.pi * frequency[:, None] * self.times
        return np.angle(self.long_term + (turned / (1.0 + turned)) @ self.terms)


@dataclass(frozen=True, slots=True, eq=False)
class CreepCompliance:
    """J(t) = instantaneous + sum_i terms_i (1 - exp(-t / times_i)): displacement over a force that
    is held.

    Parameters
    ----------
    instantaneous : float           J_0 > 0
    terms : (m,) float              J_i >= 0, same unit
    times : (m,) float [s]          retardation times tau_i > 0

    Raises
    ------
    InputError                      a value out of range
    """

    instantaneous: float
    terms: Float[np.ndarray, " m"]
    times: Float[np.ndarray, " m"]

    def __post_init__(self) -> None:
        fix_fields(self, terms=(None,))
        fix_fields(self, times=(len(self.terms),))
        if not (self.instantaneous > 0.0 and (self.terms >= 0.0).all() and (self.times > 0).all()):
            raise InputError(
                f"a compliance has J_0 = {self.instantaneous:g}, terms {self.terms.tolist()} and"
                f" times {self.times.tolist()} s; J_0 and times are positive, no term is negative"
            )

    def at(self, time: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        """J at times after the force began, (n,) [s]."""
        return self.instantaneous - np.expm1(-time[:, None] / self.times) @ self.terms

    def response(
        self, time: Float[np.ndarray, " n"], force: Float[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """c(t) = int J(t - s) dF(s) at the knots of a piecewise linear force, without error.

        Parameters
        ----------
        time, force : (n,) float    as in `memory`

        Returns
        -------
        (n,) float
        """
        response = self.instantaneous * force
        for term, constant in zip(self.terms, self.times, strict=True):
            response = response + term * (force - memory(time, force, constant)[0])
        return response

    def relaxation(self) -> RelaxationModulus:
        """The modulus whose convolution with this compliance is the time: exact, all terms >= 0.

        With the displacement held at 1 the force is (1 - b . y) / J_0, where
        y' = -M y + b / J_0, M = diag(1 / tau) + b b^T / J_0 and b_i = sqrt(J_i / tau_i). M is
        symmetric and positive: its eigenvalues are 1 / rho_i, the poles of G.

        Returns
        -------
        RelaxationModulus           as many terms; shortest times first
        """
        coupling = np.sqrt(self.terms / self.times)
        matrix = np.diag(1.0 / self.times) + np.outer(coupling, coupling) / self.instantaneous
        rate, vector = np.linalg.eigh(matrix)
        rate, vector = rate[::-1], vector[:, ::-1]
        moduli = (vector.T @ coupling) ** 2 / (rate * self.instantaneous**2)
        # Not 1 / J_0 minus the others, which would cancel where little is left.
        return RelaxationModulus(1.0 / (self.instantaneous + self.terms.sum()), moduli, 1.0 / rate)
