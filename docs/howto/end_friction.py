"""How much stiffer a cylinder looks when its ends stick: the figures of compression.md.

    python docs/howto/end_friction.py      # needs scikit-fem; a minute

Axisymmetric finite elements (quadratic quadrilaterals) on a quarter of the section: the middle
plane cannot move along the axis, the end is pressed down and either slips or sticks.
"""

import numpy as np
from skfem import Basis, BilinearForm, ElementQuad2, ElementVector, MeshQuad, condense, solve


def apparent_modulus(diameter: float, height: float, poisson_ratio: float, *, cells: int) -> float:
    """Force over area and strain, over Young's modulus, for ends that stick."""
    radius, half = 0.5 * diameter, 0.5 * height
    # Cells shrink toward the corner where end and side meet: the stress is singular there.
    steps = 1 - (1 - np.linspace(0, 1, cells + 1)) ** 2
    mesh = MeshQuad.init_tensor(radius * steps, half * steps)
    basis = Basis(mesh, ElementVector(ElementQuad2()), intorder=6)
    shear = 1 / (2 * (1 + poisson_ratio))  # Young's modulus 1
    bulk = 2 * shear * poisson_ratio / (1 - 2 * poisson_ratio)

    @BilinearForm
    def work(u, v, w):
        r = w.x[0]
        divergence = u.grad[0][0] + u.grad[1][1] + u[0] / r
        test = v.grad[0][0] + v.grad[1][1] + v[0] / r
        shearing = 0.5 * (u.grad[0][1] + u.grad[1][0]) * (v.grad[0][1] + v.grad[1][0])
        stretch = u.grad[0][0] * v.grad[0][0] + u.grad[1][1] * v.grad[1][1] + u[0] * v[0] / r**2
        return (bulk * divergence * test + 2 * shear * (stretch + shearing)) * 2 * np.pi * r

    matrix = work.assemble(basis)
    x, z = basis.doflocs
    radial, axial = basis.split_indices()
    end, middle, axis = z > half - 1e-12, z < 1e-12, x < 1e-12
    moved = np.zeros(basis.N)
    held = np.zeros(basis.N, dtype=bool)
    held[radial] = axis[radial] | end[radial]
    held[axial] = middle[axial] | end[axial]
    moved[axial[end[axial]]] = -0.01 * half
    field = solve(*condense(matrix, x=moved, D=np.flatnonzero(held)))
    force = -(matrix @ field)[axial[end[axial]]].sum()
    return float(force / (np.pi * radius**2) / 0.01)


def main() -> None:
    """Print the table of the page."""
    print("diameter/height  nu      sticking over slipping   1 + 2 S^2")
    for ratio in (0.5, 1.0, 5 / 3, 3.0):
        factor = 1 + 2 * (ratio / 4) ** 2
        for nu in (0.3, 0.45, 0.49, 0.499):
            coarse, fine = (apparent_modulus(ratio, 1.0, nu, cells=n) for n in (24, 48))
            print(f"{ratio:10.2f}   {nu:7.3f}   {fine:10.4f} ({coarse:.4f})      {factor:.3f}")


if __name__ == "__main__":
    main()
