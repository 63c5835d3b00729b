"""`palpate plan` and `palpate lab plan`: where to push next, and what to expect of pictures that
are still to be taken."""

from pathlib import Path

import cv2
import numpy as np
from rich.table import Table

from palpate.app.tables import budget_sentences, number_text, terminal_table
from palpate.app.terminal import Modulus, print_notes, print_tables, print_text, progress_bar
from palpate.bem import check_memory
from palpate.errors import InputError
from palpate.figures import next_probings_figure, save_figure
from palpate.lab import Pictures, choose_variant
from palpate.pipeline import (
    PREDICTION,
    MeasurementPlan,
    NextProbings,
    plan_measurement,
    plan_next,
    with_pictures_measured,
)
from palpate.records import (
    default_folder,
    modulus_unit,
    read_session,
    record_inputs,
    result_folder,
    session_files,
)

_CAPTION = (
    "seen: vertices that the pictures tell the motion of; |u|, sigma: median displacement there,"
    " and of its standard deviation; a dash: not determined; for a good speckle, a true rig and a"
    " material as the model takes it."
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
    standard deviations to expect after each. Of a body that is not the same everywhere these are
    the places from which displacements under a push anywhere become most certain.

    Parameters
    ----------
    session
        Folder of a session with one measured probing or more.
    next
        Suggest where to push next. This is what the command does, with or without the flag.
    count
        Number of places to suggest, 40 at most.
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
        with progress_bar("a coarser mesh") as progress:
            measured = with_pictures_measured(given, progress=progress)
            planned = plan_next(measured, count=count, progress=progress)
            save_figure(next_probings_figure(given.name, planned), folder / "next.png")
    print_tables(_table(planned))
    print_text(f"Picture in {target / 'next.png'}")
    return 0


def plan_pictures(
    session: Path,
    /,
    *,
    young_modulus: Modulus,
    poisson_ratio: float = 0.3,
    noise: float = 1.5,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Predict a measurement: what each camera will see, and the precision each probing will give.

    Renders the object with a good speckle as each camera will see it, at rest and pressed by the
    tool of each probing, tracks these pictures, fits the constants to them, and reports the
    standard deviations.

    Parameters
    ----------
    session
        Folder of a session with a mesh, a rig, and probings with their forces; pictures need not
        be there yet.
    young_modulus
        A guess of Young's modulus, Pa or with its unit: 50kPa.
    poisson_ratio
        A guess of Poisson's ratio.
    noise
        Standard deviation of a camera pixel, in grey levels of 255.
    out
        Folder for the pictures. Default: the session's folder name followed by -plan, in the
        current folder.
    force
        Overwrite even if the target is not an unchanged result of this command; the old content is
        kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    target = out or default_folder(session, "plan")
    with result_folder(target, kind="lab plan", force=force) as folder:
        given = read_session(session, allow=check_memory)
        record_inputs(folder, session_files(session))
        print_notes(given.notes)
        variant = choose_variant()
        with progress_bar("smaller pictures, or fewer probings") as progress:
            planned = plan_measurement(
                given,
                young_modulus=young_modulus,
                poisson_ratio=poisson_ratio,
                variant=variant,
                pictures=Pictures(noise=noise),
                show=lambda name, picture: _save(folder / f"{name}.png", picture),
                progress=progress,
            )
        print_notes([variant.why])
    print_tables(_cameras(planned), _probings(planned, young_modulus, poisson_ratio))
    print_text(f"Pictures in {target}")
    return 0


def _table(next_probings: NextProbings) -> Table:
    """What is measured, and one row for each chosen place."""
    factor, unit = modulus_unit(next_probings.information.shear_modulus)

    def expected(precision: dict[str, float]) -> tuple[str, ...]:
        if PREDICTION not in precision:
            return _deviations(precision, factor)
        return (*_deviations(precision, factor), f"{100.0 * precision[PREDICTION]:.2g}")

    rows = [("now", "", "", *expected(next_probings.now))]
    for number, (k, after) in enumerate(
        zip(next_probings.chosen, next_probings.after, strict=True), start=1
    ):
        position = ", ".join(f"{1e3 * x:.1f}" for x in next_probings.point[k])
        # What is rounded to zero has no sign.
        parts = np.round(next_probings.force * next_probings.inward[k], 12) + 0.0
        force = ", ".join(f"{x:.2g}" for x in parts)
        rows.append((f"+ {number}", position, force, *expected(after)))
    columns = ["pushes", "place mm", "force N", "sd nu", f"sd G {unit}", f"sd E {unit}"]
    caption = (
        f"best of {len(next_probings.point)} places; sd: standard deviations to expect with all"
        " pushes up to this row"
    )
    if PREDICTION in next_probings.now:
        columns.append("sd |u| %")
        caption += "; |u|: displacements under a push at any of the places, from its force"
    title = f"Where to push next, with a radius of {1e3 * next_probings.radius:.3g} mm"
    return terminal_table(title, columns, rows, caption=caption)


def _save(file: Path, picture: np.ndarray) -> None:
    if not cv2.imwrite(str(file), picture):
        raise InputError(f"{file}: the picture cannot be written; choose another place with --out")


def _cameras(plan: MeasurementPlan) -> Table:
    rows = [(name, f"{100 * share:.0f}") for name, share in plan.visible.items()]
    return terminal_table("What each camera sees", ("camera", "of the free surface %"), rows)


def _probings(plan: MeasurementPlan, young: float, poisson: float) -> Table:
    """One row for each probing, and one for all together."""
    factor, unit = modulus_unit(young)
    rows = [
        (
            probing.name, str(probing.seen), f"{1e3 * probing.displacement:.3g}",
            f"{1e3 * probing.sigma:.2g}", *_deviations(probing.precision, factor),
        )
        for probing in plan.probings
    ]  # fmt: skip
    rows.append(("all", "", "", "", *_deviations(plan.precision, factor)))
    return terminal_table(
        f"Standard deviations to expect, at E = {young / factor:.4g} {unit}, nu = {poisson:g}",
        ("probing", "seen", "|u| mm", "sigma mm", "nu", f"G {unit}", f"E {unit}"),
        rows,
        caption=" ".join([_CAPTION, *budget_sentences(plan.budget)]),
        total=True,
    )


def _deviations(precision: dict[str, float], factor: float) -> tuple[str, str, str]:
    """Standard deviations of nu, G and E as text, moduli in a unit of `factor`; a dash
    where one is not determined."""
    return (
        number_text(precision["poisson_ratio"], ".2g"),
        number_text(precision["shear_modulus"] / factor, ".2g"),
        number_text(precision["young_modulus"] / factor, ".2g"),
    )
