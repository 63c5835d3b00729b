"""Time of all fields for all pairs of nodes, beside LAPACK and bempp-cl in the same run."""

import numpy as np
from scipy.linalg import lu_factor

from benchmarks.clock import shortest
from benchmarks.figure import BEM, Figure
from benchmarks.floors import integral_operations, memory_rate, product_rate
from benchmarks.machine import CORES
from benchmarks.meshes import ball, cap
from benchmarks.options import Options
from benchmarks.peers import laplace_times
from palpate.bem import BoundarySurface, make_surface
from palpate.bem.integrals.assembly import Collocation, KernelIntegrals, kernel_integrals
from palpate.bem.integrals.kelvin import DISPLACEMENT, TRACTION
from palpate.geometry import TriangleMesh

REPEATS = 3


def measure(options: Options) -> list[Figure]:
    """Both kernels over the whole surface, one LU of the 3N system, bempp-cl's operators."""
    figures = []
    for level in (3,) if options.quick else (3, 4):
        mesh = ball(level)
        size = len(mesh.vertices)
        surface = make_surface(mesh, cap(mesh, -0.4))
        traction = shortest(lambda s=surface: _fields(s, TRACTION), repeats=REPEATS)
        displacement = shortest(lambda s=surface: _fields(s, DISPLACEMENT), repeats=REPEATS)
        pairs = len(mesh.triangles) * size
        operations = sum(
            integral_operations(_prepared(surface, kernel)) for kernel in (TRACTION, DISPLACEMENT)
        )
        how = (
            f"ball, {size} vertices, {len(mesh.triangles)} triangles, {CORES} cores; nine fields"
            f" {traction:.2f} s, six fields {displacement:.2f} s, that is"
            f" {1e-6 * pairs / (traction + displacement):.1f} million pairs a second in all; floor:"
            f" the {1e-9 * operations:.0f} Gflop of its regular points take"
            f" {operations / product_rate():.2f} s at the rate of a product of large matrices"
        )
        figures += [
            Figure(
                BEM,
                f"separated fields, all pairs, warm, {size} vertices",
                traction + displacement,
                "s",
                note=how,
            ),
            Figure(
                BEM,
                f"beside it: LAPACK, one LU of the 3N system, {size} vertices",
                lu_time(3 * size),
                "s",
                note=f"scipy.linalg.lu_factor of a random matrix, {3 * size} rows; floor:"
                f" {2 / 3 * (3 * size) ** 3 / product_rate():.2f} s",
            ),
            *_peer(mesh, make=options.peers),
        ]
    return [*figures, *_machine()]


def _machine() -> list[Figure]:
    """What the machine does at most, in the same run."""
    by = f"{CORES} cores, OpenBLAS, matrices of 4000 rows"
    return [
        Figure(
            BEM, "beside it: this machine's products of large matrices, double precision",
            1e-9 * product_rate(), "Gflop/s", note=by,
        ),
        Figure(
            BEM, "beside it: the same in single precision", 1e-9 * product_rate(np.float32),
            "Gflop/s", note=by,
        ),
        Figure(
            BEM, "beside it: this machine's memory", 1e-9 * memory_rate(), "GB/s",
            note=f"{CORES} cores, a[i] = b[i] + s c[i], three arrays of 256 MB",
        ),
    ]  # fmt: skip


def lu_time(size: int, *, repeats: int = REPEATS) -> float:
    """Shortest wall time [s] of one LU factorisation in double precision."""
    matrix = np.random.default_rng(0).normal(size=(size, size)).T
    return shortest(lambda: lu_factor(matrix, check_finite=False), repeats=repeats, warm=False)


def _prepared(surface: BoundarySurface, kernel: int) -> KernelIntegrals:
    """One kernel from every vertex over every triangle, against the nodes it is used with."""
    vertices = surface.mesh.vertices
    n = len(vertices)
    nowhere = np.full(n, -1)
    collocation = Collocation(vertices, np.arange(n), nowhere, np.zeros((n, 3)))
    nodes = surface.displacement if kernel == TRACTION else surface.traction
    return kernel_integrals(surface, collocation, nodes, kernel)


def _fields(surface: BoundarySurface, kernel: int) -> None:
    _prepared(surface, kernel).all_blocks()


def _peer(mesh: TriangleMesh, *, make: bool) -> list[Figure]:
    times = laplace_times(mesh, repeats=REPEATS, make=make)
    size = len(mesh.vertices)
    rows = []
    for kind in ("single", "double"):
        name = f"beside it: bempp-cl, scalar Laplace {kind}-layer operator, {size} vertices"
        if isinstance(times, str):
            rows.append(Figure(BEM, name, None, "s", note=times))
        else:
            note = (
                f"bempp-cl {times['version']}, dense, numba, continuous linear functions, warm;"
                " one scalar field, Galerkin"
            )
            rows.append(Figure(BEM, name, times[f"{kind}_layer"], "s", note=note))
    return rows
