"""`palpate mesh` and `palpate scan`: one closed surface with even triangles, of what there is."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
from rich.table import Table

from palpate.app.tables import terminal_table
from palpate.app.terminal import print_notes, print_tables, print_text, progress_bar
from palpate.errors import InputError, MeshError
from palpate.figures import save_figure, scan_figure, surface_figure
from palpate.geometry import (
    STEP_SUFFIXES,
    WRITTEN_SUFFIXES,
    MeshQuality,
    TriangleMesh,
    bounding_diagonal,
    place_text,
    read_mesh,
    triangle_areas,
    write_mesh,
)
from palpate.progress import part_of
from palpate.records import (
    LENGTH_UNITS,
    TomlTable,
    check_free,
    default_folder,
    record_inputs,
    result_folder,
)
from palpate.scanning import (
    PreparedSurface,
    ScannedSurface,
    plane_from_text,
    prepare_surface,
    read_points,
    read_scan,
    scan_surface,
    write_surface,
)

# A scan may have as many; they are remeshed to a thousandth.
_MAX_TRIANGLES = 2_000_000
# Beyond, a file in millimetres was probably taken for one in metres [m].
_LARGEST_SIZE = 3.0
# Those that a session may have.
_Unit = Literal["m", "cm", "mm", "in"]


def mesh(
    file: Path,
    /,
    *,
    vertices: int = 1000,
    near: Path | None = None,
    support: str | None = None,
    length_unit: _Unit | None = None,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Repair and remesh a surface: closed, with even triangles.

    Repairs holes, cracks, duplicate, flipped and degenerate triangles, overlapping parts and stray
    pieces; refuses what it cannot repair, and says where and why. Prints and draws every change,
    with the distance between the two surfaces and the change in volume.

    Parameters
    ----------
    file
        A surface: .ply .obj .stl .off .msh .vtu .vtp, or a drawing: .step .stp
    vertices
        Number of vertices wanted: 500 to 3000 suit a fit.
    near
        File of points, x y z, near which the mesh is to be finer: where the object will be touched.
    support
        Plane that the object stood on: z=0, or a point and a normal,
        0,0,0,0,0,1. An open base is closed there; what is below is cut off.
    length_unit
        Unit of the file, the points, the plane and the mesh that is written; default: m. A drawing
        states its own unit; this is then that of the others.
    out
        Result folder, or a name such as part.ply or part.stl for the mesh alone. Default: the
        file's name followed by -mesh, in the current folder.
    force
        Overwrite whatever is there; a folder's old content is kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    unit = LENGTH_UNITS[length_unit or "m"]
    plane = None if support is None else plane_from_text(support, metres_per_unit=unit)
    destination = out or Path(f"{file.stem}-mesh")
    with _surface_folder(destination, "mesh", force) as folder:
        given = read_mesh(file, metres_per_unit=unit, most=_MAX_TRIANGLES)
        _check_size(file, given, length_unit)
        points = None if near is None else read_points(near, metres_per_unit=unit)
        try:
            with progress_bar("fewer --vertices") as progress:
                made = prepare_surface(
                    given, vertices=vertices, near=points, support=plane, progress=progress
                )
        except MeshError as error:
            raise MeshError(f"{file}: {error}") from error
        if folder is None:
            write_mesh(destination, made.mesh, metres_per_unit=unit)
        else:
            record_inputs(folder, [file] if near is None else [file, near])
            write_surface(folder, made, metres_per_unit=unit)
            save_figure(surface_figure(file.name, made), folder / "mesh.png")
    if made.actions:
        print_tables(_actions_table(made))
    print_tables(_figures_table(made))
    print_text(_result_text(destination, length_unit or "m"))
    return 0


def scan(
    scan: Path,
    /,
    *,
    vertices: int = 1000,
    near: Path | None = None,
    length_unit: _Unit = "m",
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Build an object's mesh from scans or depth maps taken from one or more viewpoints.

    Merges points, depth maps or pictures of a calibrated rig, as listed in scan.toml, into one
    surface; closes and marks what no view shows; gives each vertex a standard deviation.

    Parameters
    ----------
    scan
        scan.toml, or its folder.
    vertices
        Number of vertices wanted: 500 to 3000 suit a fit.
    near
        File of points, x y z, near which the mesh is to be finer.
    length_unit
        Of that file.
    out
        Result folder, or a name such as part.ply or part.stl for the mesh alone. Default: the
        scan's folder name followed by -mesh, in the current folder.
    force
        Overwrite whatever is there; a folder's old content is kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    destination = out or default_folder(scan if scan.is_dir() else scan.parent, "mesh")
    with _surface_folder(destination, "scan", force) as folder:
        with progress_bar("fewer views, or fewer --vertices") as progress:
            read = read_scan(scan, progress=part_of(progress, 0.0, 0.6))
            points = None
            if near is not None:
                points = read_points(near, metres_per_unit=LENGTH_UNITS[length_unit])
            with TomlTable(read.path, "", {}).error_context():
                made = scan_surface(
                    read.views, vertices=vertices, near=points, support=read.support,
                    progress=part_of(progress, 0.6, 1.0),
                )  # fmt: skip
        if folder is None:
            write_mesh(destination, made.mesh)
        else:
            record_inputs(folder, read.files if near is None else [*read.files, near])
            write_surface(folder, made)
            save_figure(scan_figure(read.path.parent.resolve().name, made), folder / "scan.png")
    print_tables(_views_table(made))
    print_tables(_scan_table(made))
    print_text(_result_text(destination, "m"))
    return 0


@contextmanager
def _surface_folder(destination: Path, kind: str, force: bool) -> Iterator[Path | None]:
    """The temporary folder of a result; None: the destination is a file, for the mesh alone."""
    if destination.suffix.lower() not in WRITTEN_SUFFIXES or destination.is_dir():
        with result_folder(destination, kind=kind, force=force) as folder:
            yield folder
        return
    check_free(destination, force=force)
    yield None


def _views_table(made: ScannedSurface) -> Table:
    rows = [
        (view.name, str(view.points), f"{100.0 * view.overlap:.0f}", f"{1e3 * view.offset:.2g}")
        for view in made.agreements
    ]
    return terminal_table(
        "Views", ("view", "points", "overlap %", "off mm"), rows,
        caption="overlap: of its points, those that other views show too; off: median distance from"
        " the others' surface there",
    )  # fmt: skip


def _scan_table(made: ScannedSurface) -> Table:
    sigma = 1e3 * made.sigma[np.isfinite(made.sigma)]
    spread = f"{np.median(sigma):.2g}, {np.quantile(sigma, 0.95):.2g} mm" if len(sigma) else "-"
    rows = (
        *_quality_rows(made.quality, f" ± {1e6 * made.volume_std:.2g}"),
        (
            "points from the mesh median, 95 %",
            ", ".join(f"{1e3 * g:.2g}" for g in made.distance) + " mm",
        ),
        ("1 sigma of vertices median, 95 %", spread),
        ("area that no view shows", f"{100.0 * _guessed_fraction(made):.1f} %"),
    )
    return terminal_table(
        "Surface: closed, manifold, outward, without self-intersection", ("figure", "value"), rows,
        caption="± and sigma: from the scatter of the points; what all points of a view share, as"
        " an error of its pose, is not in them, nor is what no view shows",
    )  # fmt: skip


def _check_size(file: Path, given: TriangleMesh, unit: _Unit | None) -> None:
    """Refuse a size that no object on a bench has, where the unit was not given; else note it."""
    size = bounding_diagonal(given)
    if size < _LARGEST_SIZE:
        return
    across = f"the object is {size:.3g} m across"
    if unit is not None or file.suffix.lower() in STEP_SUFFIXES:
        print_notes([f"{across}; is the file in another unit than {unit or 'it says'}?"])
        return
    raise InputError(
        f"{file}: does not say its unit, and in metres {across}; give the unit: --length-unit mm"
        f" makes it {1e-3 * size:.3g} m across, --length-unit m leaves it as it is"
    )


def _result_text(destination: Path, unit: _Unit) -> str:
    """Where the result is, and what a session says of its mesh."""
    mesh = "its mesh.ply is" if destination.is_dir() else "it is"
    return (
        f'Result in {destination}; {mesh} in {unit}: write length_unit = "{unit}" under'
        " [object] in session.toml"
    )


def _actions_table(made: PreparedSurface) -> Table:
    rows = [(a.defect, str(a.count), place_text(a.place), a.done) for a in made.actions]
    return terminal_table("Mended", ("defect", "count", "the first", "done"), rows)


def _figures_table(made: PreparedSurface) -> Table:
    deviation = made.deviation
    gaps = (deviation.median, deviation.percentile_95, deviation.largest)
    rows = (
        *_quality_rows(made.quality),
        (
            "distance median, 95 %, largest",
            ", ".join(f"{_rounded(1e3 * g):.2g}" for g in gaps) + " mm",
        ),
        ("change of volume", f"{round(100.0 * deviation.volume, 2) + 0.0:+.2f} %"),
        ("area that nobody measured", f"{100.0 * _guessed_fraction(made):.1f} %"),
    )
    return terminal_table(
        "Surface: closed, manifold, outward, without self-intersection",
        ("figure", "value"),
        rows,
        caption="distance and change of volume: of the even triangles against the mended surface",
    )


def _rounded(millimetres: float) -> float:
    """A length without digits below a nanometre."""
    return round(millimetres, 6)


def _quality_rows(quality: MeshQuality, volume_error: str = "") -> list[tuple[str, str]]:
    edges = (quality.edge_shortest, quality.edge_mean, quality.edge_longest)
    return [
        ("vertices, triangles", f"{quality.vertices}, {quality.triangles}"),
        ("size", " x ".join(f"{1e3 * side:.4g}" for side in quality.size) + " mm"),
        ("volume", f"{1e6 * quality.volume:.4g}{volume_error} cm^3"),
        ("edges shortest, mean, longest", ", ".join(f"{1e3 * e:.3g}" for e in edges) + " mm"),
        ("smallest angle", f"{np.degrees(quality.smallest_angle):.1f} degrees"),
    ]


def _guessed_fraction(made: PreparedSurface | ScannedSurface) -> float:
    areas = triangle_areas(made.mesh)
    return float(areas[made.guessed].sum() / areas.sum())
