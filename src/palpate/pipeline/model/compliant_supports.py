"""Forces on supports, and compliant supports (beds of springs): which, and how compliant."""

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import coo_array, csr_array

from palpate.bem import (
    BodyForce,
    BoundarySystem,
    PointEquations,
    Springs,
    integral_weights,
    make_springs,
    spring_columns,
)
from palpate.records import Session


def compliant_supports(session: Session) -> tuple[int, ...]:
    """Compliant supports: those with a stiffness, or all where `[errors]` has a support compliance.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of int                    indices of the supports, from 0
    """
    every = session.errors.support_compliance > 0.0
    return tuple(
        k for k, support in enumerate(session.supports) if every or support.stiffness is not None
    )


def compliances(session: Session) -> Float[np.ndarray, " s"]:
    """Compliance (displacement over traction) of each of the `compliant_supports`.

    Parameters
    ----------
    session : Session

    Returns
    -------
    (s,) float [m/Pa]               0: rigid
    """
    return np.array([session.supports[k].compliance for k in compliant_supports(session)])


def session_springs(session: Session, system: BoundarySystem) -> Springs | None:
    """Springs under the compliant supports.

    Parameters
    ----------
    session : Session
    system : BoundarySystem         of its object

    Returns
    -------
    Springs or None                 None: all supports are rigid
    """
    compliant = compliant_supports(session)
    if not compliant:
        return None
    rigid = [support.triangles for k, support in enumerate(session.supports) if k not in compliant]
    return make_springs(
        system,
        [session.supports[k].triangles for k in compliant],
        np.concatenate([np.zeros(0, dtype=np.int64), *rigid]),
    )


def weight_on_springs(
    system: BoundarySystem, springs: Springs, body: BodyForce
) -> Float[np.ndarray, " e"]:
    """Traction of a body force's particular solution on every spring.

    Parameters
    ----------
    system : BoundarySystem
    springs : Springs
    body : BodyForce

    Returns
    -------
    (e,) float [N/m]                traction times `traction_length`
    """
    unknowns = np.zeros(system.size)
    first = 3 * system.unknowns.free_vertices.size
    unknowns[first : first + body.support_traction.size] = body.support_traction.ravel()
    return springs.mean_traction @ unknowns * system.traction_length


def springs_at(
    equations: PointEquations, springs: Springs, point: int
) -> Float[np.ndarray, "2 3 e"]:
    """Further columns of the equations at one point, for the displacements of the springs.

    Parameters
    ----------
    equations : PointEquations
    springs : Springs               of the same object
    point : int                     index among the points of the equations

    Returns
    -------
    (2, 3, e) float                 constant and slope in Poisson's ratio
    """
    columns = spring_columns(equations.system, springs)
    return -np.stack([equations.by_point(part)[point] for part in columns])


def support_force(
    system: BoundarySystem, triangles: Int[np.ndarray, " k"], springs: Springs | None
) -> csr_array:
    """Matrix from the unknowns to the force on some held triangles, for a shear modulus of 1 Pa.

    Parameters
    ----------
    system : BoundarySystem
    triangles : (k,) int
    springs : Springs or None       their displacements are further unknowns

    Returns
    -------
    (3, n) sparse [N/m]
    """
    size = system.size + (0 if springs is None else len(springs.support_fraction))
    weights = integral_weights(system.surface, triangles)[system.unknowns.held_sides]
    first = 3 * system.unknowns.free_vertices.size
    side, axis = np.repeat(np.arange(weights.size), 3), np.tile(np.arange(3), weights.size)
    value = np.repeat(weights / system.traction_length, 3)
    return csr_array(coo_array((value, (axis, first + 3 * side + axis)), shape=(3, size)))
