"""Disk cache of what is computed for an object on its support, whatever touches it.

It is used on request only: the files are large (80 MB of integrals for 1000 vertices and as much of
factors, four times that for 2000), and to compute the integrals again takes a second or two.
"""

from pathlib import Path

from palpate.bem.integrals import BoundarySurface, FieldBlocks
from palpate.bem.system.boundary import find_unknowns, place_collocation
from palpate.bem.system.system import BoundarySystem, assemble_system
from palpate.parts import Parts, content_digest

# To be increased with every change of what is stored or how it is computed.
_FORMAT = 4


def cached_system(surface: BoundarySurface, folder: Path) -> BoundarySystem:
    """The integrals of an object, read from a cache folder, or computed and stored there.

    Parameters
    ----------
    surface : BoundarySurface
    folder : Path                 created if absent; nothing is stored where it cannot be written

    Returns
    -------
    BoundarySystem                bit-identical, whether read or computed; its `parts` are in the
                                  folder
    """
    parts = Parts(folder, _digest(surface))

    def compute() -> tuple[FieldBlocks, FieldBlocks]:
        system = assemble_system(surface)
        return system.traction_kernel, system.displacement_kernel

    traction, displacement = parts.load_or_make("integrals", compute)
    unknowns = find_unknowns(surface)
    collocation = place_collocation(surface, unknowns)
    return BoundarySystem(surface, unknowns, collocation, traction, displacement, parts=parts)


def _digest(surface: BoundarySurface) -> str:
    """Digest of everything that the integrals depend on."""
    nodes = [
        (each.element, each.weights.indptr, each.weights.indices, each.weights.data)
        for each in (surface.displacement, surface.traction)
    ]
    shape = surface.mesh.triangles, surface.element_nodes
    return content_digest((_FORMAT, *shape, surface.held, surface.held_directions, nodes))
