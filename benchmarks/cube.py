"""Unit cube under homogeneous strain: the elements contain the solution, so only integrals err."""

import numpy as np

from benchmarks.figure import BEM, Figure
from benchmarks.manufactured import Outcome, flat_normals, linear_field, solved
from benchmarks.meshes import cube
from benchmarks.options import Options
from palpate.bem import make_surface
from palpate.bem.integrals.surface import Quadrature

SHEAR_MODULUS = 2.5
RATIOS = (0.0, 0.25, 0.45, 0.499)
SUPPORTS = {
    "one face": (4,),
    "two opposite faces": (4, 5),
    "two adjacent faces": (0, 4),
    "three faces": (0, 2, 4),
}
SHEAR = np.array([[0, 0.5, 0.2], [0.5, 0, 0.1], [0.2, 0.1, 0]])


def measure(options: Options) -> list[Figure]:
    """Largest error over strains, supports and Poisson's ratios, at two tolerances."""
    cells = 3 if options.quick else 4
    figures = []
    for tolerance in (Quadrature().tolerance, 1e-9):
        u, t, where = _worst(cells, tolerance)
        how = (
            f"{cells} x {cells} x 2 triangles a face; tension and shear, held at one, two opposite,"
            f" two adjacent, three faces, nu {', '.join(map(str, RATIOS))}; quadrature tolerance"
            f" {tolerance:.0e}; worst: {where}"
        )
        name = f"unit cube, exact linear fields, tolerance {tolerance:.0e}: largest error in"
        figures += [
            Figure(BEM, f"{name} u", u, note=how),
            Figure(BEM, f"{name} t, edges included", t, note=how),
        ]
    return figures


def _worst(cells: int, tolerance: float) -> tuple[float, float, str]:
    """Largest errors in u and in t, and the problem with the largest in u."""
    mesh, face = cube(cells)
    errors = []
    for name, faces in SUPPORTS.items():
        held = np.flatnonzero(np.isin(face, faces))
        surface = make_surface(mesh, held)
        for nu in RATIOS:
            tension = np.diag([-nu, -nu, 1.0])
            for kind, strain in (("tension", tension), ("shear", SHEAR)):
                field = linear_field(strain, nu, SHEAR_MODULUS)
                outcome = solved(
                    surface, field, flat_normals(mesh), quadrature=Quadrature(tolerance)
                )
                u, t = _errors(outcome, cells, strain, nu)
                errors.append((u, t, f"{kind}, {name}, nu {nu}"))
    return max(f[0] for f in errors), max(f[1] for f in errors), max(errors)[2]


def _errors(
    outcome: Outcome, cells: int, strain: np.ndarray, poisson_ratio: float
) -> tuple[float, float]:
    """Largest errors over the largest displacement of the surface and the largest stress."""
    mesh, _ = cube(cells)
    size = np.abs(mesh.vertices @ strain).max()
    trace = np.trace(strain) * poisson_ratio / (1 - 2 * poisson_ratio)
    stress = 2 * SHEAR_MODULUS * np.abs(strain + trace * np.eye(3)).max()
    u = np.abs(outcome.displacement - outcome.exact_displacement).max() / size
    t = np.abs(outcome.traction - outcome.exact_traction).max() / stress
    return float(u), float(t)
