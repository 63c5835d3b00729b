"""Nearly incompressible material: the error at nu 0.499 over that at nu 0.45, on the same mesh."""

from benchmarks.convergence import ball_error, cube_error
from benchmarks.figure import BEM, Figure
from benchmarks.options import Options

USUAL, NEARLY_INCOMPRESSIBLE = 0.45, 0.499


def measure(options: Options) -> list[Figure]:
    """Growth of the relative L2 error for the exact field of a point force outside."""
    level, cells = (2, 4) if options.quick else (3, 8)
    problems = (
        (f"ball, {10 * 4**level + 2} vertices", ball_error, level),
        (f"cube, {6 * cells**2 + 2} vertices", cube_error, cells),
    )
    figures = []
    for name, error, size in problems:
        before, after = error(size, USUAL), error(size, NEARLY_INCOMPRESSIBLE)
        figures.append(
            Figure(
                BEM,
                f"nu {NEARLY_INCOMPRESSIBLE} against {USUAL}, {name}: error in u grows by",
                after / before,
                "x",
                note=f"relative L2 errors {before:.2g} and {after:.2g}, exact field of a point"
                " force outside",
            )
        )
    return figures
