"""Choice between dense matrices and the compressed operator."""

from pathlib import Path

import numpy as np

from palpate.bem.compressed.system import compressed_system
from palpate.bem.integrals.surface import BoundarySurface
from palpate.bem.system.memory import LARGEST_DENSE
from palpate.bem.system.system import BoundarySystem, boundary_system
from palpate.progress import Progress, silent


def held_system(
    surface: BoundarySurface,
    *,
    dense: bool = False,
    cache: Path | None = None,
    progress: Progress = silent,
) -> BoundarySystem:
    """The equations of an object on its support, dense or compressed depending on its size.

    Parameters
    ----------
    surface : BoundarySurface
    dense : bool                  True: dense matrices at any size
    cache : Path or None          see `boundary_system`; not used for a compressed system
    progress : callable           called with the current step and the fraction of the compression
                                  that is done, 0 to 1

    Returns
    -------
    BoundarySystem                a `CompressedSystem` where the object has more than
                                  `LARGEST_DENSE` vertices and its supports hold all directions

    Raises
    ------
    InputError                    a support of an object solved compressed holds some directions
                                  only
    """
    large = len(surface.mesh.vertices) > LARGEST_DENSE
    rolls = not np.allclose(surface.held_directions[surface.held], np.eye(3))
    if large and not dense and not rolls:
        return compressed_system(surface, progress=progress)
    return boundary_system(surface, cache=cache)
