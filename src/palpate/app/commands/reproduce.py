"""`palpate reproduce`: the paper's experiments on the virtual bench, from pictures to tables."""

from pathlib import Path

from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.progress import progress_bar
from palpate.app.terminal.tables import terminal_table
from palpate.app.workers import distribution
from palpate.campaign import check_workers
from palpate.errors import InputError
from palpate.lab import choose_variant
from palpate.paper import (
    EXPERIMENTS,
    Workplace,
    check_page,
    run_experiments,
    shown_rows,
    write_page,
    write_result,
)
from palpate.records import parts_folder, result_folder

ALL = "all"
# Sessions stay in the result, so that a figure can be followed to its pictures.
_SESSIONS = "sessions"


def reproduce(
    experiment: str,
    /,
    *,
    out: Path | None = None,
    quick: bool = False,
    page: Path | None = None,
    force: bool = False,
    scheduler: str | None = None,
    workers: int | None = None,
    insecure: bool = False,
) -> int:
    """Repeat an experiment of the paper on the virtual bench, beside the published numbers.

    Parameters
    ----------
    experiment
        table1, table2, table3, budget, figure2, figure3, figure4, or all of them.
    out
        Result folder; it appears whole or not at all. Default: paper-EXPERIMENT in the current
        folder.
    quick
        Small pictures and few steps: a preview, not a measurement.
    page
        Also write this Markdown page of all results, its pictures beside it.
    force
        Overwrite even if the target is not an unchanged result of this command; the old content is
        kept as NAME.old.
    scheduler
        Address of a Dask scheduler whose workers compute the probings of the virtual bench, such as
        tls://192.168.1.7:8786. Default: a cluster on this machine's cores, if Dask is installed.
    workers
        Processes of that cluster, as in `palpate campaign`.
    insecure
        Accept a scheduler without TLS, tcp://HOST:PORT: anybody who reaches it can run code as you.

    Returns
    -------
    int
        0.
    """
    names = _chosen_experiments(experiment, page)
    check_workers(scheduler, workers, insecure=insecure)
    target = out or Path(f"paper-{experiment}")
    # A folder each, unless an experiment is alone.
    subfolder = {name: name if len(names) > 1 else "" for name in names}
    with result_folder(target, kind="reproduce", force=force) as folder:
        variant = choose_variant()
        print_notes([variant.why])
        with (
            progress_bar() as progress,
            distribution(scheduler, workers, insecure=insecure, by_default=True) as distribute,
        ):
            parts = parts_folder(folder)
            work = Workplace(folder / _SESSIONS, variant, quick, progress, parts, distribute)
            results = run_experiments(names, work)
        for name, result in results.items():
            (folder / subfolder[name]).mkdir(exist_ok=True)
            write_result(folder / subfolder[name], result)
    for result in results.values():
        summary = result.summary
        print_tables(terminal_table(summary.title, summary.columns, shown_rows(summary)))
    if page is not None:
        command = f"palpate reproduce {ALL}{' --quick' if quick else ''} --page {page.as_posix()}"
        folders = {name: target / subfolder[name] for name in names}
        write_page(page, results, folders, command=command)
    done = f"Result in {target}" + ("" if page is None else f"; page {page}")
    print_text(done, wrapped=False)
    return 0


def _chosen_experiments(experiment: str, page: Path | None) -> list[str]:
    """What is to be done; bad input is refused before anything is measured."""
    if experiment != ALL and experiment not in EXPERIMENTS:
        raise InputError(
            f"there is no experiment '{experiment}'; there are: {', '.join(EXPERIMENTS)}, {ALL}"
        )
    if page is not None and experiment != ALL:
        raise InputError(
            f"--page with '{experiment}' alone: the page shows all experiments; give '{ALL}', or"
            " leave --page out"
        )
    if page is not None:
        check_page(page)
    return list(EXPERIMENTS) if experiment == ALL else [experiment]
