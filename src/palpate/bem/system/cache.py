"""Disk cache of an object's boundary integrals, keyed by a hash of their inputs.

It is used on request only: the files are large (80 MB for 1000 vertices, four times that for 2000),
and to compute the integrals again takes a second or two.
"""

import hashlib
from contextlib import suppress
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from palpate.bem.integrals import BoundarySurface, FieldBlocks, Quadrature
from palpate.bem.system.boundary import find_unknowns, place_collocation
from palpate.bem.system.system import BoundarySystem, assemble_system
from palpate.disk import atomic_replacement, created_folder
from palpate.errors import InputError, InUseError, RecordError
from palpate.files import stored_arrays
from palpate.parts import content_digest

# To be increased with every change of what is stored or how it is computed.
_FORMAT = 3
_KERNELS = ("traction", "displacement")


def cached_system(
    surface: BoundarySurface, folder: Path, *, quadrature: Quadrature = Quadrature()
) -> BoundarySystem:
    """The integrals of an object, read from a cache folder, or computed and stored there.

    Parameters
    ----------
    surface : BoundarySurface
    folder : Path                 created if absent
    quadrature : Quadrature

    Returns
    -------
    BoundarySystem                bit-identical, whether read or computed

    Raises
    ------
    InputError                    the folder cannot be written
    """
    path = folder / f"system-{content_hash(surface, quadrature)}.npz"
    found = _read(path, surface)
    if found is not None:
        return found
    system = assemble_system(surface, quadrature=quadrature)
    try:
        _write(path, system)
    except OSError as error:
        raise InputError(
            f"{folder}: the cache cannot be written ({error.strerror}); give another folder, or "
            "leave the cache out"
        ) from error
    return system


def content_hash(surface: BoundarySurface, quadrature: Quadrature) -> str:
    """Hash of everything that the integrals depend on, 32 hexadecimal digits.

    Parameters
    ----------
    surface : BoundarySurface
    quadrature : Quadrature

    Returns
    -------
    str
    """
    parts = [np.array([_FORMAT]), surface.mesh.triangles, surface.element_nodes]
    parts += [surface.held, surface.held_directions]
    for nodes in (surface.displacement, surface.traction):
        weights = nodes.weights
        parts += [nodes.element, weights.indptr, weights.indices, weights.data]
    digest = hashlib.sha256(repr(astuple(quadrature)).encode())
    for part in parts:
        digest.update(repr((part.shape, part.dtype.str)).encode())
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()[:32]


def _read(path: Path, surface: BoundarySurface) -> BoundarySystem | None:
    """The system in a file, or None if the file is absent or damaged."""
    try:
        with stored_arrays(path, "") as stored:
            if str(stored.pop("sha256")) != _digest(path, stored):
                return None
    # A path that is not a file is reported when the system is written.
    except RecordError:
        return None
    unknowns = find_unknowns(surface)
    collocation = place_collocation(surface, unknowns)
    count = collocation.point.shape[0]
    traction, displacement = (
        FieldBlocks(stored[f"{name}_values"], stored[f"{name}_rows"], count) for name in _KERNELS
    )
    return BoundarySystem(surface, unknowns, collocation, traction, displacement)


def _write(path: Path, system: BoundarySystem) -> None:
    """Write atomically; leave it to another process that is writing the same file."""
    blocks = (system.traction_kernel, system.displacement_kernel)
    arrays: dict[str, Any] = {}
    for name, kernel in zip(_KERNELS, blocks, strict=True):
        arrays |= {f"{name}_values": kernel.values, f"{name}_rows": kernel.rows}
    arrays["sha256"] = np.array(_digest(path, arrays))
    with (
        created_folder(path.parent),
        suppress(InUseError),
        atomic_replacement([path]) as (staged,),
        staged.open("wb") as file,
    ):
        np.savez(file, **arrays)


def _digest(path: Path, arrays: dict[str, Any]) -> str:
    """Checksum of the arrays and of the file name, which holds the hash of their inputs."""
    return content_digest((path.name, arrays))
