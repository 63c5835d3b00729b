"""What a map of moduli changes in the displacements of a held body: finite elements with it and
without, in the elements of the map."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array, kron

from palpate.records import ModulusMap, Session
from palpate.shapes import Points
from palpate.solids import (
    GradedStiffness,
    Solid,
    held_nodes,
    make_graded_body,
    quadratic_solid,
    surface_values,
    with_moduli,
)

# Quadratic elements lock above this Poisson's ratio; the change hardly depends on it.
_LARGEST_RATIO = 0.495


@dataclass(frozen=True, slots=True, eq=False)
class MapResponse:
    """A body with a map of moduli and the same body without.

    Attributes
    ----------
    uneven, even : GradedStiffness
    directions : (m q, k) sparse    independent changes of the map, a standard deviation each
    """

    uneven: GradedStiffness
    even: GradedStiffness
    directions: csr_array

    @property
    def solid(self) -> Solid:
        """The elements of the map, quadratic."""
        return self.uneven.body.solid

    def change(self, load: Float[np.ndarray, "n3 p"]) -> Float[np.ndarray, "n3 p"]:
        """What the map changes in the displacement of all nodes, times the mean modulus.

        Parameters
        ----------
        load : (3 n, p) float [N]

        Returns
        -------
        (3 n, p) float [m Pa]
        """
        return self.uneven.displacements(load) - self.even.displacements(load)

    def at(self, points: Points) -> csr_array:
        """Displacements at points of the surface from those of all nodes, (3 p, 3 n)."""
        return csr_array(kron(surface_values(self.solid, points), np.eye(3)))


def make_map_response(session: Session, modulus: ModulusMap, poisson_ratio: float) -> MapResponse:
    """Finite elements of a body with a map of moduli.

    Parameters
    ----------
    session : Session               whose object the map is of
    modulus : ModulusMap
    poisson_ratio : float [-]

    Returns
    -------
    MapResponse

    Raises
    ------
    MeshError                       a map of another object
    SingularSystemError             the support does not hold the object
    """
    solid = quadratic_solid(modulus.nodes, modulus.tetrahedra, mesh=session.mesh)
    body = make_graded_body(solid, held_nodes(solid, session.held_triangles))
    ratio = min(poisson_ratio, _LARGEST_RATIO)
    uneven, even = (
        with_moduli(body, body.constant @ field, ratio)
        for field in (modulus.log_modulus, 0.0 * modulus.log_modulus)
    )
    return MapResponse(uneven, even, body.constant @ csr_array(modulus.directions.T))
