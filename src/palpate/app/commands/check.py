"""`palpate check`: everything about the input that can be said without solving."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

from palpate.geometry import (
    MeshQuality,
    mesh_quality,
    triangle_areas,
    triangle_distances,
    unit_normals,
)
from palpate.records import Probing, Session, observed_rows, read_session, require_probings

# Within this many contact radii a push shows as an imprint, farther away only as bending.
_NEAR_RADII = 8.0
_ENOUGH_NEAR_POINTS = 20
_CLEAR_SIGNAL = 3.0


@dataclass(frozen=True, slots=True)
class ProbingFigures:
    """What can be said about one probing before any fit.

    Parameters
    ----------
    name : str
    patch_triangles : int           triangles that the contact patch touches
    elements_per_radius : float     contact radius over mean edge length in the patch; NaN: vertex
    observed, missing : int
    median_displacement : float [m] of |u| over the measured points
    signal_to_noise : float         median |u| / sigma of a component; NaN where no sigma is given
    tangential_signal : float       the same for the part of u along the surface
    near : int                      measured points within eight contact radii
    """

    name: str
    patch_triangles: int
    elements_per_radius: float
    observed: int
    missing: int
    median_displacement: float
    signal_to_noise: float
    tangential_signal: float
    near: int


def check(session: Path, /) -> int:
    """Say everything about a session that can be said without solving.

    Parameters
    ----------
    session
        Folder of the session, or a session file in it.
    """
    given = read_session(session)
    require_probings(given)
    console = Console()
    console.print(f"{given.name} ({given.path})", markup=False, highlight=False)
    console.print(_mesh_table(given, mesh_quality(given.mesh)))
    figures = [probing_figures(given, probing) for probing in given.probings]
    console.print(_probings_table(figures))
    for note in given.notes:
        console.print(f"Note: {note}", markup=False, highlight=False)
    console.print(_outlook(given, figures), markup=False, highlight=False)
    return 0


def _outlook(session: Session, figures: list[ProbingFigures]) -> str:
    """What the displacements promise, or how they are still to be measured."""
    pictured = [
        one.name for one in session.probings if one.displacement is None and one.images is not None
    ]
    if len(pictured) == len(figures):
        return (
            f"{len(pictured)} probings have pictures and no displacements yet: `palpate flow` shows"
            " what can be read from them, `palpate fit` reads them itself."
        )
    return expectation(figures)


def probing_figures(session: Session, probing: Probing) -> ProbingFigures:
    """Contact, counts and signal of one probing.

    Parameters
    ----------
    session : Session
    probing : Probing               of that session, with a displacement field
    """
    mesh, contact, field = session.mesh, probing.contact, probing.displacement
    distance = triangle_distances(mesh, contact.point)
    radius = contact.radius
    patch = np.flatnonzero(distance < (radius or np.nextafter(distance.min(), np.inf)))
    corner = mesh.vertices[mesh.triangles[patch]]
    edge = np.linalg.norm(np.roll(corner, -1, axis=1) - corner, axis=2).mean()
    elements = radius / float(edge) if radius else float("nan")
    reach = _NEAR_RADII * (radius or float(edge))
    if field is None:
        blank = float("nan")
        return ProbingFigures(probing.name, len(patch), elements, 0, 0, blank, blank, blank, 0)
    measured = observed_rows(field)
    moved = field.displacement[measured]
    normal = unit_normals(mesh)[field.surface.triangle[measured]]
    along = moved - np.einsum("na,na->n", moved, normal)[:, None] * normal
    sigma = np.nan if field.std is None else field.std[measured].mean(axis=1)
    away = np.linalg.norm(field.points[measured] - contact.point, axis=1)
    return ProbingFigures(
        name=probing.name,
        patch_triangles=len(patch),
        elements_per_radius=elements,
        observed=int(measured.sum()),
        missing=int((~measured).sum()),
        median_displacement=float(np.median(np.linalg.norm(moved, axis=1))),
        signal_to_noise=float(np.median(np.linalg.norm(moved, axis=1) / sigma)),
        tangential_signal=float(np.median(np.linalg.norm(along, axis=1) / sigma)),
        near=int((away < reach).sum()),
    )


def expectation(figures: list[ProbingFigures]) -> str:
    """What the data may be able to tell, in words; a guess by counting, not a computation."""
    near = sum(figure.near for figure in figures)
    signal = [f.signal_to_noise for f in figures if np.isfinite(f.signal_to_noise)]
    weak = [f.name for f in figures if f.signal_to_noise < _CLEAR_SIGNAL]
    sentences = []
    if near < _ENOUGH_NEAR_POINTS:
        sentences.append(
            f"Only {near} measured points lie within {_NEAR_RADII:g} contact radii of a contact:"
            " such data show bending and stretching, which tell Young's modulus and next to"
            " nothing about Poisson's ratio."
        )
    else:
        sentences.append(
            f"{near} measured vectors lie within {_NEAR_RADII:g} contact radii of a contact:"
            " stiffness should be told, and Poisson's ratio too if their parts along the surface"
            " stand out of the noise."
        )
    if weak:
        names = ", ".join(weak[:5]) + (", ..." if len(weak) > 5 else "")
        sentences.append(
            f"Half the vectors or more are below {_CLEAR_SIGNAL:g} sigma in {len(weak)} of"
            f" {len(figures)} probings ({names}): expect wide intervals from these alone."
        )
    if not signal:
        sentences.append("No standard deviations are given; the noise will be estimated.")
    coarse = [f.name for f in figures if f.elements_per_radius < 1.0]
    if coarse:
        sentences.append(
            f"The contact is smaller than an element in {len(coarse)} probings: displacements next"
            " to it will be inaccurate; refine the mesh there or leave near points out."
        )
    return " ".join([*sentences, "This is a guess by counting: `palpate fit` decides."])


def _mesh_table(session: Session, quality: MeshQuality) -> Table:
    held = float(triangle_areas(session.mesh)[session.held_triangles].sum())
    share = 100.0 * held / quality.area
    table = Table(
        title="Surface: closed, manifold, outward, without self-intersection",
        box=SIMPLE_HEAD,
        show_header=False,
    )
    table.add_column("figure")
    table.add_column("value", justify="right", no_wrap=True)
    rows = (
        ("vertices, triangles", f"{quality.vertices}, {quality.triangles}"),
        ("size", " x ".join(f"{1e3 * side:.4g}" for side in quality.size) + " mm"),
        ("volume", f"{1e6 * quality.volume:.4g} cm^3"),
        ("area", f"{1e4 * quality.area:.4g} cm^2"),
        (
            "edges shortest, mean, longest",
            ", ".join(
                f"{1e3 * edge:.3g}"
                for edge in (quality.edge_shortest, quality.edge_mean, quality.edge_longest)
            )
            + " mm",
        ),
        ("worst aspect (longest edge / height)", f"{quality.worst_aspect:.2f}"),
        ("smallest angle", f"{np.degrees(quality.smallest_angle):.1f} degrees"),
        (
            "support",
            f"{len(session.held_triangles)} triangles, {1e4 * held:.4g} cm^2, {share:.1f} % of all",
        ),
        ("density", "-" if session.density is None else f"{session.density:g} kg/m^3"),
        (
            "gravity",
            "not in the model"
            if session.gravity is None
            else ", ".join(f"{a:g}" for a in session.gravity) + " m/s^2",
        ),
    )
    for row in rows:
        table.add_row(*row)
    return table


def _probings_table(figures: list[ProbingFigures]) -> Table:
    table = Table(
        title=f"{len(figures)} probings",
        box=SIMPLE_HEAD,
        caption=(
            "patch: triangles under the tool; elem: elements per contact radius; snr: median |u|"
            " over sigma; along: the same along the surface; near: measured points within"
            f" {_NEAR_RADII:g} contact radii"
        ),
    )
    table.add_column("probing")
    for heading in ("patch", "elem", "observed", "missing", "|u| mm", "snr", "along", "near"):
        table.add_column(heading, justify="right", no_wrap=True)
    for figure in figures:
        table.add_row(
            escape(figure.name),
            str(figure.patch_triangles),
            _plain(figure.elements_per_radius),
            str(figure.observed),
            str(figure.missing),
            f"{1e3 * figure.median_displacement:.3g}",
            _plain(figure.signal_to_noise),
            _plain(figure.tangential_signal),
            str(figure.near),
        )
    return table


def _plain(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "-"
