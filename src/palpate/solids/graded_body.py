"""A supported solid whose shear modulus differs from place to place.

Displacements are those of a mean modulus of 1 Pa: at quadrature point q the modulus is exp(m[q]).
With them come their derivatives with respect to every m[q], from one more solution for each
observed component, or for each load and field:

    d u_a / d m_q = -exp(m_q) w_a' K_q u,      K(m) = sum_q exp(m_q) K_q,

u the displacement under a load, w_a that under a unit load where and along which u_a is observed.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array, csr_array, eye_array, kron

from palpate.arrays import components_of
from palpate.solids.finite_elements import free_part, quadratic_basis, solve_free
from palpate.solids.sparse_cholesky import Cholesky, factorise
from palpate.solids.tetrahedra import Solid

# Observed components whose strains are held at a time, 24 numbers for each and each element.
_BLOCK = 64
# Loads whose energies are held at once.
_LOADS = 8
_ALL = slice(None)
# From strains with twice the shears to Mandel's six-vectors, whose products are those of tensors.
_MANDEL = np.array([1.0, 1.0, 1.0, *[np.sqrt(0.5)] * 3])


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
    points : (m, q, 3) float [m]    of the quadrature
    """

    solid: Solid
    held: Bool[np.ndarray, " n"]
    strain: Float[np.ndarray, "m q 6 30"]
    weight: Float[np.ndarray, "m q"]
    points: Float[np.ndarray, "m q 3"]

    @property
    def volume(self) -> Float[np.ndarray, " m"]:
        """Volume of every element [m^3]."""
        return self.weight.sum(axis=1)

    @property
    def constant(self) -> csr_array:
        """Values at the quadrature points of a function that is constant in every element, (m q, m)
        sparse."""
        elements, points = self.weight.shape
        return csr_array(kron(eye_array(elements), np.ones((points, 1))))

    def means(self, values: Float[np.ndarray, "mq b"]) -> Float[np.ndarray, "m b"]:
        """Means over every element of what is known at the quadrature points."""
        weight = self.weight / self.volume[:, None]
        return np.einsum("eq,eqb->eb", weight, values.reshape(*weight.shape, -1))

    @property
    def unknowns(self) -> Int[np.ndarray, "m 30"]:
        """Numbers of each element's unknowns, three components a node."""
        elements = self.solid.elements
        return components_of(elements.ravel()).reshape(len(elements), 30)


