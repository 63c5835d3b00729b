"""`palpate mesh`: one closed surface with even triangles, of whatever surface there is."""

from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.table import Table

from palpate.app.terminal import print_notes, print_text, progress_bar, terminal_table
from palpate.figures import save_figure, surface_figure
from palpate.geometry import TriangleMesh, bounding_diagonal, read_mesh, triangle_areas
from palpate.records import LENGTH_UNITS, record_inputs, result_folder
from palpate.scanning import (
    PreparedSurface,
    place_text,
    plane_from_text,
    prepare_surface,
    read_points,
    write_prepared,
)

# A scan may have as many; they are remeshed to a thousandth.
_MOST_TRIANGLES = 2_000_000
# Beyond, a file in millimetres was taken for one in metres [m].
_LARGE = 3.0
_Unit = Literal["m", "cm", "mm", "um", "in"]


def mesh(
    file: Path,
    /,
    *,
    vertices: int = 1000,
    near: Path | None = None,
    support: str | None = None,
    length_unit: _Unit = "m",
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Make a closed surface with even triangles of any surface.

    Holes, cracks, copies, flipped and degenerate triangles, overlapping parts and stray pieces are
    mended; what cannot be is refused with its place and the reason. Everything done is printed and
    drawn, with the distance between both surfaces and the change of volume.

    Parameters
    ----------
    file
        A surface: .ply .obj .stl .off .msh .vtu .vtp
    vertices
        How many the mesh is to have: 500 to 3000 are good for a fit.
    near
        File of points, x y z in the unit of the mesh, that the mesh is to be finer near: where the
        object will be touched.
    support
        Plane that the object stood on, in the unit of the mesh: z=0, or a point and a normal,
        0,0,0,0,0,1. An open base is closed there; what is below is cut off.
    length_unit
        Of the file.
    out
        Result folder. Default: the file's name followed by -mesh, in the current folder.
    force
        Write although something else is at that place; it is kept beside it as NAME.old.

    Returns
    -------
    int
        0.
    """
    unit = LENGTH_UNITS[length_unit]
    plane = None if support is None else plane_from_text(support, metres_per_unit=unit)
    place = out or Path(f"{file.stem}-mesh")
    with result_folder(place, kind="mesh", force=force) as folder:
        record_inputs(folder, [file] if near is None else [file, near])
        given = read_mesh(file, metres_per_unit=unit, most=_MOST_TRIANGLES)
        print_notes(_size_note(given, length_unit))
        points = None if near is None else read_points(near, metres_per_unit=unit)
        with progress_bar() as progress:
            made = prepare_surface(
                given, vertices=vertices, near=points, support=plane, progress=progress
            )
        write_prepared(folder, made)
        save_figure(surface_figure(file.name, made), folder / "mesh.png")
    console = Console()
    if made.actions:
        console.print(_actions_table(made))
    console.print(_figures_table(made))
    print_text(f"Result in {place}")
    return 0


def _size_note(given: TriangleMesh, unit: str) -> list[str]:
    size = bounding_diagonal(given)
    if size < _LARGE:
        return []
    return [f"the object is {size:.3g} m across; if the file is not in {unit}, say --length-unit"]


def _actions_table(made: PreparedSurface) -> Table:
    rows = [(a.defect, str(a.count), place_text(a.place), a.done) for a in made.actions]
    return terminal_table("Mended", ("defect", "count", "the first", "done"), rows)


def _figures_table(made: PreparedSurface) -> Table:
    quality, off = made.quality, made.deviation
    edges = (quality.edge_shortest, quality.edge_mean, quality.edge_longest)
    gaps = (off.median, off.percentile_95, off.largest)
    rows = (
        ("vertices, triangles", f"{quality.vertices}, {quality.triangles}"),
        ("size", " x ".join(f"{1e3 * side:.4g}" for side in quality.size) + " mm"),
        ("volume", f"{1e6 * quality.volume:.4g} cm^3"),
        ("edges shortest, mean, longest", ", ".join(f"{1e3 * e:.3g}" for e in edges) + " mm"),
        ("smallest angle", f"{np.degrees(quality.smallest_angle):.1f} degrees"),
        (
            "distance median, 95 %, largest",
            ", ".join(f"{_rounded(1e3 * g):.2g}" for g in gaps) + " mm",
        ),
        ("change of volume", f"{round(100.0 * off.volume, 2) + 0.0:+.2f} %"),
        ("area that nobody measured", f"{100.0 * _guessed_share(made):.1f} %"),
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


def _guessed_share(made: PreparedSurface) -> float:
    areas = triangle_areas(made.mesh)
    return float(areas[made.guessed].sum() / areas.sum())
