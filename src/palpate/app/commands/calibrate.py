"""`palpate calibrate`: a rig from pictures of a flat target, the target itself, and a rig before a
known object."""

from pathlib import Path
from typing import Literal

import numpy as np
from rich.table import Table

from palpate.app.tables import terminal_table
from palpate.app.terminal import print_notes, print_tables, print_text, progress_bar
from palpate.calibration import (
    TARGET_KINDS,
    Calibration,
    CameraQuality,
    Charuco,
    ObjectView,
    Target,
    baseline_text,
    board_frame,
    calibrate as calibrate_cameras,
    camera_quality,
    find_boards,
    find_instants,
    find_pictures,
    find_videos,
    length_check,
    length_sigma,
    make_target,
    middle_view,
    still_frames,
    timing_note,
    view_object,
    without_repeats,
    write_calibration,
    write_object_view,
)
from palpate.disk import atomic_replacement
from palpate.errors import CalibrationError, InputError
from palpate.figures import (
    board_figure,
    object_figure,
    residual_figure,
    rig_figure,
    save_drawing,
    save_figure,
    save_page,
)
from palpate.geometry import read_mesh
from palpate.probe import metres_from_text
from palpate.progress import Progress, part_of
from palpate.records import (
    LENGTH_UNITS,
    check_free,
    covariance_file,
    default_folder,
    read_rig,
    read_rig_covariance,
    record_inputs,
    result_folder,
)

_PAGE_SUFFIXES = (".pdf", ".png")
_Kind = Literal["charuco", "chessboard", "circles", "asymmetric-circles", "aprilgrid"]
_Unit = Literal["m", "cm", "mm", "um", "in"]


