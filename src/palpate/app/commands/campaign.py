"""`palpate campaign`: many sessions on many workers; how far it is, its table, its picture."""

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from palpate.app.process import NOT_OK
from palpate.app.tables import number_text, terminal_table
from palpate.app.terminal import print_notes, print_tables, print_text, progress_bar
from palpate.campaign import (
    DONE,
    FAILED,
    WAITING,
    FitOptions,
    Row,
    Store,
    campaign_figure,
    check_workers,
    groups_of,
    outliers,
    read_items,
    run_campaign,
    write_table,
)
from palpate.disk import atomic_replacement
from palpate.errors import InputError
from palpate.figures import save_figure
from palpate.pipeline import PoseChoice
from palpate.records import check_free, disk_errors, modulus_unit

# What several commands say of an argument that they share.
_Campaign = Annotated[Path, Parameter(help="Folder of the campaign.")]
_Force = Annotated[bool, Parameter(help="Replace a file of that name.")]
_LABELS = {"young_modulus": "Young's modulus", "poisson_ratio": "Poisson's ratio"}
# A message in a table is for knowing what it is about; the files have all of it.
_MAX_MESSAGE = 160


def run(
    sessions: Path,
    /,
    *,
    out: Path | None = None,
    scheduler: str | None = None,
    workers: int | None = None,
    insecure: bool = False,
    poisson_range: tuple[float, float] = (0.0, 0.4999),
    surface: Literal["smooth", "flat"] = "smooth",
    strain: Literal["small", "finite"] = "small",
    pose: PoseChoice = "auto",
) -> int:
    """Fit every session in a list or below a folder, several at a time, into one table.

    If anything stops it, even a kill, start it again: it resumes where it was. A session that
    cannot be fitted becomes a row with its error message.

    Parameters
    ----------
    sessions
        Text file with one session path per line, relative to the file's folder, optionally followed
        by a comma and a group; or a folder with sessions at any depth.
    out
        Folder of the campaign, created or resumed. Default: the list's or folder's name followed by
        -campaign, in the current folder.
    scheduler
        Address of a running Dask scheduler, such as tls://192.168.1.7:8786. Default: a cluster on
        this machine's cores, for as long as the command runs.
    workers
        Processes of that cluster, one thread each. Default: one per core, or fewer if each would
        have less than 2 GiB of memory.
    insecure
        Accept a scheduler without TLS, tcp://HOST:PORT: anybody who reaches it can run code as you.
    poisson_range
        As in `palpate fit`.
    surface
        As in `palpate fit`.
    strain
        As in `palpate fit`.
    pose
        As in `palpate fit`.

    Returns
    -------
    int
        0, or 3 where a session has no result.
    """
    check_workers(scheduler, workers, insecure=insecure)
    items = read_items(sessions)
    folder = out or Path(f"{sessions.resolve().stem}-campaign")
    options = FitOptions(poisson_range, surface, strain, pose)
    with progress_bar("more --workers, or a --scheduler", resumes=True) as progress:
        rows = run_campaign(
            items, folder, options=options, scheduler=scheduler, workers=workers,
            insecure=insecure, progress=progress,
        )  # fmt: skip
    _print_summary(rows)
    print_text(
        f"Table in {folder / 'table.csv'}; all of it: palpate campaign table {folder}; a picture:"
        f" palpate campaign plot {folder}",
        wrapped=False,
    )
    return NOT_OK if any(row.state == FAILED for row in rows) else 0


def status(folder: _Campaign, /) -> int:
    """Show a campaign's progress, also while it runs: what is done, what failed, what stands out.

    Returns
    -------
    int
        0.
    """
    _print_summary(Store(folder).rows())
    return 0


def table(
    folder: _Campaign,
    /,
    *,
    out: Path | None = None,
    force: _Force = False,
) -> int:
    """Print a campaign's table, or write it as CSV or Parquet.

    Parameters
    ----------
    out
        Write to this file instead: .csv, or .parquet (needs palpate[parquet]).

    Returns
    -------
    int
        0.
    """
    rows = Store(folder).rows()
    if out is not None:
        check_free(out, force=force)
        write_table(out, rows)
        print_text(f"{len(rows)} rows in {out}", wrapped=False)
        return 0
    outlying = outliers(rows)
    factor, unit = _unit(rows)
    cells = [
        (
            row.session, row.group or "-", row.state if row.state != DONE else row.status or "-",
            _constant(row, "young_modulus", factor), _constant(row, "poisson_ratio", 1.0),
            " ".join(outlying.get(row.session, ())) or "-", number_text(row.seconds, ".1f"),
        )
        for row in rows
    ]  # fmt: skip
    columns = ("session", "group", "outcome", f"E {unit}", "nu", "outlier", "time s")
    caption = "E, nu: value and 95 % interval; outlier: the constants that lie far out of the group"
    print_tables(terminal_table("Campaign", columns, cells, caption=caption))
    return 0


