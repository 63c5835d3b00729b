"""`palpate plan`: where to push next, and what it promises."""

from pathlib import Path

from rich.table import Table

from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.progress import progress_bar
from palpate.app.terminal.tables import terminal_table
from palpate.bem import check_memory
from palpate.figures import next_probings_figure, save_figure
from palpate.pipeline import NextProbings, plan_next, with_pictures_measured
from palpate.records import (
    default_folder,
    modulus_unit,
    read_session,
    record_inputs,
    result_folder,
    session_files,
)


def plan(
    session: Path,
    /,
    *,
    next: bool = True,
    count: int = 3,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Suggest where to push next so that the constants become most certain.

    Fits the session as it is, compares some forty places within reach of a tool like its first one
    by their Fisher information (shared errors included), and names the best in order, with the
    standard deviations to expect after each.

    Parameters
    ----------
    session
        Folder of a session with one measured probing or more.
    next
        Suggest where to push next. This is what the command does, with or without the flag.
    count
        Number of places to suggest.
    out
        Folder for the picture. Default: the session's folder name followed by -next, in the current
        folder.
    force
        Overwrite even if the target is not an unchanged result of this command; the old content is
        kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    target = out or default_folder(session, "next")
    with result_folder(target, kind="plan", force=force) as folder:
        given = read_session(session, allow=check_memory)
        record_inputs(folder, session_files(session))
        print_notes(given.notes)
        with progress_bar() as progress:
            measured = with_pictures_measured(given, progress=progress)
            found = plan_next(measured, count=count, progress=progress)
            save_figure(next_probings_figure(given.name, found), folder / "next.png")
    print_tables(_table(found))
    print_text(f"Picture in {target / 'next.png'}")
    return 0


def _table(found: NextProbings) -> Table:
    """What is measured, and one row for each chosen place."""
    factor, unit = modulus_unit(found.information.shear_modulus)
    rows = [("now", "", "", *_deviations(found.now, factor))]
    for number, (k, after) in enumerate(zip(found.chosen, found.after, strict=True), start=1):
        place = ", ".join(f"{1e3 * x:.1f}" for x in found.point[k])
        force = ", ".join(f"{found.force * x:.2g}" for x in found.inward[k])
        rows.append((f"+ {number}", place, force, *_deviations(after, factor)))
    return terminal_table(
        f"Where to push next, with a radius of {1e3 * found.radius:.3g} mm",
        ("pushes", "place mm", "force N", "sd nu", f"sd G {unit}", f"sd E {unit}"),
        rows,
        caption=f"best of {len(found.point)} places; sd: standard deviations to expect with all"
        " pushes up to this row",
    )


def _deviations(precision: dict[str, float], factor: float) -> tuple[str, str, str]:
    return (
        f"{precision['poisson_ratio']:.2g}",
        f"{precision['shear_modulus'] / factor:.2g}",
        f"{precision['young_modulus'] / factor:.2g}",
    )
