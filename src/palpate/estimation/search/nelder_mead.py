"""The paper's baseline: a Nelder-Mead simplex over (nu, G) on the full misfit.

Slow and simple: it uses exact responses and the same misfit, so it serves to check the fast path.

Source
------
Paper, section 3.2, which uses Matlab's fmins.
"""

import numpy as np
from scipy.optimize import minimize

from palpate.estimation.search.misfit import Misfit
from palpate.estimation.search.scoring import Minimum

_TOLERANCE = 1e-9
_MAX_EVALUATIONS = 600
_FIRST_STEP = 0.05
_MAX_LOG_FACTOR = 25.0


def nelder_mead_minimum(
    misfit: Misfit,
    poisson_ratio: float,
    shear_modulus: float,
    *,
    poisson_range: tuple[float, float],
) -> Minimum:
    """Minimum of the misfit by a simplex over (nu, log G).

    Parameters
    ----------
    misfit : Misfit
    poisson_ratio : float [-]       start
    shear_modulus : float [Pa]      start, > 0
    poisson_range : (float, float)  Poisson's ratio stays inside

    Returns
    -------
    Minimum                         nu and log G to about 1e-8, probings linearised there;
                                    `converged` is false if the limit of evaluations was reached

    Raises
    ------
    NotConvergedError               the true force of a probing did not converge
    """
    low, high = poisson_range
    start = np.array([np.clip(poisson_ratio, low, high), 0.0])
    inward = _FIRST_STEP if start[0] + _FIRST_STEP <= high else -_FIRST_STEP
    simplex = start + np.array([[0.0, 0.0], [inward, 0.0], [0.0, _FIRST_STEP]])
    result = minimize(
        lambda x: misfit(float(x[0]), shear_modulus * float(np.exp(x[1]))),
        start,
        method="Nelder-Mead",
        bounds=[poisson_range, (-_MAX_LOG_FACTOR, _MAX_LOG_FACTOR)],
        options={
            "initial_simplex": simplex,
            "xatol": _TOLERANCE,
            "fatol": np.inf,
            "maxfev": _MAX_EVALUATIONS,
        },
    )
    nu, modulus = float(result.x[0]), shear_modulus * float(np.exp(result.x[1]))
    errors, local = misfit.at_best_forces(nu, modulus)
    return Minimum(nu, modulus, local, errors, bool(result.success))
