"""Compliant supports: springs under the held vertices (Winkler foundation).

The foundation exerts the traction -k u, with k its stiffness and u the displacement of the surface
against it. The displacements w of the held vertices become unknowns in addition to x:

    matrix(nu) x - columns(nu) w = right,      compliance * mean_traction x + w = right of springs,

with the dimensionless compliance G / (k traction_length); x and w are displacements times the shear
modulus. Like the system of a rigid support, which a compliance of zero recovers, this one is linear
in nu. The factorisation of the rigid system is reused, which leaves a small dense system for w. The
derivative with respect to the compliance is exact and takes one more solve.

Source
------
Winkler, Die Lehre von der Elasticitaet und Festigkeit (1867), paragraph 195.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import lu_factor, lu_solve
from scipy.sparse import csr_array

from palpate.arrays import components_of
from palpate.bem.integrals.surface import integral_weights
from palpate.bem.system.factors import FactorisedSystem, bases, solve
from palpate.bem.system.matrix import SystemSlope
from palpate.bem.system.system import BoundarySystem
from palpate.geometry import triangle_areas


@dataclass(frozen=True, slots=True, eq=False)
class Springs:
    """Springs under the held vertices of a system, along the directions in which these are held.

    Attributes
    ----------
    displacement_basis : (3 v, e) sparse    displacement of all vertices per unit displacement of
                                  each spring
    mean_traction : (e, k) sparse on each spring from the unknowns of the system
    support_fraction : (e, s) float    fraction of each spring that belongs to each of s supports;
                                  rows sum to 1
    """

    displacement_basis: csr_array
    mean_traction: csr_array
    support_fraction: Float[np.ndarray, "e s"]

    def compliance(self, support_compliance: Float[np.ndarray, " s"]) -> Float[np.ndarray, " e"]:
        """Compliance of every spring; zero where one of the supports that share it is rigid.

        Parameters
        ----------
        support_compliance : (s,) float [m/Pa]    >= 0; 0: rigid

        Returns
        -------
        (e,) float [m/Pa]
        """
        return support_compliance @ self.compliance_derivatives(support_compliance)

    def compliance_derivatives(
        self, support_compliance: Float[np.ndarray, " s"]
    ) -> Float[np.ndarray, "s e"]:
        """Derivative of `compliance` with respect to the compliance of each support.

        Parameters
        ----------
        support_compliance : (s,) float [m/Pa]    >= 0; 0: rigid

        Returns
        -------
        (s, e) float [-]
        """
        supported = self.support_fraction > 0.0
        fixed = (supported.sum(axis=1) > 1) & (supported & (support_compliance == 0.0)).any(axis=1)
        return np.where(fixed, 0.0, self.support_fraction.T)


def make_springs(
    system: BoundarySystem, supports: Sequence[Int[np.ndarray, " _"]], rigid: Int[np.ndarray, " r"]
) -> Springs:
    """Springs under some of the supports of a system.

    Parameters
    ----------
    system : BoundarySystem
    supports : sequence of s (_,) int     triangles of each compliant support
    rigid : (r,) int                      triangles of the rigid supports

    Returns
    -------
    Springs                               none at vertices that a rigid support holds, too
    """
    surface, unknowns = system.surface, system.unknowns
    side_vertex = surface.sides.vertex[unknowns.held_sides]
    count = len(surface.mesh.vertices)
    weight = np.zeros((count, len(supports)))
    area = triangle_areas(surface.mesh)
    for k, triangles in enumerate(supports):
        np.add.at(weight[:, k], surface.mesh.triangles[triangles], area[triangles, None])
    weight[surface.mesh.triangles[rigid]] = 0.0
    held = unknowns.held_vertices
    basis = bases(unknowns.vertex_directions * (weight[held].sum(axis=1) > 0.0)[:, None, None])
    # From the held vertices to all vertices, three rows each.
    rows = components_of(held)
    extension = csr_array(
        (np.ones(rows.size), (rows, np.arange(rows.size))), shape=(3 * count, rows.size)
    )
    displacement_basis = csr_array(extension @ basis)
    by_column = displacement_basis.tocsc()
    vertex = by_column.indices[by_column.indptr[:-1]] // 3
    return Springs(
        displacement_basis,
        _mean_traction(system, displacement_basis, side_vertex),
        weight[vertex] / weight[vertex].sum(axis=1, keepdims=True),
    )


def _mean_traction(
    system: BoundarySystem, displacement_basis: csr_array, side_vertex: Int[np.ndarray, " s"]
) -> csr_array:
    """Traction on each spring: the area-weighted mean over the sides of its vertex, so that all
    springs together carry the force on the support."""
    held = np.flatnonzero(system.surface.held)
    weight = integral_weights(system.surface, held)[system.unknowns.held_sides]
    total = np.zeros(len(system.surface.mesh.vertices))
    np.add.at(total, side_vertex, weight)
    value = np.repeat(weight / total[side_vertex], 3)
    first = 3 * system.unknowns.free_vertices.size
    row = components_of(side_vertex)
    mean = csr_array(
        (value, (row, first + np.arange(row.size))),
        shape=(displacement_basis.shape[0], system.size),
    )
    return csr_array(displacement_basis.T @ mean)


def spring_columns(system: BoundarySystem, springs: Springs) -> Float[np.ndarray, "2 r e"]:
    """Contribution of a unit displacement of each spring to the equations of a system.

    Parameters
    ----------
    system : BoundarySystem
    springs : Springs

    Returns
    -------
    (2, r, e) float               constant and slope in nu, for a shear modulus of one pascal
    """
    held = system.unknowns.held_vertices
    basis = springs.displacement_basis[components_of(held)]
    return system.held_columns(basis)


@dataclass(frozen=True, slots=True, eq=False)
class SpringFactors:
    """Factors of the system of an object on springs that do not depend on the springs' stiffness.

    Attributes
    ----------
    factorised : FactorisedSystem         of the same object on a rigid support
    springs : Springs
    columns : (2, r, e) float             `spring_columns`
    unit_solutions : (k, e) float         x for a unit displacement w of each spring alone
    """

    factorised: FactorisedSystem
    springs: Springs
    columns: Float[np.ndarray, "2 r e"]
    unit_solutions: Float[np.ndarray, "k e"]


def make_spring_factors(
    factorised: FactorisedSystem, system: BoundarySystem, springs: Springs
) -> SpringFactors:
    """Solve for a unit displacement of each spring.

    Parameters
    ----------
    factorised : FactorisedSystem
    system : BoundarySystem               that was factorised
    springs : Springs

    Returns
    -------
    SpringFactors
    """
    columns = spring_columns(system, springs)
    constant, slope = columns
    unit_solutions = solve(factorised, constant + factorised.poisson_ratio * slope)
    return SpringFactors(factorised, springs, columns, unit_solutions)


@dataclass(frozen=True, slots=True, eq=False)
class SpringSystem:
    """The system of an object on springs at one Poisson's ratio, with its derivatives with respect
    to their compliance.

    Its vectors are 1 + d stacked blocks: the unknowns x and w, then their derivatives with respect
    to the compliance of each of d sets of springs.

    Attributes
    ----------
    factors : SpringFactors
    compliance : (e,) float               G / (k traction_length); 0: rigid
    compliance_derivatives : (d, e) float    with respect to that of each of d sets of springs
    schur_factors : (e, e) float, (e,) int    LU factors of the Schur complement for w
    """

    factors: SpringFactors
    compliance: Float[np.ndarray, " e"]
    compliance_derivatives: Float[np.ndarray, "d e"]
    schur_factors: tuple[Float[np.ndarray, "e e"], Int[np.ndarray, " e"]]

    def solve(self, right: Float[np.ndarray, "r c"]) -> Float[np.ndarray, "n c"]:
        """Solve for several right-hand sides.

        Parameters
        ----------
        right : (r, c) float      1 + d blocks: the system's equations, then those of the springs

        Returns
        -------
        (n, c) float              1 + d blocks of x and w
        """
        mean_traction, unit_solutions = (
            self.factors.springs.mean_traction,
            self.factors.unit_solutions,
        )
        count, compliance = self.compliance.size, self.compliance[:, None]
        blocks = np.split(right, 1 + len(self.compliance_derivatives))
        # One solve for all blocks: the factors are read once for many columns.
        rigid_solutions = solve(
            self.factors.factorised, np.hstack([block[:-count] for block in blocks])
        )
        solved: list[np.ndarray] = []
        for k, (block, rigid) in enumerate(
            zip(blocks, np.split(rigid_solutions, len(blocks), axis=1), strict=True)
        ):
            residual = block[-count:] - compliance * (mean_traction @ rigid)
            if k:
                residual -= self.compliance_derivatives[k - 1][:, None] * (
                    mean_traction @ solved[0][:-count]
                )
            displacement = lu_solve(self.schur_factors, residual, check_finite=False)
            solved.append(np.concatenate([rigid + unit_solutions @ displacement, displacement]))
        return np.concatenate(solved)


def make_spring_system(
    factors: SpringFactors,
    compliance: Float[np.ndarray, " e"],
    compliance_derivatives: Float[np.ndarray, "d e"],
) -> SpringSystem:
    """Factorise the Schur complement for the displacements of the springs.

    Parameters
    ----------
    factors : SpringFactors
    compliance : (e,) float               G / (k traction_length); 0: rigid
    compliance_derivatives : (d, e) float    with respect to that of each of d sets of springs

    Returns
    -------
    SpringSystem
    """
    schur = np.eye(compliance.size) + compliance[:, None] * (
        factors.springs.mean_traction @ factors.unit_solutions
    )
    return SpringSystem(
        factors, compliance, compliance_derivatives, lu_factor(schur, check_finite=False)
    )


@dataclass(frozen=True, slots=True, eq=False)
class SpringSlope:
    """Derivative of a spring system's matrix with respect to Poisson's ratio.

    Attributes
    ----------
    slope : SystemSlope
    columns : (r, e) float                slope of `spring_columns` in nu
    blocks : int                          1 + d, see `SpringSystem`
    """

    slope: SystemSlope
    columns: Float[np.ndarray, "r e"]
    blocks: int

    def apply(self, unknowns: Float[np.ndarray, "n c"]) -> Float[np.ndarray, "r c"]:
        """Product with vectors of unknowns.

        Parameters
        ----------
        unknowns : (n, c) float

        Returns
        -------
        (r, c) float
        """
        count = self.columns.shape[1]
        parts = []
        for block in np.split(unknowns, self.blocks):
            x, w = block[:-count], block[-count:]
            parts += [self.slope.apply(x) - self.columns @ w, np.zeros_like(w)]
        return np.concatenate(parts)