@dataclass(frozen=True, slots=True, eq=False)
class GradedStiffness:
    """A body with its moduli, factorised.

    Attributes
    ----------
    body : GradedBody
    log_modulus : (m q,) float      m, logarithm of the shear modulus over the mean one
    poisson_ratio : float [-]
    factor : Cholesky               for a mean shear modulus of 1 Pa
    """

    body: GradedBody
    log_modulus: Float[np.ndarray, " mq"]
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
        basis: Float[np.ndarray, "mq b"],
    ) -> Float[np.ndarray, "p a b"]:
        """Derivatives of observed displacements with respect to the coefficients of a field.

        Parameters
        ----------
        observed : (3 n, a) float       displacements under unit loads at what is observed
        moved : (3 n, p) float [m Pa]   displacements under the loads
        basis : (m q, b) float          m per unit of each coefficient

        Returns
        -------
        (p, a, b) float32 [m Pa]        of many pushes it is most of what is kept
        """
        # In the precision of the result: products of large matrices take most of the time.
        stress, strain, observed, basis = (
            array.astype(np.float32)
            for array in (self._stress(moved), self.body.strain, observed, basis)
        )
        stress, unknowns = np.swapaxes(stress, 1, 2), self.body.unknowns
        operator = strain.reshape(len(unknowns), -1, 30)
        shape = moved.shape[1], observed.shape[1], basis.shape[1]
        result = np.empty(shape, dtype=np.float32)
        for first in range(0, observed.shape[1], _BLOCK):
            part = observed[:, first : first + _BLOCK]
            seen = (operator @ part[unknowns]).reshape(-1, 6, part.shape[1])
            for begin in range(0, moved.shape[1], _LOADS):
                energy = stress[:, begin : begin + _LOADS] @ seen
                sums = basis.T @ energy.reshape(len(energy), -1)
                own = result[begin : begin + _LOADS, first : first + _BLOCK]
                own[...] = -np.moveaxis(sums.reshape(-1, *energy.shape[1:]), 0, 2)
        return result

    def changes(
        self, moved: Float[np.ndarray, "k p"], basis: Float[np.ndarray, "mq b"]
    ) -> Float[np.ndarray, "p k b"]:
        """Derivatives of all displacements with respect to the coefficients of a few fields: a
        solution for every load and field.

        Parameters
        ----------
        moved : (3 n, p) float [m Pa]   displacements under the loads
        basis : (m q, b) float          m per unit of each coefficient

        Returns
        -------
        (p, 3 n, b) float [m Pa]
        """
        stress, unknowns = self._stress(moved), self.body.unknowns
        strain = self.body.strain.reshape(len(unknowns), -1, 30)
        entries = (unknowns.ravel(), np.arange(unknowns.size))
        gather = csr_array((np.ones(unknowns.size), entries), shape=(len(moved), unknowns.size))
        changes = []
        for field in basis.T:
            scaled = (stress * field[:, None, None]).reshape(*strain.shape[:2], -1)
            force = np.swapaxes(strain, 1, 2) @ scaled
            changes.append(-self.displacements(gather @ force.reshape(unknowns.size, -1)).T)
        return np.stack(changes, axis=2)

    def energies(self, moved: Float[np.ndarray, "k p"]) -> Float[np.ndarray, "mq p"]:
        """Twice the energy at every quadrature point under each load: minus the derivative of the
        work of the load by the logarithm of the modulus there.

        Parameters
        ----------
        moved : (3 n, p) float [m Pa]   displacements under the loads

        Returns
        -------
        (m q, p) float
        """
        body, unknowns = self.body, self.body.unknowns
        scale = body.weight * np.exp(self.log_modulus).reshape(body.weight.shape)
        energy = np.zeros((*scale.shape, moved.shape[1]))
        for q in range(scale.shape[1]):
            strain = body.strain[:, q] @ moved[unknowns]
            stress = _hooke(self.poisson_ratio) @ strain
            energy[:, q] = scale[:, q, None] * (strain * stress).sum(axis=1)
        return energy.reshape(-1, moved.shape[1])

    def strain_products(
        self, observed: Float[np.ndarray, "k a"], moved: Float[np.ndarray, "k p"]
    ) -> Float[np.ndarray, "p a 6 6"]:
        """Integrals over the body of the products of strains, as six-vectors of Mandel's, that a
        change of the elasticity tensor everywhere by the modulus there does work on.

        Parameters
        ----------
        observed : (3 n, a) float       displacements under unit loads at what is observed
        moved : (3 n, p) float [m Pa]   displacements under the loads

        Returns
        -------
        (p, a, 6, 6) float [m Pa]
        """
        scale = self.body.weight.ravel() * np.exp(self.log_modulus)
        loaded = (self._strain(moved) * scale[:, None, None]).reshape(len(scale), -1)
        result = np.zeros((observed.shape[1], 6, 6, moved.shape[1]))
        for first in range(0, observed.shape[1], _BLOCK):
            part = self._strain(observed[:, first : first + _BLOCK])
            products = part.reshape(len(scale), -1).T @ loaded
            shape = (6, part.shape[2], 6, moved.shape[1])
            result[first : first + _BLOCK] = products.reshape(shape).swapaxes(0, 1)
        return result.transpose(3, 0, 1, 2) * np.outer(_MANDEL, _MANDEL)

    def reactions(self, moved: Float[np.ndarray, "k p"]) -> Float[np.ndarray, "h3 p"]:
        """Forces of the support on the held nodes [N], three components a node, under loads
        elsewhere.

        Parameters
        ----------
        moved : (3 n, p) float [m Pa]   displacements under the loads
        """
        body, force = self.body, np.zeros_like(moved)
        near = np.flatnonzero(body.held[body.solid.elements].any(axis=1))
        unknowns, strain = body.unknowns[near], body.strain[near].reshape(len(near), -1, 30)
        for first in range(0, moved.shape[1], _BLOCK):
            part = slice(first, first + _BLOCK)
            stress = self._stress(moved[:, part], near).reshape(*strain.shape[:2], -1)
            np.add.at(force[:, part], unknowns, np.swapaxes(strain, 1, 2) @ stress)
        return force[np.repeat(body.held, 3)]

    def _strain(
        self, moved: Float[np.ndarray, "k p"], elements: Int[np.ndarray, " e"] | slice = _ALL
    ) -> Float[np.ndarray, "eq 6 p"]:
        strain, unknowns = self.body.strain[elements], self.body.unknowns[elements]
        strain = strain.reshape(len(unknowns), -1, 30)
        return (strain @ moved[unknowns]).reshape(-1, 6, moved.shape[1])

    def _stress(
        self, moved: Float[np.ndarray, "k p"], elements: Int[np.ndarray, " e"] | slice = _ALL
    ) -> Float[np.ndarray, "eq 6 p"]:
        """Stress times weight of the quadrature at every point of some elements."""
        weight = self.body.weight
        scale = (weight * np.exp(self.log_modulus).reshape(weight.shape))[elements].ravel()
        strain = self._strain(moved, elements)
        return (_hooke(self.poisson_ratio) @ strain) * scale[:, None, None]


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
    slope = np.stack([np.asarray(function[0].grad) for function in basis.basis])
    slope = slope.transpose(2, 3, 1, 0)
    strain = np.zeros((*slope.shape[:2], 6, 10, 3))
    for i in range(3):
        strain[:, :, i, :, i] = slope[:, :, i]
        j = (i + 1) % 3
        strain[:, :, 3 + i, :, i] = slope[:, :, j]
        strain[:, :, 3 + i, :, j] = slope[:, :, i]
    strain = strain.reshape(*slope.shape[:2], 6, 30)
    # scikit-fem's elements number their nodes as `Solid` does.
    points = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
    return GradedBody(solid, held, strain, np.asarray(basis.dx), points)


def with_moduli(
    body: GradedBody, log_modulus: Float[np.ndarray, " mq"], poisson_ratio: float
) -> GradedStiffness:
    """A body with the modulus at every quadrature point, factorised.

    Parameters
    ----------
    body : GradedBody
    log_modulus : (m q,) float [-]  logarithm of the shear modulus over the mean one
    poisson_ratio : float [-]       -1 < nu < 0.5

    Returns
    -------
    GradedStiffness

    Raises
    ------
    SingularSystemError             the held nodes do not hold the body
    """
    moduli = _hooke(poisson_ratio)
    scale = body.weight * np.exp(log_modulus).reshape(body.weight.shape)
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
