"""Young's modulus of the beam from finite elements that press where the session says.

Quadratic hexahedra (scikit-fem) on a block of the beam's size, its end clamped, the force spread
evenly over all points of the top and of the end face within the contact radius, as the session
format defines.
"""

import numpy as np
import skfem
from scipy.sparse import csr_matrix
from skfem.models.elasticity import lame_parameters, linear_elasticity

from palpate.records import Session

SIZE = np.array([0.1, 0.03, 0.03])
TRIAL = 250e3


def finite_element_modulus(
    session: Session, poisson_ratio: float, cells: tuple[int, int, int]
) -> float:
    """E [Pa] that fits all probings of the session best in the sense of least squares."""
    basis, stiffness = _stiffness(poisson_ratio, cells)
    contact, force = session.probings[0].contact, session.probings[0].force
    load = _load(basis.mesh, basis.elem, contact.point, contact.radius, force)
    clamped = basis.get_dofs(lambda x: np.abs(x[0] + SIZE[0]) < 1e-9)
    solution = skfem.solve(*skfem.condense(stiffness, load, D=clamped))
    model, measured = [], []
    for probing in session.probings:
        # A hair inside, so that every point is found in a cell.
        inside = np.clip(probing.displacement.points.T, None, SIZE[:, None] * (1 - 1e-7))
        inside[0] -= 1e-9
        model.append(basis.probes(inside) @ solution)
        measured.append(probing.displacement.displacement.T.ravel())
    predicted, seen = np.concatenate(model), np.concatenate(measured)
    return TRIAL * float(predicted @ predicted / (predicted @ seen))


def _stiffness(poisson_ratio: float, cells: tuple[int, int, int]) -> tuple[skfem.Basis, csr_matrix]:
    """Cells finer toward the tip and the top, where the force acts."""
    graded = [np.sin(0.5 * np.pi * np.linspace(0, 1, n + 1)) for n in cells]
    mesh = skfem.MeshHex.init_tensor(
        SIZE[0] * (graded[0] - 1), np.linspace(0, SIZE[1], cells[1] + 1), SIZE[2] * graded[2]
    )
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementHex2()), intorder=4)
    return basis, skfem.asm(linear_elasticity(*lame_parameters(TRIAL, poisson_ratio)), basis)


def _load(
    mesh: skfem.MeshHex, element: skfem.Element, point: np.ndarray, radius: float, force: np.ndarray
) -> np.ndarray:
    faces = mesh.facets_satisfying(
        lambda x: (np.abs(x[2] - SIZE[2]) < 1e-9) | (np.abs(x[0]) < 1e-9)
    )
    pressed = skfem.FacetBasis(mesh, element, facets=faces, intorder=20)

    def inside(x: np.ndarray) -> np.ndarray:
        return 1.0 * (sum((x[i] - point[i]) ** 2 for i in range(3)) < radius**2)

    area = skfem.Functional(lambda w: inside(w.x)).assemble(pressed)
    work = skfem.LinearForm(
        lambda v, w: inside(w.x) / area * sum(force[i] * v[i] for i in range(3))
    )
    return work.assemble(pressed)
