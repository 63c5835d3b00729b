"""`palpate lab plan`: what cameras will see and which precision to expect of a session."""

from pathlib import Path

import cv2
import numpy as np
from rich.table import Table

from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.progress import progress_bar
from palpate.app.terminal.tables import budget_sentences, terminal_table
from palpate.app.units import Modulus
from palpate.bem import check_memory
from palpate.errors import InputError
from palpate.lab import Pictures, choose_variant
from palpate.pipeline import MeasurementPlan, plan_measurement
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
        with progress_bar() as progress:
            found = plan_measurement(
                given,
                young_modulus=young_modulus,
                poisson_ratio=poisson_ratio,
                variant=variant,
                pictures=Pictures(noise=noise),
                show=lambda name, picture: _save(folder / f"{name}.png", picture),
                progress=progress,
            )
        print_notes([variant.why])
    print_tables(_cameras(found), _probings(found, young_modulus, poisson_ratio))
    print_text(f"Pictures in {target}")
    return 0


def _save(file: Path, picture: np.ndarray) -> None:
    if not cv2.imwrite(str(file), picture):
        raise InputError(f"{file}: the picture cannot be written; choose another place with --out")


def _cameras(found: MeasurementPlan) -> Table:
    rows = [(name, f"{100 * share:.0f}") for name, share in found.visible.items()]
    return terminal_table("What each camera sees", ("camera", "of the free surface %"), rows)


def _probings(found: MeasurementPlan, young: float, poisson: float) -> Table:
    """One row a probing, and one of all together."""
    factor, unit = modulus_unit(young)
    rows = [
        (
            probing.name, str(probing.seen), f"{1e3 * probing.displacement:.3g}",
            f"{1e3 * probing.sigma:.2g}", *_deviations(probing.precision, factor),
        )
        for probing in found.probings
    ]  # fmt: skip
    rows.append(("all", "", "", "", *_deviations(found.precision, factor)))
    return terminal_table(
        f"Standard deviations to expect, at E = {young / factor:.4g} {unit}, nu = {poisson:g}",
        ("probing", "seen", "|u| mm", "sigma mm", "nu", f"G {unit}", f"E {unit}"),
        rows,
        caption=" ".join([_CAPTION, *budget_sentences(found.budget)]),
        total=True,
    )


def _deviations(precision: dict[str, float], factor: float) -> tuple[str, str, str]:
    nu, shear, young = (
        f"{value:.2g}" if np.isfinite(value) else "-"
        for value in (
            precision["poisson_ratio"],
            precision["shear_modulus"] / factor,
            precision["young_modulus"] / factor,
        )
    )
    return nu, shear, young