def calibrate(
    pictures: Path,
    /,
    *,
    columns: int,
    rows: int,
    square: str,
    target: _Kind = "charuco",
    marker: str | None = None,
    gap: str | None = None,
    dictionary: str | None = None,
    boards: int = 1,
    table: str | None = None,
    baseline: str | None = None,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Calibrate one or more cameras from pictures of a flat target.

    Finds lens and pose of every camera in one adjustment of all corners, with their covariance, and
    writes them as rig.toml and in the formats of OpenCV and Kalibr, with pictures of the residuals.

    Parameters
    ----------
    pictures
        Folder with a folder of pictures for every camera; pictures of one instant have the same
        name, the camera's own name within it apart. Or a folder with a video for every camera,
        named like it, whose frames of one number are of one instant.
    columns
        Squares in a row of a ChArUco board, inner corners of a chessboard, circles, tags.
    rows
        The same from top to bottom.
    square
        Side of a square with its unit, like 12mm; for circles their spacing (for an asymmetric
        grid, that of its rows), for an AprilTag grid the side of a tag.
    target
        Kind of target in the pictures.
    marker
        Side of a ChArUco board's markers with its unit.
    gap
        White between two AprilTags with its unit.
    dictionary
        Of the markers. Default: 4x4_250, for AprilTags apriltag_36h11.
    boards
        Number of ChArUco boards in the scene; marker numbers continue from board to board.
    table
        View in which the board lies where the object will stand. The rig's frame is then the
        board's: origin at its centre, x along its rows, z up. Default: the frame of the first
        camera.
    baseline
        Independently measured distance between the first two cameras, with its unit: checks the
        stated size of the board.
    out
        Result folder. Default: the pictures' folder name followed by -rig, in the current folder.
    force
        Overwrite whatever is there; the old content is kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    named = _make_target(target, columns, rows, square, marker, gap, dictionary)
    targets = _boards(named, boards)
    baseline_length = None if baseline is None else metres_from_text(baseline, name="--baseline")
    destination = out or default_folder(pictures, "rig")
    with result_folder(destination, kind="calibrate", force=force) as folder:
        with progress_bar("fewer pictures: some 20 of each camera do") as progress:
            calibration = _calibrate(pictures, targets, folder, progress)
        lengths = "" if baseline_length is None else baseline_text(calibration, baseline_length)
        frame = None if table is None else board_frame(calibration, targets, table)
        write_calibration(folder, calibration, frame=frame)
        save_figure(residual_figure(calibration), folder / "residuals.png")
        save_drawing(rig_figure(calibration), folder / "rig.png")
    timing = timing_note(calibration)
    print_notes([*calibration.notes, *([timing] if timing else [])])
    quality = camera_quality(calibration)
    print_tables(_table(calibration, quality))
    print_notes([text for camera in quality for text in camera.missing])
    print_text(f"{_lengths(calibration, targets, table)}{lengths}Result in {destination}")
    return 0


def board(
    file: Path,
    /,
    *,
    columns: int = 9,
    rows: int = 7,
    square: str = "20mm",
    marker: str = "15mm",
    dictionary: str = "4x4_250",
    first: int = 0,
    force: bool = False,
) -> int:
    """Draw a ChArUco board in true size, with a ruler to check the print.

    Parameters
    ----------
    file
        Ending .pdf or .png.
    columns
        Squares in a row.
    rows
        Rows of squares.
    square
        Side of a square with its unit.
    marker
        Side of a marker with its unit.
    dictionary
        Of the markers.
    first
        Number of the first marker; a second board starts where the first one ends.
    force
        Replace a file of that name.

    Returns
    -------
    int
        0.
    """
    if file.suffix.lower() not in _PAGE_SUFFIXES:
        raise InputError(f"{file}: ends neither in .pdf nor in .png")
    check_free(file, force=force)
    drawn = Charuco(
        columns, rows, metres_from_text(square, name="--square"),
        metres_from_text(marker, name="--marker"), dictionary, first,
    )  # fmt: skip
    page = board_figure(drawn)
    with atomic_replacement(file) as staged:
        save_page(page, staged, kind=file.suffix[1:].lower())
    width, height = (25.4 * page.get_size_inches()).round(1)
    print_text(
        f"{file}: {width:g} x {height:g} mm; print it at 100 %, glue it to something flat, and"
        " measure the ruler"
    )
    return 0


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
        with progress_bar("fewer pictures, or leave --refine out") as progress:
            view = view_object(
                given, surface, instants, known=known, refine=refine, progress=progress
            )
        record_inputs(folder, [*pictures, mesh])
        write_object_view(folder, view, known)
        save_figure(object_figure(view.rig, surface, view.grey), folder / "object.png")
    print_notes(view.notes)
    print_tables(_object_table(view))
    print_text(f"{_refinement(view)}Result in {destination}")
    return 0


def _calibrate(
    pictures: Path, targets: list[Target], folder: Path, progress: Progress
) -> Calibration:
    """Calibration from pictures or videos; used frames stay in the result."""
    videos = find_videos(pictures)
    if not videos:
        files = find_pictures(pictures)
        all_files = [path for by_instant in files.values() for path in by_instant.values()]
        record_inputs(folder, all_files)
        sightings = find_boards(files, targets, progress=part_of(progress, 0.0, 0.9))
        progress("adjustment", 0.9)
        return calibrate_cameras(sightings, targets)
    record_inputs(folder, list(videos.values()))
    still = still_frames(videos, folder / "frames", progress=part_of(progress, 0.0, 0.6))
    sightings = find_boards(still, targets, progress=part_of(progress, 0.6, 0.9))
    progress("adjustment", 0.9)
    calibration = calibrate_cameras(without_repeats(sightings), targets)
    used = {view.split(" ")[0] for view in calibration.sightings.views}
    for by_instant in still.values():
        for instant, path in by_instant.items():
            if instant not in used:
                path.unlink()
    return calibration


def _make_target(
    kind: str,
    columns: int,
    rows: int,
    square: str,
    marker: str | None,
    gap: str | None,
    dictionary: str | None,
) -> Target:
    name = TARGET_KINDS[kind]
    text = {"marker": marker, "gap": gap, None: ""}[name]
    if text is None:
        raise InputError(f"a target of kind {kind} needs --{name}, with its unit, like 9mm")
    second = metres_from_text(text, name=f"--{name}") if text else None
    side = metres_from_text(square, name="--square")
    return make_target(kind, columns, rows, side, second, dictionary)


def _boards(target: Target, count: int) -> list[Target]:
    """The target, and those beside it with the markers that follow."""
    if count == 1:
        return [target]
    if not isinstance(target, Charuco) or count < 1:
        raise InputError(f"--boards is {count}; only ChArUco boards can stand side by side")
    step = target.columns * target.rows // 2
    return [
        Charuco(
            target.columns, target.rows, target.square, target.marker, target.dictionary, k * step
        )
        for k in range(count)
    ]


def _table(calibration: Calibration, quality: tuple[CameraQuality, ...]) -> Table:
    sigma = dict(zip(calibration.names, np.sqrt(np.diag(calibration.covariance)), strict=True))
    rows = []
    for camera, errors in zip(calibration.cameras, quality, strict=True):
        k = camera.matrix
        fx, cx, cy = (f"{sigma[f'{camera.name}.{term}']:.2f}" for term in ("fx", "cx", "cy"))
        worst = float(np.nanmax(errors.rms))
        rows.append(
            (
                camera.name, str(errors.views),
                f"{errors.corners - errors.rejected}/{errors.corners}",
                f"{errors.noise:.3f}", f"{worst:.3f}",
                f"{k[0, 0]:.2f} ± {fx}", f"{k[0, 2]:.2f} ± {cx}, {k[1, 2]:.2f} ± {cy}",
            )
        )  # fmt: skip
    columns = (
        "camera", "views", "corners", "noise px", "worst region px", "focal length px", "centre px"
    )  # fmt: skip
    caption = (
        "corners: used of those found; noise: standard deviation of a coordinate of a corner; worst"
        " region: rms distance in the worst ninth of the picture; ±: one standard deviation"
    )
    return terminal_table("Cameras", columns, rows, caption=caption)


def _lengths(calibration: Calibration, targets: list[Target], table: str | None) -> str:
    """How well the rig measures lengths, where it has two cameras."""
    if len(calibration.cameras) < 2:
        return ""
    view = table or middle_view(calibration)
    try:
        sigma = length_sigma(calibration, targets, view)
    except CalibrationError as unseen:
        return f"{unseen}\n"
    text = (
        f"Lengths on an object where the board of view '{view}' was are known to"
        f" {100 * sigma:.2g} % of the board's own\n"
    )
    check = length_check(calibration)
    if check is None:
        return text
    views, error, scatter = check
    return (
        f"{text}Check: {views} boards that a second calibration was not shown are measured"
        f" {100 * error:+.3f} ± {100 * scatter / np.sqrt(views):.3f} % too large\n"
    )


def _object_table(view: ObjectView) -> Table:
    registration = view.registration
    sigma = np.sqrt(np.diag(view.covariance))
    rows = [
        ("points of the surface", str(view.points)),
        ("of them on the mesh", f"{100.0 * registration.inliers:.0f} %"),
        ("distance from it, rms", f"{1e3 * registration.residual:.2g} mm"),
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
