"""How the equations of an object are solved: by factors, or by iteration where they are compressed.

The one place that asks which of both a system is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from palpate.bem.compressed.iterative import cluster_inverse, solve_compressed
from palpate.bem.compressed.system import CompressedSystem
from palpate.bem.loads.right_hand import RightHand
from palpate.bem.reduced_model import (
    CENTRE,
    MODEL_COLUMNS,
    SolutionModel,
    make_reduced_model,
    reduced_basis,
)
from palpate.bem.system.factors import CentredSystem, factorise, solve
from palpate.bem.system.system import BoundarySystem

# Takes right-hand sides, (r, c), to the unknowns, (k, c).
Solve = Callable[[Float[np.ndarray, "r c"]], Float[np.ndarray, "k c"]]
# Largest relative residual, of all right-hand sides or of each.
Tolerance = float | Float[np.ndarray, " c"]
# Smallest residual of a compressed system that iteration is asked for.
_SNAPSHOT_RESIDUAL = 5e-7


@runtime_checkable
class Solver(Protocol):
    """Solves one system for any right-hand sides and materials."""

    @property
    def together(self) -> int | None:
        """Right-hand sides of which one reduced model is best made, as several models share all
        that is costly; None: of all."""
        ...

    def prepare(self) -> None:
        """Compute now, and keep in the system's `checkpoints`, what serves all right-hand sides.

        Raises
        ------
        SingularSystemError               the support does not hold the object
        """
        ...

    def at(self, poisson_ratio: float, *, keep: bool = False) -> Solve:
        """Solutions at one Poisson's ratio.

        Parameters
        ----------
        poisson_ratio : float [-]         -1 < nu <= 0.5
        keep : bool                       True: what it takes is kept in the system's `checkpoints`

        Returns
        -------
        callable                          right-hand sides, (r, c) -> unknowns, (k, c)

        Raises
        ------
        SingularSystemError               the support does not hold the object
        """
        ...

    def reduced_model(
        self, right: RightHand, poisson_range: tuple[float, float], tolerance: Tolerance
    ) -> SolutionModel:
        """Solutions at all Poisson's ratios of a range.

        Parameters
        ----------
        right : RightHand                 c columns
        poisson_range : (float, float)
        tolerance : float or (c,) float   as for `make_reduced_model`; by iteration the smallest of
                                          them, but no less than 5e-7, over the whole range

        Returns
        -------
        SolutionModel

        Raises
        ------
        SingularSystemError               the support does not hold the object
        NotConvergedError                 the tolerance is not met
        """
        ...


@dataclass(frozen=True, slots=True, eq=False)
class _DirectSolver:
    """By LU factors.

    Attributes
    ----------
    system : BoundarySystem
    shared : CentredSystem or None      factors for several reduced models; None: a model computes
                                        its own, and is kept itself
    """

    system: BoundarySystem
    shared: CentredSystem | None

    @property
    def together(self) -> int | None:
        """As of a `Solver`: factors that are in memory serve all models."""
        return MODEL_COLUMNS if self.system.checkpoints.in_memory else None

    def prepare(self) -> None:
        """As of a `Solver`."""
        _ = (self.shared or CentredSystem(self.system, CENTRE)).factorised

    def at(self, poisson_ratio: float, *, keep: bool = False) -> Solve:
        """As of a `Solver`."""
        if keep:
            return partial(solve, CentredSystem(self.system, poisson_ratio).factorised)
        return partial(solve, factorise(self.system, poisson_ratio))

    def reduced_model(
        self, right: RightHand, poisson_range: tuple[float, float], tolerance: Tolerance
    ) -> SolutionModel:
        """As of a `Solver`."""
        return make_reduced_model(
            self.shared or self.system, right, poisson_range=poisson_range, tolerance=tolerance
        )


@dataclass(frozen=True, slots=True, eq=False)
class _IterativeSolver:
    """A solver by iteration, which keeps nothing.

    Attributes
    ----------
    system : CompressedSystem
    """

    system: CompressedSystem
    together: int | None = None

    def prepare(self) -> None:
        """As of a `Solver`: there is nothing to prepare."""

    def at(self, poisson_ratio: float, *, keep: bool = False) -> Solve:
        """As of a `Solver`."""
        inverse = cluster_inverse(self.system, poisson_ratio)
        return lambda right: solve_compressed(inverse, right).solution

    def reduced_model(
        self, right: RightHand, poisson_range: tuple[float, float], tolerance: Tolerance
    ) -> SolutionModel:
        """As of a `Solver`."""
        residual = max(float(np.min(tolerance)), _SNAPSHOT_RESIDUAL)
        return reduced_basis(
            self.system, right.terms, poisson_range=poisson_range, tolerance=residual
        )


def make_solver(system: BoundarySystem, *, single: bool = False) -> Solver:
    """The solver of a system.

    Parameters
    ----------
    system : BoundarySystem
    single : bool                 True: several reduced models share factors, and solutions may have
                                  relative errors of 1e-4 (`CentredSystem`); no matter where
                                  iteration solves

    Returns
    -------
    Solver
    """
    if isinstance(system, CompressedSystem):
        return _IterativeSolver(system)
    return _DirectSolver(system, CentredSystem(system, CENTRE, single=True) if single else None)
