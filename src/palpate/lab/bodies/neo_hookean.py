"""The same body at finite strain: what the linear model leaves out when it is pressed far."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError, NotConvergedError, SingularSystemError
from palpate.lab.bodies.finite_elements import Body, free_part
from palpate.lab.bodies.quadratic_elements import Gradients, block_matrix, shape_gradients
from palpate.lab.bodies.sparse_cholesky import factorise

_ROUNDS = 25
# Forces out of balance, of the load: Newton's last step leaves rounding.
_BALANCED = 1e-9
_HALVINGS = 8


@dataclass(frozen=True, slots=True, eq=False)
class FiniteStrain:
    """Equilibrium of a body under a load that keeps its direction.

    Parameters
    ----------
    displacement : (n, 3) float [m]
    reaction : (3,) float [N]       of the support on the body
    energy : float [J]              stored in the body
    rounds : int                    Newton steps, all load steps together
    """

    displacement: Float[np.ndarray, "n 3"]
    reaction: Float[np.ndarray, "3"]
    energy: float
    rounds: int


def solve_finite(body: Body, load: Float[np.ndarray, "n 3"], *, steps: int = 2) -> FiniteStrain:
    """Displacement at finite strain under nodal forces, a dead load.

    The energy per volume at rest is mu/2 (tr C - 3) - mu ln J + lambda/2 (ln J)^2, with C = F^T F,
    J = det F, and mu and lambda of the body's shear modulus and Poisson's ratio: small strains are
    Hooke's.

    Parameters
    ----------
    body : Body
    load : (n, 3) float [N]         forces on the nodes
    steps : int                     equal parts of the load; a part that fails is halved

    Returns
    -------
    FiniteStrain

    Raises
    ------
    InputError                      steps below 1
    NotConvergedError               no stable equilibrium is found: the body buckles, or the load is
                                    too large for the elements

    Source
    ------
    Bonet and Wood, Nonlinear continuum mechanics for finite element analysis (2nd ed. 2008),
    section 6.4.3; tangent by its differential. Newton with steps shortened until no element turns
    over and the energy less the load's work does not rise.
    """
    if steps < 1:
        raise InputError(f"steps is {steps}; must be at least 1")
    slopes = shape_gradients(body.solid)
    displacement = np.zeros_like(body.solid.nodes)
    done, part, rounds = 0.0, 1.0 / steps, 0
    while done < 1.0:
        share = min(1.0, done + part)
        found, used = _newton(body, slopes, share * load, displacement)
        rounds += used
        if found is not None:
            displacement, done = found, share if share < 1.0 - 1e-12 else 1.0
            continue
        part *= 0.5
        if part < 0.5**_HALVINGS / steps:
            raise NotConvergedError(
                f"no equilibrium beyond {100 * done:.1f} % of the load in {rounds} Newton steps:"
                " the body buckles, or is pressed farther than its elements bear; press less, or"
                " use smaller elements there"
            )
    inner = inner_forces(body, slopes, displacement)
    reaction = (inner - load)[body.held].sum(axis=0)
    return FiniteStrain(displacement, reaction, energy(body, slopes, displacement), rounds)


def energy(body: Body, slopes: Gradients, displacement: Float[np.ndarray, "n 3"]) -> float:
    """Stored energy [J]; infinite where an element is turned over."""
    mu, lame = _lame(body)
    strain = _deformation(body, slopes, displacement)
    volume = np.linalg.det(strain)
    if (volume <= 0.0).any():
        return np.inf
    log = np.log(volume)
    squares = np.einsum("mqab,mqab->mq", strain, strain)
    density = 0.5 * mu * (squares - 3.0) - mu * log + 0.5 * lame * log**2
    return float((density * slopes.volume).sum())


def inner_forces(
    body: Body, slopes: Gradients, displacement: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "n 3"]:
    """Slope of the stored energy over the nodes' displacement [N]."""
    mu, lame = _lame(body)
    strain = _deformation(body, slopes, displacement)
    inverse = np.linalg.inv(strain).swapaxes(-1, -2)
    log = np.log(np.linalg.det(strain))[..., None, None]
    stress = mu * strain + (lame * log - mu) * inverse
    force = np.einsum("mq,mqab,mqib->mia", slopes.volume, stress, slopes.gradient)
    total = np.zeros_like(displacement)
    np.add.at(total, body.solid.elements, force)
    return total


