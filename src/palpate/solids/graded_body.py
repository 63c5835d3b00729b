"""A supported solid whose shear modulus differs from element to element.

Displacements are those of a mean modulus of 1 Pa: element e has the modulus exp(m[e]). With them
come their derivatives with respect to every m[e], from one more solution for each observed
component:

    d u_a / d m_e = -exp(m_e) w_a' K_e u,      K(m) = sum_e exp(m_e) K_e,

u the displacement under a load, w_a that under a unit load where and along which u_a is observed.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array

from palpate.solids.finite_elements import free_part, quadratic_basis, solve_free
from palpate.solids.sparse_cholesky import Cholesky, factorise
from palpate.solids.tetrahedra import Solid

# Elements whose strains are held at a time: 24 numbers for each and for each observed component.
_BLOCK = 64


@dataclass(frozen=True, slots=True, eq=False)
class GradedBody:
    """Elements of a supported solid, ready to be assembled with any field of moduli.

    Attributes
    ----------
    solid : Solid
    held : (n,) bool                fixed nodes
    strain : (m, q, 6, 30) float    strain (xx, yy, zz, and twice xy, yz, zx) at q quadrature points
                                    of each element per unit of its unknowns [1/m]
    weight : (m, q) float [m^3]     of the quadrature
    """

    solid: Solid
    held: Bool[np.ndarray, " n"]
    strain: Float[np.ndarray, "m q 6 30"]
    weight: Float[np.ndarray, "m q"]

    @property
    def volume(self) -> Float[np.ndarray, " m"]:
        """Volume of every element [m^3]."""
        return self.weight.sum(axis=1)

    @property
    def centre(self) -> Float[np.ndarray, "m 3"]:
        """Centre of every element [m]."""
        return self.solid.nodes[self.solid.elements[:, :4]].mean(axis=1)

    @property
    def unknowns(self) -> Int[np.ndarray, "m 30"]:
        """Numbers of each element's unknowns, three components a node."""
        elements = self.solid.elements
        return (3 * elements[:, :, None] + np.arange(3)).reshape(len(elements), 30)


@dataclass(frozen=True, slots=True, eq=False)
class GradedStiffness:
    """A body with its moduli, factorised.

    Attributes
    ----------
    body : GradedBody
    log_modulus : (m,) float        m, logarithm of every element's shear modulus over the mean one
    poisson_ratio : float [-]
    factor : Cholesky               for a mean shear modulus of 1 Pa
    """

    body: GradedBody
    log_modulus: Float[np.ndarray, " m"]
    poisson_ratio: float
    factor: Cholesky

    def displacements(self, load: Float[np.ndarray, "k p"]) -> Float[np.ndarray, "k p"]:
        """Displacement of all nodes under some loads.

        Parameters
        ----------
        load : (3 n, p) float [N]   three components a node

        Returns
        -------
        (3 n, p) float [m Pa]       displacement times the mean shear modulus
        """
        return solve_free(self.body.held, self.factor, load)

    def sensitivities(
        self,
        observed: Float[np.ndarray, "k a"],
        moved: Float[np.ndarray, "k p"],
        basis: Float[np.ndarray, "m b"],
    ) -> Float[np.ndarray, "p a b"]:
        """Derivatives of observed displacements with respect to the coefficients of a field.

        Parameters
        ----------
        observed : (3 n, a) float       displacements under unit loads at what is observed
        moved : (3 n, p) float [m Pa]   displacements under the loads
        basis : (m, b) float            m per unit of each coefficient

        Returns
        -------
        (p, a, b) float [m Pa]
        """
        count, points = moved.shape[1], observed.shape[1]
        result = np.zeros((count, points, basis.shape[1]))
        moduli = _hooke(self.poisson_ratio)
        unknowns = self.body.unknowns
        for part in _blocks(len(basis)):
            strain = self.body.strain[part]
            size = len(strain)
            operator = strain.reshape(size, -1, 30)
            seen = operator @ observed[unknowns[part]]
            own = (operator @ moved[unknowns[part]]).reshape(*strain.shape[:3], count)
            scale = self.body.weight[part] * np.exp(self.log_modulus[part])[:, None]
            stress = np.einsum("ij,eqjp->eqip", moduli, own) * scale[:, :, None, None]
            stress = stress.reshape(size, -1, count)
            energy = np.swapaxes(stress, 1, 2) @ seen
            result -= np.tensordot(energy, basis[part], axes=(0, 0))
        return result

    def energies(self, moved: Float[np.ndarray, "k p"]) -> Float[np.ndarray, "m p"]:
        """Twice the energy of every element under each load: minus the derivative of the work of
        the load by the logarithm of the element's modulus.

        Parameters
        ----------
        moved : (3 n, p) float [m Pa]   displacements under the loads

        Returns
        -------
        (m, p) float
        """
        moduli, unknowns = _hooke(self.poisson_ratio), self.body.unknowns
        energy = np.zeros((len(unknowns), moved.shape[1]))
        for part in _blocks(len(unknowns)):
            strain = self.body.strain[part]
            own = strain.reshape(len(strain), -1, 30) @ moved[unknowns[part]]
            own = own.reshape(*strain.shape[:3], moved.shape[1])
            scale = self.body.weight[part] * np.exp(self.log_modulus[part])[:, None]
            stress = np.einsum("ij,eqjp->eqip", moduli, own)
            energy[part] = np.einsum("eqip,eqip,eq->ep", own, stress, scale)
        return energy


