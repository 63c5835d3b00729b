"""`palpate check`: what can be checked in a session without solving."""

from pathlib import Path

import numpy as np
from rich.table import Table

from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.tables import number_text, terminal_table
from palpate.bem import check_memory
from palpate.geometry import mesh_quality, triangle_areas
from palpate.pipeline import (
    NEAR_RADII,
    CameraSurvey,
    ProbingSurvey,
    ViewSurvey,
    moving_supports,
    reciprocity,
    require_given_motions,
    session_outlook,
    size_notes,
    sliding_motion,
    survey_cameras,
    survey_probing,
    survey_view,
)
from palpate.records import Session, read_session
from palpate.shapes import Vector3


def check(session: Path, /) -> int:
    """Check a session without fitting it: files, units, forces, contacts, pictures.

    Reads everything that `fit` and `flow` would: surface, displacements, cameras, every picture.

    Parameters
    ----------
    session
        Folder of the session, or a session file in it.
    """
    given = read_session(session, allow=check_memory)
    require_given_motions(given)
    cameras, remarks = survey_cameras(given)
    view, doubts = survey_view(given)
    surveys = [survey_probing(given, probing) for probing in given.probings]
    print_text(f"{given.name} ({given.path})")
    print_tables(_mesh_table(given))
    if surveys:
        print_tables(_probings_table(surveys))
    if cameras:
        print_tables(_cameras_table(cameras))
    if view is not None:
        print_tables(_view_table(view, cameras))
    for note in (*given.notes, *size_notes(given), *remarks, *doubts):
        print_text(f"Note: {note}")
    if sum(probing.displacement is not None for probing in given.probings) > 1:
        print_text(reciprocity(given).text)
    print_text(session_outlook(given, surveys))
    return 0


def _mesh_table(session: Session) -> Table:
    quality = mesh_quality(session.mesh)
    moves = moving_supports(session)
    held = float(triangle_areas(session.mesh)[session.held_triangles].sum())
    support = f"{len(session.held_triangles)} triangles, {1e4 * held:.4g} cm^2,"
    support += f" {100.0 * held / quality.area:.1f} % of all"
    moving_rows = [
        (support.number, f"{support.motion}, {len(support.triangles)} triangles")
        for support in moves
    ]
    edges = (quality.edge_shortest, quality.edge_mean, quality.edge_longest)
    gravity, density = session.gravity, session.density
    rows = (
        ("vertices, triangles", f"{quality.vertices}, {quality.triangles}"),
        ("size", " x ".join(f"{1e3 * side:.4g}" for side in quality.size) + " mm"),
        ("volume", f"{1e6 * quality.volume:.4g} cm^3"),
        ("area", f"{1e4 * quality.area:.4g} cm^2"),
        ("edges shortest, mean, longest", ", ".join(f"{1e3 * e:.3g}" for e in edges) + " mm"),
        ("worst aspect (longest edge / height)", f"{quality.worst_aspect:.2f}"),
        ("smallest angle", f"{np.degrees(quality.smallest_angle):.1f} degrees"),
        ("support", support if session.probings else "-"),
        *((f"support {n} moves", motion) for n, motion in moving_rows),
        *((f"support {n} holds", what) for n, what in _rollers(session)),
        *((f"support {n} gives", what) for n, what in _springs(session)),
        ("density", "-" if density is None else f"{density:g} kg/m^3"),
        ("gravity", "not in the model" if gravity is None else _acceleration(gravity)),
    )
    title = "Surface: closed, manifold, outward, without self-intersection"
    return terminal_table(title, ("figure", "value"), rows)


def _rollers(session: Session) -> list[tuple[int, str]]:
    """Supports that hold some directions only, by their numbers; at the first, what slides."""
    found = []
    slides = sliding_motion(session)
    for number, support in enumerate(session.supports, start=1):
        if support.directions is not None:
            held = [", ".join(f"{x:.3g}" for x in row) for row in support.directions + 0.0]
            text = "only " + " and ".join(f"({row})" for row in held)
            if slides is not None and slides.number == number:
                text += "; the object slides, and how far is estimated"
            found.append((number, text))
    return found


def _springs(session: Session) -> list[tuple[int, str]]:
    """Supports that give, by their numbers, and how far they would under the largest force."""
    found = []
    areas = triangle_areas(session.mesh)
    force = max((float(np.linalg.norm(probing.force)) for probing in session.probings), default=0.0)
    for number, support in enumerate(session.supports, start=1):
        if support.stiffness is not None:
            settlement = force * support.compliance / float(areas[support.triangles].sum())
            text = f"{support.stiffness:.3g} N/m^3: {1e3 * settlement:.3g} mm under {force:.3g} N"
            found.append((number, text))
    return found


def _acceleration(vector: Vector3) -> str:
    return ", ".join(f"{component:g}" for component in vector) + " m/s^2"


def _probings_table(surveys: list[ProbingSurvey]) -> Table:
    rows = [
        (
            s.name, str(s.patch_triangles), number_text(s.elements_per_radius, ".1f"),
            str(s.observed), str(s.missing), number_text(1e3 * s.median_displacement, ".3g"),
            number_text(s.signal_to_noise, ".1f"), number_text(s.tangential_signal, ".1f"),
            str(s.near),
        )
        for s in surveys
    ]  # fmt: skip
    return terminal_table(
        f"{len(surveys)} probings",
        ("probing", "patch", "elem", "observed", "missing", "|u| mm", "snr", "along", "near"),
        rows,
        caption="patch: triangles under the tool; elem: elements per contact radius; snr: median"
        " |u| over sigma; along: the same along the surface; near: measured points within"
        f" {NEAR_RADII:g} contact radii",
    )


def _cameras_table(surveys: tuple[CameraSurvey, ...]) -> Table:
    rows = []
    for s in surveys:
        sizes = dict.fromkeys(f"{p.size[0]} x {p.size[1]}" for p in s.pictures)
        low = min((p.grey[0] for p in s.pictures), default=np.nan)
        high = max((p.grey[1] for p in s.pictures), default=np.nan)
        white = max((p.saturated for p in s.pictures), default=np.nan)
        rows.append(
            (
                s.name, str(len(s.pictures)), ", ".join(sizes) or "-",
                f"{number_text(low, '.0f')} to {number_text(high, '.0f')}",
                number_text(100.0 * white, ".2g"), number_text(100.0 * s.sees, ".0f"),
            )
        )  # fmt: skip
    return terminal_table(
        f"{len(surveys)} cameras",
        ("camera", "pictures", "size px", "grey", "white %", "sees %"),
        rows,
        caption="grey: 1st to 99th percentile over all pictures, 255 is white; white: pixels at the"
        " white end of the worst picture; sees: vertices of the mesh inside the picture",
    )


def _view_table(view: ViewSurvey, cameras: tuple[CameraSurvey, ...]) -> Table:
    """What the first pictures promise."""
    lengths = zip(cameras, view.structure, strict=True)
    rows = (
        ("windows on the surface", str(view.points)),
        ("of them, with texture and two cameras", str(view.followed)),
        ("vertices that would be measured", str(view.vertices)),
        ("windows around each, median", f"{view.windows:.0f}"),
        *(
            (f"structure in {camera.name}", f"{number_text(px, '.1f')} px")
            for camera, px in lengths
        ),
    )
    return terminal_table(
        "The first pictures", ("figure", "value"), rows,
        caption="before anything moves: a tool will hide some; structure: the length over which a"
        " grey level changes by its own spread, 1 to 3 px for a sharp speckle",
    )  # fmt: skip
