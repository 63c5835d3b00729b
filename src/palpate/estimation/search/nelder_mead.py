"""The paper's baseline: a Nelder-Mead simplex over (nu, G) on the full misfit.

Slow and simple; it uses exact responses and the same misfit, and so checks the fast path.

Source
------
Paper, section 3.2, which uses Matlab's fmins.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from palpate.estimation.noise import Misfit

_TOLERANCE = 1e-9
_EVALUATIONS = 600
_FIRST_STEP = 0.05


@dataclass(frozen=True, slots=True)
class SimplexMinimum:
    """Where the simplex collapsed.

    Parameters
    ----------
    poisson_ratio : float [-]
    shear_modulus : float [Pa]
    loss : float                    misfit there
    evaluations : int               of the misfit
    converged : bool
    """

    poisson_ratio: float
    shear_modulus: float
    loss: float
    evaluations: int
    converged: bool


def nelder_mead_minimum(
    misfit: Misfit,
    poisson_ratio: float,
    shear_modulus: float,
    *,
    poisson_range: tuple[float, float],
) -> SimplexMinimum:
    """Minimum of the misfit by a simplex over (nu, log G).

    Parameters
    ----------
    misfit : Misfit
    poisson_ratio : float [-]       start
    shear_modulus : float [Pa]      start
    poisson_range : (float, float)  Poisson's ratio stays inside

    Returns
    -------
    SimplexMinimum                  nu and log G to about 1e-8
    """
    reference = shear_modulus
    low, high = poisson_range
    start = np.array([np.clip(poisson_ratio, low, high), 0.0])
    inward = _FIRST_STEP if start[0] + _FIRST_STEP <= high else -_FIRST_STEP
    simplex = np.stack(
        [start, start + np.array([inward, 0.0]), start + np.array([0.0, _FIRST_STEP])]
    )
    found = minimize(
        lambda x: misfit(float(x[0]), reference * float(np.exp(x[1]))),
        start,
        method="Nelder-Mead",
        bounds=[poisson_range, (-25.0, 25.0)],
        options={
            "initial_simplex": simplex,
            "xatol": _TOLERANCE,
            "fatol": np.inf,
            "maxfev": _EVALUATIONS,
        },
    )
    nu, modulus = float(found.x[0]), reference * float(np.exp(found.x[1]))
    return SimplexMinimum(nu, modulus, float(found.fun), int(found.nfev), bool(found.success))
