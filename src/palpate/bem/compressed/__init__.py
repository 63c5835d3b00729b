"""The boundary integral equations of large bodies: an operator in place of the dense matrices.

Purpose    : solve bodies of tens of thousands of vertices in memory and time that grow with their
             number, for all materials at once.
Takes      : a `BoundarySurface`, right-hand sides.
Gives      : `CompressedSystem` (a `BoundarySystem` without matrices), iterative solutions,
             `ReducedBasis`, a reduced basis for every Poisson's ratio.
Depends on : `bem.system`, `bem.integrals`, `geometry`.
Read first : `operator.py`, then `far_field.py` and `near_field.py`; `system.py`, `snapshots.py`.
"""

from palpate.bem.compressed.choice import held_system as held_system
from palpate.bem.compressed.operator import Compression as Compression
from palpate.bem.compressed.preconditioner import (
    ClusterInverse as ClusterInverse,
    cluster_inverse as cluster_inverse,
    solve_compressed as solve_compressed,
)
from palpate.bem.compressed.snapshots import (
    ReducedBasis as ReducedBasis,
    orthogonalised as orthogonalised,
    reduced_basis as reduced_basis,
)
from palpate.bem.compressed.system import (
    CompressedSystem as CompressedSystem,
    compressed_system as compressed_system,
)
