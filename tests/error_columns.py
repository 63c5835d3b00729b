"""What an error moves under a load: its effects on the response, put together."""

import numpy as np

from palpate.estimation import Nuisance, ResponseTerms

__all__ = ["columns_of", "curvature_of"]


def columns_of(
    error: Nuisance,
    response: np.ndarray,
    load: np.ndarray,
    nu: float,
    rows: np.ndarray | None = None,
) -> np.ndarray:
    """Displacement per standard deviation of each parameter, (r, p) [m], of some rows of the
    response (r, c) under a load (c,)."""
    rows = np.arange(len(response)) if rows is None else rows
    effects = error.effects(ResponseTerms(rows, response[:, None], nu))
    # Entry 3 of the load is 1 / G; the second term does not depend on G.
    factors = (1.0, 1.0 / load[3])
    return sum(
        factor * np.einsum("rcp,c->rp", effects[:, term], load)
        for term, factor in zip(range(effects.shape[1]), factors, strict=False)
    )


def curvature_of(error: Nuisance, response: np.ndarray, load: np.ndarray, nu: float) -> np.ndarray:
    """Second derivatives of the displacement, (r, p, p) [m]."""
    at = ResponseTerms(np.arange(len(response)), response[:, None], nu)
    return error.curvature(at) * load[3]
