"""The paper's baseline: a Nelder-Mead simplex over (nu, G) on the full misfit.

Slow and simple: it uses exact responses and the same misfit, so it serves to check the fast path.

Source
------
Paper, section 3.2, which uses Matlab's fmins.
"""

import numpy as np
from scipy.optimize import minimize

from palpate.estimation.search.local_probe import SearchState
from palpate.estimation.search.misfit import Misfit
from palpate.estimation.search.scoring import Minimum

_TOLERANCE = 1e-9
_MAX_EVALUATIONS = 600
_FIRST_STEP = 0.05
_MAX_LOG_FACTOR = 25.0


def nelder_mead_minimum(
    misfit: Misfit, start: SearchState, *, poisson_range: tuple[float, float]
) -> Minimum:
    """Minimum of the misfit by a simplex over (nu, log G).

    Parameters
    ----------
    misfit : Misfit
    start : SearchState             its constants are the start
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
    shear_modulus = start.shear_modulus
    first = np.array([np.clip(start.poisson_ratio, low, high), 0.0])
    inward = _FIRST_STEP if first[0] + _FIRST_STEP <= high else -_FIRST_STEP
    simplex = first + np.array([[0.0, 0.0], [inward, 0.0], [0.0, _FIRST_STEP]])
    result = minimize(
        lambda x: misfit(float(x[0]), shear_modulus * float(np.exp(x[1]))),
        first,
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