def plot(
    folder: _Campaign,
    /,
    *,
    out: Path | None = None,
    force: _Force = False,
) -> int:
    """Plot the constants of all sessions with their intervals, side by side by group.

    Parameters
    ----------
    out
        File to write, ending .png, .svg or .pdf. Default: the folder's name followed by .png, in
        the current folder.

    Returns
    -------
    int
        0.
    """
    rows = Store(folder).rows()
    name = folder.resolve().name
    target = out or Path(f"{name}.png")
    if target.suffix not in (".png", ".svg", ".pdf"):
        raise InputError(f"{target}: ends in '{target.suffix}'; give a .png, .svg or .pdf file")
    check_free(target, force=force)
    if all(row.state != DONE for row in rows):
        raise InputError(f"{folder}: no session has a result yet; there is nothing to draw")
    figure = campaign_figure(rows, name)
    with atomic_replacement(target) as staged, disk_errors(target):
        save_figure(figure, staged, kind=target.suffix[1:])
    print_text(f"Picture in {target}", wrapped=False)
    return 0


def _print_summary(rows: Sequence[Row]) -> None:
    """A line for every group, then what failed and what stands out."""
    factor, unit = _unit(rows)
    groups = groups_of(rows)
    lines = [
        _summary_row(group, [row for row in rows if row.group == group], factor) for group in groups
    ]
    if len(groups) > 1:
        lines.append(_summary_row("all", rows, factor))
    columns = ("group", "sessions", "done", "failed", "waiting", f"E {unit}", "nu", "time s")
    caption = "E, nu: median over the sessions, and the middle half of them; time: median of one"
    print_tables(terminal_table("Campaign", columns, lines, caption=caption, total=len(groups) > 1))
    failed = [f"{row.session}: {_shortened(row.message)}" for row in rows if row.state == FAILED]
    print_notes(failed)
    for session, names in outliers(rows).items():
        print_text(f"Outlier: {session} ({' and '.join(_LABELS[name] for name in names)})")


def _summary_row(group: str, rows: Sequence[Row], factor: float) -> tuple[str, ...]:
    counts = [sum(row.state == state for row in rows) for state in (DONE, FAILED, WAITING)]
    young = [row.young_modulus / factor for row in rows if row.young_modulus is not None]
    ratio = [row.poisson_ratio for row in rows if row.poisson_ratio is not None]
    seconds = [row.seconds for row in rows if row.seconds is not None and row.state == DONE]
    return (
        group or "-", str(len(rows)), *map(str, counts), _median_text(young), _median_text(ratio),
        number_text(statistics.median(seconds) if seconds else None, ".1f"),
    )  # fmt: skip


def _median_text(values: list[float]) -> str:
    """Median and quartiles."""
    if len(values) < 2:
        return number_text(values[0] if values else None, ".4g")
    low, middle, high = statistics.quantiles(values, n=4, method="inclusive")
    return f"{middle:.4g} ({low:.4g} to {high:.4g})"


def _unit(rows: Sequence[Row]) -> tuple[float, str]:
    known = [row.young_modulus for row in rows if row.young_modulus is not None]
    return modulus_unit(statistics.median(known)) if known else (1.0, "Pa")


def _constant(row: Row, name: str, factor: float) -> str:
    value, low, high = (getattr(row, name + end) for end in ("", "_low", "_high"))
    if value is None:
        return "-"
    ends = [number_text(end / factor if end is not None else None, ".4g") for end in (low, high)]
    return f"{value / factor:.4g} ({ends[0]} to {ends[1]})"


def _shortened(text: str) -> str:
    return text if len(text) <= _MAX_MESSAGE else f"{text[:_MAX_MESSAGE]} ..."
