"""Settlement into spring supports, separated because it does not depend on the object's modulus.

Variable projection needs displacements proportional to 1 / G. Near a minimum the response of an
object on springs of known stiffness is affine in G, R = A + C G, so its displacement R F / G is A
F / G plus C F, and the latter is treated as a known motion.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from palpate.estimation.observed_rows import ObservedRows
from palpate.estimation.responses import ResponseTable
from palpate.estimation.search.scoring import Minimum


def without_settlement(
    rows: Sequence[ObservedRows], table: ResponseTable, minimum: Minimum
) -> tuple[tuple[ObservedRows, ...], ResponseTable]:
    """Probings and their responses, with the settlement as one more known motion.

    Parameters
    ----------
    rows : sequence of ObservedRows
    table : ResponseTable               of these
    minimum : Minimum                   supplies the modulus and forces of the settlement

    Returns
    -------
    (tuple of ObservedRows, ResponseTable)      unchanged where no support is a spring
    """
    if all(row.observations.settlement is None for row in rows):
        return tuple(rows), table
    responses = []
    for row, response, local in zip(rows, table.response, minimum.probes, strict=True):
        load = row.load(minimum.shear_modulus, local.shift)[:4]
        separated = np.concatenate([response, np.zeros_like(response[:, :1])], axis=1)
        for nu, columns in zip(table.poisson_ratio, separated, strict=True):
            settling = row.settling(float(nu), minimum.shear_modulus)
            if settling is not None:
                columns[:4] -= settling[:, :4].T
                columns[-1] = settling[:, :4] @ load
        responses.append(separated)
    return tuple(map(_with_motion, rows)), replace(table, response=tuple(responses))


def _with_motion(row: ObservedRows) -> ObservedRows:
    """The same with one more known motion."""
    seen = row.observations
    motion, motion_std = np.append(seen.motion, 1.0), np.append(seen.motion_std, 0.0)
    return replace(row, observations=replace(seen, motion=motion, motion_std=motion_std))
