"""`palpate calibrate object`: the rig before an object whose mesh is there, and the rig refined."""

from pathlib import Path
from typing import Literal

import numpy as np
from rich.table import Table

from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.progress import progress_bar
from palpate.app.terminal.tables import terminal_table
from palpate.calibration import ObjectView, find_instants, view_object, write_object_view
from palpate.figures import object_figure, save_figure
from palpate.geometry import read_mesh
from palpate.records import (
    LENGTH_UNITS,
    covariance_file,
    read_rig,
    read_rig_covariance,
    record_inputs,
    result_folder,
)

_Unit = Literal["m", "cm", "mm", "um", "in"]


def calibrate_object(
    images: str,
    mesh: Path,
    /,
    *,
    rig: Path,
    refine: bool = False,
    length_unit: _Unit = "m",
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Locate a known object in the view of a calibrated rig, from pictures of it at rest.

    Registers points of its surface with its mesh, and writes the rig in the object's frame, the
    covariance of the pose, and a picture of the mesh over the object.

    Parameters
    ----------
    images
        Pictures of the object at rest, with {camera} in place of the camera's name; a * stands for
        several instants: 'rest/v*_{camera}.png'. The object's pose is that of the first.
    mesh
        Its surface: .ply .obj .stl .off .msh .vtu .vtp
    rig
        rig.toml or the calibration of another program, or its folder, in any frame.
    refine
        Also correct the rig, from the object's texture as all cameras see it at all instants. If
        that does not improve the rig, it is left unchanged, and a note says so.
    length_unit
        Of the mesh.
    out
        Result folder. Default: the mesh's name followed by -rig, in the current folder.
    force
        Overwrite whatever is there; the old content is kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    given = read_rig(rig)
    surface = read_mesh(mesh, metres_per_unit=LENGTH_UNITS[length_unit])
    covariance = covariance_file(rig)
    known = None if covariance is None else read_rig_covariance(covariance)
    destination = out or Path(f"{mesh.stem}-rig")
    with result_folder(destination, kind="calibrate", force=force) as folder:
        instants = find_instants(given, images)
        pictures = [
            Path(pattern.replace("{camera}", camera.name))
            for pattern in (instants if refine else instants[:1])
            for camera in given.cameras
        ]
        with progress_bar() as progress:
            view = view_object(
                given, surface, instants, known=known, refine=refine, progress=progress
            )
        record_inputs(folder, [*pictures, mesh])
        write_object_view(folder, view, known)
        save_figure(object_figure(view.rig, surface, view.grey), folder / "object.png")
    print_notes(view.notes)
    print_tables(_table(view))
    print_text(f"{_refinement(view)}Result in {destination}")
    return 0


def _table(view: ObjectView) -> Table:
    found = view.registration
    sigma = np.sqrt(np.diag(view.covariance))
    rows = [
        ("points of the surface", str(view.points)),
        ("of them on the mesh", f"{100.0 * found.inliers:.0f} %"),
        ("distance from it, rms", f"{1e3 * found.residual:.2g} mm"),
        ("turn x, y, z, 1 sigma", ", ".join(f"{x:.2g}" for x in np.degrees(sigma[:3])) + " deg"),
        ("shift x, y, z, 1 sigma", ", ".join(f"{1e3 * x:.2g}" for x in sigma[3:]) + " mm"),
    ]
    return terminal_table(
        "Object before the rig", ("figure", "value"), rows,
        caption="sigma: of the object's pose, from the points' scatter; errors of the mesh and of"
        " the cameras are not in it",
    )  # fmt: skip


def _refinement(view: ObjectView) -> str:
    """What became of the rig, in sentences."""
    refined = view.refined
    if refined is None:
        return ""
    held = (
        f"rays of points that took no part miss each other by {refined.after:.3f} px, with the rig"
        f" as it was by {refined.before:.3f} px"
    )
    if not refined.better:
        return (
            f"The rig is left as it was: refined from {refined.points} points, {held}; that, or the"
            " distance of the surface from the mesh, is no better\n"
        )
    return (
        f"The rig is refined from {refined.points} points, {refined.rejected} left out: {held};"
        f" what changed most is {refined.largest_change}\n"
    )