def tangent(
    body: Body, slopes: Gradients, displacement: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, "m 10 3 10 3"]:
    """Second slope of every element's energy [N/m].

    With H = F^-T and G the gradients at rest: mu G.G I + (mu - lambda ln J) (H G) x (H G) swapped +
    lambda (H G) x (H G).
    """
    mu, lame = _lame(body)
    strain = _deformation(body, slopes, displacement)
    inverse = np.linalg.inv(strain).swapaxes(-1, -2)
    log = np.log(np.linalg.det(strain))
    now = np.matmul(slopes.gradient, inverse.swapaxes(-1, -2))
    count, points = log.shape
    flat = now.reshape(count, points, 30)

    def product(weight: np.ndarray) -> np.ndarray:
        weighted = (flat * weight[:, :, None]).transpose(0, 2, 1)
        return np.matmul(weighted, flat).reshape(count, 10, 3, 10, 3)

    matrix = lame * product(slopes.volume)
    matrix += product(slopes.volume * (mu - lame * log)).transpose(0, 1, 4, 3, 2)
    same = np.einsum(
        "mqia,mqja->mij", slopes.gradient * slopes.volume[:, :, None, None], slopes.gradient
    )
    for a in range(3):
        matrix[:, :, a, :, a] += mu * same
    return matrix


def _newton(
    body: Body, slopes: Gradients, load: np.ndarray, start: np.ndarray
) -> tuple[np.ndarray | None, int]:
    """Equilibrium near a start, or None, and the number of steps."""
    free = ~body.held
    scale = np.linalg.norm(load[free])
    displacement = start

    def potential(u: np.ndarray) -> float:
        return energy(body, slopes, u) - float((load * u).sum())

    for step in range(1, _ROUNDS + 1):
        missing = load - inner_forces(body, slopes, displacement)
        if np.linalg.norm(missing[free]) <= _BALANCED * scale:
            return displacement, step
        matrix = block_matrix(body.pairs, tangent(body, slopes, displacement))
        try:
            factor = factorise(free_part(matrix, body.held), body.solid.nodes[free])
        except SingularSystemError:
            return None, step
        change = np.zeros_like(displacement)
        change[free] = factor.solve(missing[free].reshape(-1, 1)).reshape(-1, 3)
        shortened = _shortened(potential, displacement, change)
        if shortened is None:
            return None, step
        displacement = shortened
    return None, _ROUNDS


def _shortened(
    potential: Callable[[np.ndarray], float], displacement: np.ndarray, change: np.ndarray
) -> np.ndarray | None:
    """The end of the step, halved until the potential falls (rounding apart); None if it never
    does."""
    before = potential(displacement)
    for _ in range(_HALVINGS):
        after = potential(displacement + change)
        if after <= before + 1e-12 * abs(before):
            return displacement + change
        change = 0.5 * change
    return None


def _lame(body: Body) -> tuple[float, float]:
    """Lame's constants mu and lambda [Pa]."""
    mu, nu = body.shear_modulus, body.poisson_ratio
    return mu, 2.0 * mu * nu / (1.0 - 2.0 * nu)


def _deformation(body: Body, slopes: Gradients, displacement: np.ndarray) -> np.ndarray:
    """Deformation gradient F = I + du/dX at every quadrature point, (m, q, 3, 3)."""
    moved = displacement[body.solid.elements]
    return np.eye(3) + np.einsum("mia,mqib->mqab", moved, slopes.gradient)
