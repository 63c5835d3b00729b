"""`palpate fit`: a session in, a table and a result folder out."""

import sys
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from rich.console import Console

from palpate.app.terminal import (
    constants_table,
    print_notes,
    print_text,
    probes_table,
    progress_bar,
)
from palpate.bem import SurfaceSettings, check_memory
from palpate.estimation import FitSettings
from palpate.figures import write_plots
from palpate.pipeline import (
    fit_session,
    with_pictures_measured,
    write_residuals,
)
from palpate.records import (
    Status,
    default_folder,
    parts_folder,
    read_session,
    record_inputs,
    require_probings,
    result_folder,
    session_files,
    write_estimate,
)

_NOT_OK = 3


def fit(
    session: Path,
    /,
    *,
    out: Path | None = None,
    probe: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    method: Literal["reduced", "nelder-mead"] = "reduced",
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    surface: Literal["smooth", "flat"] = "smooth",
    strain: Literal["small", "finite"] = "small",
    cache: Path | None = None,
    force: Annotated[bool, Parameter(negative="")] = False,
) -> int:
    """Estimate shear modulus, Poisson's ratio and Young's modulus from a session.

    Prints the constants with their intervals and leaves a folder with estimate.json and plots.

    Parameters
    ----------
    session
        Folder of the session, or a session file in it.
    out
        Result folder; it appears whole or not at all. Default: the session's folder name followed
        by -result, in the current folder.
    probe
        Use these probings only.
    method
        How the constants are searched: over the reduced model, or by Nelder-Mead on the full one.
    poisson_range
        Poisson's ratios that are possible; -0.99 0.4999 for auxetic foams.
    surface
        What the mesh means: points of a smooth object (with edges where triangles turn by more than
        40 degrees), or flat facets.
    strain
        Small: displacements are linear in the force. Finite: what that leaves out of an object that
        was pressed far is computed with finite elements, and corrected.
    cache
        Folder that keeps the surface integrals of this object for the next fit.
    force
        Write although something else than an unchanged result of this command is there; that is
        kept beside it as NAME.old.

    Returns
    -------
    int
        0, or 3 where the data do not determine a constant.
    """
    console = Console()
    settings = FitSettings(method=method, poisson_range=poisson_range)
    # The target is tried first: no one should wait for a result that cannot be kept.
    target = out or default_folder(session, "result")
    with result_folder(target, kind="fit", force=force) as folder:
        given = read_session(session, probes=probe, allow=check_memory)
        record_inputs(folder, session_files(session))
        require_probings(given)
        print_notes(given.notes)
        with progress_bar() as progress:
            measured = with_pictures_measured(given, progress=progress, parts=parts_folder(folder))
            print_notes(measured.notes[len(given.notes) :])
            result = fit_session(
                measured,
                settings=settings,
                surface=SurfaceSettings(smooth=surface == "smooth"),
                cache=cache,
                finite_strain=strain == "finite",
                progress=progress,
            )
            progress("tables and plots", 1.0)
            write_estimate(folder / "estimate.json", result.estimate)
            write_residuals(folder, measured, result)
            write_plots(folder, measured, result)
    estimate = result.estimate
    if len(estimate.probes) > 0:
        console.print(probes_table(estimate))
    console.print(constants_table(estimate))
    for note in estimate.notes:
        if note not in measured.notes:
            print_text(f"Note: {note}")
    print_text(f"Result in {target} ({estimate.seconds.get('total', float('nan')):.1f} s)")
    if estimate.status is not Status.OK:
        print(f"palpate: {estimate.status.value}: {estimate.status.advice}", file=sys.stderr)
        return _NOT_OK
    return 0
