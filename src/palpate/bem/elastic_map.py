"""The linear elastic map from loads to vertex displacements and support tractions.

Source: Lang and Pai (2001), eq. 5.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.bem.integrals.kelvin import check_material
from palpate.bem.integrals.surface import integral_weights
from palpate.bem.loads.local_indentation import (
    indentation_corrections,
    load_right_hand,
    missed_indentation,
)
from palpate.bem.loads.surface_load import SurfaceLoad
from palpate.bem.solver import Solve, make_solver
from palpate.bem.system.factors import CentredSystem
from palpate.bem.system.springs import (
    Springs,
    SpringSystem,
    make_spring_factors,
    make_spring_system,
)
from palpate.bem.system.system import BoundarySystem
from palpate.geometry import interpolation_matrix


@dataclass(frozen=True, slots=True, eq=False)
class ElasticState:
    """Response of an object to one load.

    Attributes
    ----------
    displacement : (v, 3) float [m]       of every vertex
    support_traction : (s, 3) float [Pa]  at the held sides of the vertices,
                                          `system.unknowns.held_sides`
    reaction : (3,) float [N]             force of the support on the object
    """

    displacement: Float[np.ndarray, "v 3"]
    support_traction: Float[np.ndarray, "s 3"]
    reaction: Float[np.ndarray, "3"]


@dataclass(frozen=True, slots=True, eq=False)
class ElasticMap:
    """Elastic response of a held object with given elastic constants.

    Attributes
    ----------
    system : BoundarySystem
    solve : callable                      right-hand sides -> unknowns, on rigid supports
    shear_modulus : float [Pa]
    poisson_ratio : float [-]
    springs : SpringSystem or None        of compliant supports; None: rigid supports
    """

    system: BoundarySystem
    solve: Solve
    shear_modulus: float
    poisson_ratio: float
    springs: SpringSystem | None = None

    def respond(
        self, loads: Sequence[SurfaceLoad], forces: Float[np.ndarray, "k 3"]
    ) -> list[ElasticState]:
        """Response to each load acting alone.

        Parameters
        ----------
        loads : sequence of k SurfaceLoad
        forces : (k, 3) float [N]         resultant of each load, acting on the object

        Returns
        -------
        list of k ElasticState

        Raises
        ------
        InputError                        a load covers no part of the free surface
        NotConvergedError                 the iteration for a compressed system does not converge
        """
        surface = self.system.surface
        corrections = indentation_corrections(surface, loads)
        right = load_right_hand(self.system, loads, corrections)
        if self.springs is None:
            unit = self.solve(right.at(self.poisson_ratio)) / self.shear_modulus
        else:
            right = right.on_springs(self.springs.compliance, self.springs.compliance_derivatives)
            unit = self.springs.solve(right.at(self.poisson_ratio)) / self.shear_modulus
        unit = unit.reshape(-1, len(loads), 3)
        return [self.state(unit[:, k] @ force) for k, force in enumerate(forces)]

    def state(self, unknowns: Float[np.ndarray, " k"]) -> ElasticState:
        """Split a solution vector into displacement, traction and reaction.

        Parameters
        ----------
        unknowns : (k,) float [m]         free displacements, scaled tractions, slack, then the
                                          displacements of springs, if any

        Returns
        -------
        ElasticState
        """
        state = sorted_state(self.system, unknowns[: self.system.size], self.shear_modulus)
        if self.springs is None:
            return state
        displacement = (
            self.springs.factors.springs.displacement_basis @ unknowns[self.system.size :]
        )
        return replace(
            state,
            displacement=state.displacement + displacement.reshape(-1, 3),
        )

    def at_point(
        self,
        loads: Sequence[SurfaceLoad],
        forces: Float[np.ndarray, "k 3"],
        states: Sequence[ElasticState],
        triangle: int,
        barycentric: Float[np.ndarray, "3"],
    ) -> Float[np.ndarray, "3"]:
        """Displacement of a point of the free surface under some loads together.

        Parameters
        ----------
        loads : sequence of k SurfaceLoad
        forces : (k, 3) float [N]         resultant of each load, acting on the object
        states : sequence of k ElasticState    the responses
        triangle : int
        barycentric : (3,) float [-]

        Returns
        -------
        (3,) float [m]
        """
        where = np.array([triangle]), barycentric[None]
        at_point = interpolation_matrix(self.system.surface.displacement, *where)
        total = np.zeros(3)
        corrections = indentation_corrections(self.system.surface, loads)
        for correction, force, state in zip(corrections, forces, states, strict=True):
            total += (at_point @ state.displacement)[0]
            if correction is not None:
                missed = missed_indentation(self.system.surface, correction.dip, *where)[:, 0]
                dip = missed[0] + self.poisson_ratio * missed[1]
                total += dip @ force / self.shear_modulus
        return total


def make_elastic_map(
    system: BoundarySystem,
    *,
    shear_modulus: float,
    poisson_ratio: float,
    springs: Springs | None = None,
    compliance: Float[np.ndarray, " s"] | None = None,
) -> ElasticMap:
    """The elastic map of an object for one material.

    Parameters
    ----------
    system : BoundarySystem           from `boundary_system`
    shear_modulus : float [Pa]        > 0
    poisson_ratio : float [-]         -1 < nu <= 0.5
    springs : Springs or None         of the compliant supports; by dense factors, whatever the size
    compliance : (s,) float [m/Pa]    of each of these supports: displacement over traction;
                                      without springs and compliance all supports are rigid

    Returns
    -------
    ElasticMap

    Raises
    ------
    InputError                        constants out of range
    SingularSystemError               the matrix is singular to working precision
    """
    check_material(shear_modulus, poisson_ratio)
    solve = make_solver(system).at(poisson_ratio, keep=True)
    on_springs = None
    if springs is not None and compliance is not None:
        factorised = CentredSystem(system, poisson_ratio).factorised
        spring_compliance = springs.compliance(compliance * shear_modulus / system.traction_length)
        no_derivatives = np.zeros((0, spring_compliance.size))
        on_springs = make_spring_system(
            make_spring_factors(factorised, system, springs), spring_compliance, no_derivatives
        )
    return ElasticMap(system, solve, shear_modulus, poisson_ratio, on_springs)


def sorted_state(
    system: BoundarySystem, unknowns: Float[np.ndarray, " k"], shear_modulus: float
) -> ElasticState:
    """Split a solution of the system into displacement, traction and reaction.

    Parameters
    ----------
    system : BoundarySystem
    unknowns : (k,) float [m]         free displacements, scaled tractions, slack
    shear_modulus : float [Pa]

    Returns
    -------
    ElasticState
    """
    n_free = system.unknowns.free_vertices.size
    displacement = np.zeros_like(system.surface.mesh.vertices)
    displacement[system.unknowns.free_vertices] = unknowns[: 3 * n_free].reshape(-1, 3)
    scale = shear_modulus / system.traction_length
    traction = unknowns[3 * n_free : -3].reshape(-1, 3) * scale
    weights = integral_weights(system.surface, np.flatnonzero(system.surface.held))
    reaction = weights[system.unknowns.held_sides] @ traction
    return ElasticState(displacement, traction, reaction)