def make_graded_body(solid: Solid, held: Bool[np.ndarray, " n"]) -> GradedBody:
    """The elements of a supported solid.

    Parameters
    ----------
    solid : Solid
    held : (n,) bool                fixed nodes

    Returns
    -------
    GradedBody
    """
    basis = quadratic_basis(solid)
    # (10 functions, 3 directions, m elements, q points)
    slope = np.stack([np.asarray(each[0].grad) for each in basis.basis])
    slope = slope.transpose(2, 3, 1, 0)
    strain = np.zeros((*slope.shape[:2], 6, 10, 3))
    for i in range(3):
        strain[:, :, i, :, i] = slope[:, :, i]
        j = (i + 1) % 3
        strain[:, :, 3 + i, :, i] = slope[:, :, j]
        strain[:, :, 3 + i, :, j] = slope[:, :, i]
    strain = strain.reshape(*slope.shape[:2], 6, 30)
    # scikit-fem's elements number their nodes as `Solid` does.
    return GradedBody(solid, held, strain, np.asarray(basis.dx))


def with_moduli(
    body: GradedBody, log_modulus: Float[np.ndarray, " m"], poisson_ratio: float
) -> GradedStiffness:
    """A body with the modulus of every element, factorised.

    Parameters
    ----------
    body : GradedBody
    log_modulus : (m,) float [-]    logarithm of each element's shear modulus over the mean one
    poisson_ratio : float [-]       -1 < nu < 0.5

    Returns
    -------
    GradedStiffness

    Raises
    ------
    SingularSystemError             the held nodes do not hold the body
    """
    moduli = _hooke(poisson_ratio)
    scale = body.weight * np.exp(log_modulus)[:, None]
    stiffness = np.zeros((len(scale), 30, 30))
    for q in range(scale.shape[1]):
        strain = body.strain[:, q]
        stress = moduli @ strain
        stiffness += scale[:, q, None, None] * (np.swapaxes(strain, 1, 2) @ stress)
    unknowns = body.unknowns
    row = np.repeat(unknowns, 30, axis=1).ravel()
    column = np.tile(unknowns, 30).ravel()
    size = 3 * len(body.solid.nodes)
    matrix = csr_array(coo_array((stiffness.ravel(), (row, column)), shape=(size, size)))
    factor = factorise(free_part(matrix, body.held), body.solid.nodes[~body.held])
    return GradedStiffness(body, log_modulus, poisson_ratio, factor)


def _hooke(poisson_ratio: float) -> Float[np.ndarray, "6 6"]:
    """Stress per strain (xx, yy, zz, and twice xy, yz, zx) for a shear modulus of 1 Pa."""
    moduli = np.diag([2.0, 2.0, 2.0, 1.0, 1.0, 1.0])
    moduli[:3, :3] += 2.0 * poisson_ratio / (1.0 - 2.0 * poisson_ratio)
    return moduli


def _blocks(count: int) -> Iterator[slice]:
    for first in range(0, count, _BLOCK):
        yield slice(first, min(first + _BLOCK, count))
