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
    if all(row.settlement is None for row in rows):
        return tuple(rows), table
    responses = []
    for row, response, local in zip(rows, table.response, minimum.probes, strict=True):
        load = row.load(minimum.shear_modulus, local.shift)[:4]
        separated = []
        for nu, columns in zip(table.poisson_ratio, response, strict=True):
            settling = row.settling(float(nu), minimum.shear_modulus)
            elastic, settled = columns.copy(), np.zeros(columns.shape[1])
            if settling is not None:
                elastic[:4] -= settling[:, :4].T
                settled = settling[:, :4] @ load
            separated.append(np.vstack([elastic, settled]))
        responses.append(np.stack(separated))
    with_settlement = tuple(
        replace(row, motion=np.append(row.motion, 1.0), motion_std=np.append(row.motion_std, 0.0))
        for row in rows
    )
    return with_settlement, replace(table, response=tuple(responses))
