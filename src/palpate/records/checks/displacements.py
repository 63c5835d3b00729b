"""Checks of measured displacements: no motion at all, positions instead, duplicated data."""

import numpy as np

from palpate.errors import InputError, quoted
from palpate.geometry import TriangleMesh, bounding_diagonal
from palpate.records.probing import DisplacementField, Probing, observed_rows
from palpate.shapes import Flags, Indices

# Displacements are taken for positions under load if they differ from the points by less than this
# fraction of themselves, exceed this fraction of the body's size, and there are at least so many.
_MAX_DIFFERENCE, _MIN_LENGTH, _MIN_POINTS = 0.3, 0.1, 3


def check_observed_points(mesh: TriangleMesh, held: Indices, field: DisplacementField) -> None:
    """Refuse a field that carries no information: all zero, positions, or only on fixed supports.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles that do not move
    field : DisplacementField       on that mesh

    Raises
    ------
    InputError                      the text says which of these it is
    """
    measured = observed_rows(field)
    if not field.displacement[measured].any():
        raise InputError(
            f"the displacement of all {int(measured.sum())} measured points of {field.source} is"
            " exactly zero: nothing moved, which says nothing about stiffness; were the pictures at"
            " rest compared with themselves?"
        )
    _check_not_positions(mesh, field, measured)
    fixed = held_points(mesh, held, field)[measured]
    if fixed.all():
        raise InputError(
            f"all {len(fixed)} measured points of {field.source} are on the support, which does"
            " not move: they say nothing; check the support and length_unit (the mesh is"
            f" {bounding_diagonal(mesh):.3g} m across)"
        )


def held_points(mesh: TriangleMesh, held: Indices, field: DisplacementField) -> Flags:
    """Which points of a field lie on held triangles.

    Parameters
    ----------
    mesh : TriangleMesh
    held : (k,) int                 triangles
    field : DisplacementField       on that mesh

    Returns
    -------
    (n,) bool
    """
    corners = mesh.triangles[field.surface.triangle]
    is_held = np.zeros(len(mesh.vertices), dtype=bool)
    is_held[mesh.triangles[held]] = True
    # A point is held if every vertex with non-zero barycentric weight is.
    return (is_held[corners] | (field.surface.barycentric < 1e-6)).all(axis=1)


def _check_not_positions(mesh: TriangleMesh, field: DisplacementField, measured: Flags) -> None:
    """Refuse positions under load in place of displacements."""
    moved, rest = field.displacement[measured], field.points[measured]
    length = float(np.sqrt((moved**2).sum(axis=1).mean()))
    difference = float(np.sqrt(((moved - rest) ** 2).sum(axis=1).mean()))
    if (
        measured.sum() >= _MIN_POINTS
        and length > _MIN_LENGTH * bounding_diagonal(mesh)
        and difference < _MAX_DIFFERENCE * length
    ):
        raise InputError(
            f"ux,uy,uz of {field.source} are nearly its x,y,z: they differ by {difference:.3g} m,"
            f" of {length:.3g} m: are they places under load? Take x,y,z off them"
        )


def check_copies(probings: tuple[Probing, ...]) -> None:
    """Refuse the same measurement in two probings: counted twice, it would narrow the intervals.

    Parameters
    ----------
    probings : tuple of Probing

    Raises
    ------
    InputError                      two share at least half of their rows; the text names both
    """
    earlier: list[tuple[Probing, set[bytes]]] = []
    for probing in probings:
        if probing.displacement is None:
            continue
        rows = _moved_rows(probing.displacement)
        for other, others in earlier:
            if shared := copied_rows(rows, others):
                raise InputError(
                    f"{shared} of {len(rows)} points of probing {quoted(probing.name)} have the"
                    f" same displacement, digit by digit, as in probing {quoted(other.name)};"
                    " noise makes any two measurements differ: name the file that belongs to each,"
                    " or leave one out"
                )
        earlier.append((probing, rows))


def copied_rows(rows: set[bytes], others: set[bytes]) -> int:
    """Number of rows that two measurements share, digit by digit, if one is a copy of the other.

    Parameters
    ----------
    rows, others : set of bytes     one entry per row

    Returns
    -------
    int                             0 if it is less than half of the rows of the shorter one
    """
    shared = len(rows & others)
    return shared if 2 * shared >= min(len(rows), len(others)) else 0


def _moved_rows(field: DisplacementField) -> set[bytes]:
    """Position and displacement of each measured point that moved, as bytes."""
    rows = np.hstack([field.points, field.displacement])[observed_rows(field)]
    return {row.tobytes() for row in rows[rows[:, 3:].any(axis=1)]}
