"""Forces on supports, and supports that give as beds of springs: which do, and how much."""

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


def giving_supports(session: Session) -> tuple[int, ...]:
    """Supports that have a stiffness, or all where they may give more than the session says.

    Parameters
    ----------
    session : Session

    Returns
    -------
    tuple of int                    from 0
    """
    every = session.errors.support_compliance > 0.0
    return tuple(k for k, one in enumerate(session.supports) if every or one.stiffness is not None)


def compliances(session: Session) -> Float[np.ndarray, " s"]:
    """Displacement over traction of each of these supports.

    Parameters
    ----------
    session : Session

    Returns
    -------
    (s,) float [m/Pa]               0: rigid
    """
    return np.array([session.supports[k].compliance for k in giving_supports(session)])


def session_springs(session: Session, system: BoundarySystem) -> Springs | None:
    """Springs under the supports that give.

    Parameters
    ----------
    session : Session
    system : BoundarySystem         of its object

    Returns
    -------
    Springs or None                 None: all supports are rigid
    """
    giving = giving_supports(session)
    if not giving:
        return None
    stiff = [one.triangles for k, one in enumerate(session.supports) if k not in giving]
    return make_springs(
        system,
        [session.supports[k].triangles for k in giving],
        np.concatenate([np.zeros(0, dtype=np.int64), *stiff]),
    )


def weight_on_springs(
    system: BoundarySystem, springs: Springs, body: BodyForce
) -> Float[np.ndarray, " e"]:
    """What the particular solution of a body force presses on every spring.

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
    return springs.pressed @ unknowns * system.traction_length


def springs_at(
    equations: PointEquations, springs: Springs, point: int
) -> Float[np.ndarray, "2 3 e"]:
    """What the springs do to the equations at one point, as more columns of their matrix.

    Parameters
    ----------
    equations : PointEquations
    springs : Springs               of the same object
    point : int                     its number among theirs

    Returns
    -------
    (2, 3, e) float                 constant and slope in Poisson's ratio
    """
    columns = spring_columns(equations.system, springs)
    return -np.stack([equations.by_point(part)[point] for part in columns])


def support_force(
    system: BoundarySystem, triangles: Int[np.ndarray, " k"], springs: Springs | None
) -> csr_array:
    """Force on some held triangles from the unknowns, for a shear modulus of one pascal.

    Parameters
    ----------
    system : BoundarySystem
    triangles : (k,) int
    springs : Springs or None       whose displacements are unknowns, too

    Returns
    -------
    (3, n) sparse [N/m]
    """
    size = system.size + (0 if springs is None else len(springs.share))
    weights = integral_weights(system.surface, triangles)[system.unknowns.held_sides]
    first = 3 * system.unknowns.free_vertices.size
    side, axis = np.repeat(np.arange(weights.size), 3), np.tile(np.arange(3), weights.size)
    value = np.repeat(weights / system.traction_length, 3)
    return csr_array(coo_array((value, (axis, first + 3 * side + axis)), shape=(3, size)))
