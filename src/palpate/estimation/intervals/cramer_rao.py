"""The smallest standard deviations that any estimate can have: what a session tells at best."""

from collections.abc import Sequence

import numpy as np

from palpate.errors import InputError
from palpate.estimation.intervals.sandwich import directions
from palpate.estimation.noise import force_components, scaled_rows
from palpate.estimation.observations import ProbeObservations, observed_rows_of


def cramer_rao_bound(
    probes: Sequence[ProbeObservations], *, poisson_ratio: float, shear_modulus: float
) -> dict[str, float]:
    """Cramer-Rao bound on the standard deviations for Gaussian noise of the claimed size.

    Uncertain forces are nuisance parameters, known to their claimed uncertainty.

    Parameters
    ----------
    probes : sequence of ProbeObservations  all with standard deviations
    poisson_ratio : float [-]
    shear_modulus : float [Pa]

    Returns
    -------
    constant's name -> float                nu [-], G and E [Pa]; infinite where nothing tells it

    Raises
    ------
    InputError                              a probing has no standard deviations
    """
    total = np.zeros((2, 2))
    for probe in probes:
        if probe.std is None:
            raise InputError(
                f"probing {probe.name!r} has no std; the bound needs the noise of every point"
            )
        rows = observed_rows_of(probe)
        scaled = scaled_rows(rows, rows.unit, poisson_ratio, with_slope=True)
        load = np.append(rows.force, 1.0) / shear_modulus
        design = np.column_stack([scaled.slope @ load, -(scaled.base @ load)])
        information = design.T @ design
        if force_components(rows):
            push = scaled.base[:, :3] * rows.force_std / shear_modulus
            mixed = push.T @ design
            information -= mixed.T @ np.linalg.solve(push.T @ push + np.eye(3), mixed)
        total += information
    covariance = np.linalg.pinv(total, hermitian=True)
    values = {"poisson_ratio": 1.0, "shear_modulus": shear_modulus}
    values["young_modulus"] = 2 * shear_modulus * (1 + poisson_ratio)
    bound = {}
    for name, turn in directions(poisson_ratio).items():
        told = np.allclose(total @ covariance @ turn, turn, atol=1e-6)
        spread = float(np.sqrt(turn @ covariance @ turn)) if told else np.inf
        bound[name] = values[name] * spread
    return bound
