"""How fast the error falls with the element size: slope of a line through log error, log h."""

from collections.abc import Callable, Sequence

import numpy as np

from benchmarks.facets import CASES, facet_error
from benchmarks.figure import BEM, Figure
from benchmarks.manufactured import flat_normals, kelvin_field, solved
from benchmarks.meshes import ball, cap, cube
from benchmarks.options import Options
from palpate.bem import make_surface
from palpate.bem.integrals.surface import Quadrature

FORCE = np.array([1.0, -0.5, 2.0])
RATIO = 0.3


def measure(options: Options) -> list[Figure]:
    """Orders of convergence in u, as -2 d log(error) / d log(vertices)."""
    cells, levels = ((2, 4, 8), (1, 2, 3)) if options.quick else ((3, 6, 12), (2, 3, 4))
    sources = "exact field of a point force outside (nu 0.3), exact tractions given"
    shapes = [
        ("ball, smooth surface", [_ball_size(k) for k in levels], ball_error, levels, sources),
        ("cube", [6 * n * n + 2 for n in cells], cube_error, cells, sources),
    ]
    figures = [_order(*shape) for shape in shapes]
    sizes = list(CASES)[: 2 if options.quick else 3]
    cases = [CASES[size][0] for size in sizes]
    for name, quadratic in (("", True), (", linear elements", False)):

        def error(case: str, quadratic: bool = quadratic) -> float:
            return facet_error(case, quadratic=quadratic)

        how = "load at the pole, against finite elements"
        figures.append(_order(f"halfball_facets{name}", sizes, error, cases, how))
    return figures


def ball_error(subdivisions: int, poisson_ratio: float = RATIO) -> float:
    """Relative L2 error on a unit ball held at a cap, its surface known at the vertices only."""
    mesh = ball(subdivisions)
    surface = make_surface(mesh, cap(mesh, -0.4))
    field = kelvin_field(np.array([0.5, 0.7, 1.6]), FORCE, poisson_ratio, 1.0)

    def normals(triangle, position):
        return position / np.linalg.norm(position, axis=1, keepdims=True)

    return solved(surface, field, normals, quadrature=Quadrature()).relative


def cube_error(cells: int, poisson_ratio: float = RATIO) -> float:
    """Relative L2 error on a unit cube held at its lower face."""
    mesh, face = cube(cells)
    surface = make_surface(mesh, np.flatnonzero(face == 4))
    field = kelvin_field(np.array([0.7, 0.9, 2.0]), FORCE, poisson_ratio, 1.0)
    return solved(surface, field, flat_normals(mesh), quadrature=Quadrature()).relative


def _ball_size(subdivisions: int) -> int:
    return 10 * 4**subdivisions + 2


def _order(
    name: str,
    sizes: Sequence[int],
    error: Callable[..., float],
    arguments: Sequence[int] | Sequence[str],
    how: str,
) -> Figure:
    errors = [error(argument) for argument in arguments]
    slope = np.polyfit(-0.5 * np.log(sizes), np.log(errors), 1)[0]
    listed = ", ".join(f"{e:.2g}" for e in errors)
    note = f"{how}; relative L2 errors {listed} at {', '.join(map(str, sizes))} vertices"
    return Figure(
        BEM,
        f"observed order of convergence in u, {name}",
        float(slope),
        note=note,
    )
