"""What this machine can do at most, in the run that measures, and how much work a model is."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cache
from unittest.mock import patch

import numba
import numpy as np
from scipy.linalg.blas import get_blas_funcs

from benchmarks.clock import shortest
from palpate.bem.integrals.assembly import KernelIntegrals
from palpate.bem.integrals.kelvin import LANES, TRACTION
from palpate.bem.system import factors, matrix
from palpate.vision.spline import make_spline_picture, sample_kernel

_SIDE = 4000  # of the matrices that are multiplied
_STREAM = 32_000_000  # doubles of each array that is added: no cache holds them
_WINDOW, _WINDOWS = 31, 2000  # px; how many are interpolated
# Floating-point operations for one load point and one quadrature point, counted in
# `integrals/kelvin.py`, the reciprocal square root as eight: its fields, and six sums of each.
_FIELD_OPERATIONS = {TRACTION: 51 + 12 * 9, 6: 31 + 12 * 6}


@cache
def product_rate(kind: type = np.float64) -> float:
    """Operations per second of a product of two large matrices by the library that factorises."""
    a, b = np.random.default_rng(0).normal(size=(2, _SIDE, _SIDE)).astype(kind)
    (gemm,) = get_blas_funcs(("gemm",), (a, b))
    return 2.0 * _SIDE**3 / shortest(lambda: gemm(1.0, a.T, b.T))


@cache
def memory_rate() -> float:
    """Bytes per second of a[i] = b[i] + s c[i] over large arrays, two read and one written."""
    # Written once: pages that never were are all one, and in the cache.
    a, b, c = np.ones((3, _STREAM))
    return 3.0 * a.nbytes / shortest(lambda: _add_scaled(a, b, 3.0, c))


@numba.njit(parallel=True)
def _add_scaled(a, b, scale, c):
    for i in numba.prange(a.size):
        a[i] = b[i] + scale * c[i]


@cache
def interpolation_rate() -> float:
    """Grey levels per second that one core interpolates in a picture, window by window."""
    grey = np.random.default_rng(0).uniform(0.0, 255.0, (480, 640))
    coefficients = make_spline_picture(grey.astype(np.float32)).coefficients
    row, column = np.indices((_WINDOW, _WINDOW)).reshape(2, -1).astype(np.float32)
    values = np.empty_like(row)

    def windows() -> None:
        for shift in range(_WINDOWS):
            at = np.float32(20.3 + shift % 400)
            sample_kernel(coefficients, column + at, row + at, values)

    return _WINDOWS * row.size / shortest(windows)


def integral_operations(integrals: KernelIntegrals) -> float:
    """Operations that the regular integrals of all blocks take, by the points of their rules."""
    points, elements, rules = integrals.points, integrals.elements, integrals.rules
    count = 0
    n_points = np.diff(rules.start)
    for lanes in points.lanes:
        offset = lanes.reshape(3, LANES).T[:, None] - elements.centre
        ratio = np.linalg.norm(offset, axis=2) / elements.radius
        far = np.where(ratio >= rules.ratios[-1], ratio, np.inf).min(axis=0)
        rule = np.minimum((far < rules.ratios[:, None]).sum(axis=0), n_points.size - 1)
        count += LANES * n_points[rule].sum()
    # Each patch's own nodes are added to those of the mesh.
    sums = 2.0 * integrals.n_fields * LANES * len(points.lanes) * integrals.patches.own.size
    return float(count) * _FIELD_OPERATIONS[integrals.n_fields] + sums


@dataclass
class Operations:
    """Floating-point operations of large matrices, by precision: factors, solutions, products."""

    single: dict[str, float] = field(default_factory=dict)
    double: dict[str, float] = field(default_factory=dict)

    def add(self, what: str, kind: np.dtype, count: float) -> None:
        """Count some more."""
        counted = self.single if kind == np.float32 else self.double
        counted[what] = counted.get(what, 0.0) + count

    def seconds(self) -> float:
        """What they take at the rate of a product of large matrices."""
        return (
            sum(self.single.values()) / product_rate(np.float32)
            + sum(self.double.values()) / product_rate()
        )

    def described(self) -> str:
        """How many, of what."""
        parts = [
            f"{what} {1e-12 * count:.2f} Tflop in {precision}"
            for precision, counted in (("double", self.double), ("single", self.single))
            for what, count in counted.items()
        ]
        return ", ".join(parts)


@contextmanager
def counted_operations() -> Iterator[Operations]:
    """Counts what the model's matrices take while the block runs."""
    operations = Operations()
    lu_factor, lu_solve, product = factors.lu_factor, factors.lu_solve, matrix._product

    def factorised(a, **options):
        operations.add("factors", a.dtype, 2.0 / 3.0 * len(a) ** 3)
        return lu_factor(a, **options)

    def solved(lu, b, **options):
        operations.add("solutions", lu[0].dtype, 2.0 * len(b) ** 2 * b.shape[1])
        return lu_solve(lu, b, **options)

    def multiplied(a, b):
        operations.add("derivatives", a.dtype, 2.0 * a.shape[0] * a.shape[1] * b.shape[1])
        return product(a, b)

    with (
        patch.object(factors, "lu_factor", factorised),
        patch.object(factors, "lu_solve", solved),
        patch.object(matrix, "_product", multiplied),
    ):
        yield operations
