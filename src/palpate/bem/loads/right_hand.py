"""Right-hand sides of the system, linear in Poisson's ratio like its matrix."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.bem.integrals import (
    DISPLACEMENT_FIELDS,
    Quadrature,
    assemble,
    element_points,
    quadratic_shapes,
    triangle_rule,
)
from palpate.bem.system import PAIRS, BoundarySystem, restrict_collocation
from palpate.geometry import QuadraticNodes


@dataclass(frozen=True, slots=True, eq=False)
class RightHand:
    """Columns constant + nu * slope + nu^2 * curvature, for a shear modulus of one pascal.

    Attributes
    ----------
    constant : (k, c) float
    slope : (k, c) float
    curvature : (k, c) float
    """

    constant: Float[np.ndarray, "k c"]
    slope: Float[np.ndarray, "k c"]
    curvature: Float[np.ndarray, "k c"]

    def at(self, poisson_ratio: float) -> Float[np.ndarray, "k c"]:
        """The columns at one Poisson's ratio.

        Parameters
        ----------
        poisson_ratio : float

        Returns
        -------
        (k, c) float
        """
        return self.constant + poisson_ratio * (self.slope + poisson_ratio * self.curvature)

    def __add__(self, other: "RightHand") -> "RightHand":
        """Sum of two sets of as many columns."""
        return self.plus(other, np.arange(self.constant.shape[1]))

    def plus(self, other: "RightHand", columns: Int[np.ndarray, " c"]) -> "RightHand":
        """These columns with others added to some of them.

        Parameters
        ----------
        other : RightHand         c columns
        columns : (c,) int        distinct columns to which they are added

        Returns
        -------
        RightHand
        """
        parts = []
        for name in ("constant", "slope", "curvature"):
            part = getattr(self, name).copy()
            part[:, columns] += getattr(other, name)
            parts.append(part)
        return RightHand(*parts)


def load_columns(fields: Float[np.ndarray, "r 6"], balance: Float[np.ndarray, "3 3"]) -> RightHand:
    """Three columns, one for each axis of a load of one newton.

    Parameters
    ----------
    fields : (r, 6) float [1/m]       from `integrate_load`
    balance : (3, 3) float [1/m]      minus the total load of each column over `traction_length`

    Returns
    -------
    RightHand                         3 r + 3 rows, 3 columns
    """
    tensor = fields[:, np.array(PAIRS)]
    trace = fields[:, :3].sum(axis=1)[:, None, None] * np.eye(3)
    constant = _stacked(1.5 * trace + 0.5 * tensor, balance)
    return RightHand(constant, _stacked(-2 * trace, np.zeros((3, 3))), np.zeros_like(constant))


def support_columns(system: BoundarySystem, displacement: Float[np.ndarray, "v 3"]) -> RightHand:
    """One column for a given displacement of the held vertices.

    Parameters
    ----------
    system : BoundarySystem
    displacement : (v, 3) float [m]   of every vertex; only that of the held ones is used

    Returns
    -------
    RightHand                         3 r + 3 rows, one column, for a shear modulus of one pascal
    """
    held = system.unknowns.held_vertices
    u = displacement[held]
    blocks = system.traction_kernel
    parts = []
    for values in blocks.values:
        f = values[held]
        skew, flux = f[:, :3], f[:, 3:6].sum(axis=1) / 3
        a = np.einsum("vkl,vj->lkj", skew, u)
        turned = np.stack(
            [a[:, 2, 1] - a[:, 1, 2], a[:, 0, 2] - a[:, 2, 0], a[:, 1, 0] - a[:, 0, 1]]
        )
        part_a = turned - np.einsum("vl,vi->il", flux, u)
        part_b = -np.einsum("vijl,vj->il", f[:, 3 + np.array(PAIRS)], u)
        parts.append((part_a + part_b, -2 * part_a))
    rows = blocks.n_rows
    total = [
        np.concatenate([np.concatenate(part, axis=1)[:, :rows].ravel(), np.zeros(3)])[:, None]
        for part in zip(*parts, strict=True)
    ]
    return RightHand(-total[0], -total[1], np.zeros_like(total[0]))


def traction_column(
    system: BoundarySystem,
    triangles: Int[np.ndarray, " k"],
    traction: Float[np.ndarray, "k 6 3"],
    *,
    quadrature: Quadrature = Quadrature(),
) -> RightHand:
    """One column for a traction that is quadratic on each of some triangles and may jump between
    them.

    Parameters
    ----------
    system : BoundarySystem
    triangles : (k,) int              triangles of the free surface
    traction : (k, 6, 3) float [Pa]   at their corners and at the midpoints of their edges 01, 12,
                                      20
    quadrature : Quadrature

    Returns
    -------
    RightHand                         3 r + 3 rows, one column
    """
    surface = system.surface
    # Three nodes, one an axis, whose shape functions are the components of the traction itself.
    element = 3 + np.arange(6 * triangles.size).reshape(-1, 6)
    nodes = QuadraticNodes(element, 3, csr_array(traction.reshape(-1, 3)))
    chosen = np.zeros(surface.held.size, dtype=bool)
    chosen[triangles] = True
    blocks = assemble(
        restrict_collocation(system.collocation, chosen), surface.mesh.triangles[triangles],
        surface.element_nodes[triangles], nodes, n_fields=DISPLACEMENT_FIELDS,
        quadrature=quadrature,
    )  # fmt: skip
    total = total_traction(surface.element_nodes[triangles], traction)
    balance = -total / system.traction_length
    columns = []
    for axis in range(3):
        fields = blocks.values[:, axis].transpose(0, 2, 1).reshape(-1, DISPLACEMENT_FIELDS)
        column = load_columns(fields[: blocks.n_rows], np.diag(balance))
        columns.append((column.constant[:, axis], column.slope[:, axis]))
    constant, slope = (np.sum(part, axis=0)[:, None] for part in zip(*columns, strict=True))
    return RightHand(constant, slope, np.zeros_like(constant))


def joined(parts: list[RightHand]) -> RightHand:
    """Right-hand sides side by side.

    Parameters
    ----------
    parts : list of RightHand

    Returns
    -------
    RightHand
    """
    return RightHand(
        np.concatenate([part.constant for part in parts], axis=1),
        np.concatenate([part.slope for part in parts], axis=1),
        np.concatenate([part.curvature for part in parts], axis=1),
    )


def total_traction(
    nodes: Float[np.ndarray, "k 6 3"], traction: Float[np.ndarray, "k 6 3"]
) -> Float[np.ndarray, "3"]:
    """Force of a traction that is quadratic on each of some triangles.

    Parameters
    ----------
    nodes : (k, 6, 3) float [m]
    traction : (k, 6, 3) float [Pa]

    Returns
    -------
    (3,) float [N]
    """
    rule = triangle_rule(7)
    area = np.linalg.norm(element_points(nodes, rule.barycentric)[:, :, 3:], axis=2)
    shape = quadratic_shapes(rule.barycentric)
    return np.einsum("q,kq,aq,kai->i", rule.weight, area, shape, traction)


def _stacked(
    tensor: Float[np.ndarray, "r 3 3"], last: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "k 3"]:
    rows = np.concatenate([tensor.transpose(1, 0, 2).reshape(-1, 3), last])
    return np.asfortranarray(rows)
