"""`palpate reproduce`: the paper's experiments on the virtual bench, from pictures to tables."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from rich.console import Console

from palpate.app.terminal import print_notes, progress_bar
from palpate.errors import InputError
from palpate.lab import Variant, built_in, choose_variant, read_lab_config
from palpate.paper import (
    EXPERIMENTS,
    Experiment,
    PaperResult,
    PaperSession,
    Workplace,
    check_page,
    measured_session,
    quickened,
    terminal_table,
    write_page,
    write_result,
)
from palpate.progress import Progress, part_of
from palpate.records import disk_errors, result_folder

ALL = "all"
# Sessions stay in the result, so that a figure can be followed to its pictures.
_SESSIONS = "sessions"


def reproduce(
    experiment: str,
    /,
    *,
    out: Path | None = None,
    quick: Annotated[bool, Parameter(negative="")] = False,
    page: Path | None = None,
) -> int:
    """Repeat an experiment of the paper on the virtual bench, its own numbers beside.

    Parameters
    ----------
    experiment
        table1, table2, table3, budget, figure2, figure3, figure4, or all of them.
    out
        Result folder; it appears whole or not at all. Default: paper-EXPERIMENT in the current
        folder.
    quick
        Small pictures and few steps: a look, not a measurement.
    page
        Also write this Markdown page of all results, its pictures beside it.

    Returns
    -------
    int
        0.
    """
    chosen = _chosen(experiment, page)
    console = Console()
    target = out or Path(f"paper-{experiment}")
    with result_folder(target) as folder, disk_errors(folder):
        results = _results(folder / _SESSIONS, chosen, quick=quick)
        for name, result in results.items():
            place = _place(folder, name, chosen)
            place.mkdir(exist_ok=True)
            write_result(place, result)
    for result in results.values():
        console.print(terminal_table(result.summary))
    if page is not None:
        _write_page(page, results, target, chosen, quick=quick)
    done = f"Result in {target}" + ("" if page is None else f"; page {page}")
    console.print(done, markup=False, highlight=False, soft_wrap=True)
    return 0


def _chosen(experiment: str, page: Path | None) -> dict[str, Experiment]:
    """What is to be done, refused before anything is measured."""
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
    return dict(EXPERIMENTS) if experiment == ALL else {experiment: EXPERIMENTS[experiment]}


def _sessions(chosen: dict[str, Experiment]) -> list[str]:
    """Every session that is needed, once."""
    return list(dict.fromkeys(name for one in chosen.values() for name in one.sessions))


def _results(folder: Path, chosen: dict[str, Experiment], *, quick: bool) -> dict[str, PaperResult]:
    """Make and measure sessions, each once, and what the experiments make of them."""
    variant = choose_variant()
    print_notes([variant.why])
    names = _sessions(chosen)
    count = len(names) + len(chosen)
    results = {}
    with progress_bar() as progress:
        measured = {
            name: _measured(
                folder / name,
                name,
                variant,
                part_of(progress, k / count, (k + 1) / count, prefix=f"{name}: "),
                quick=quick,
            )
            for k, name in enumerate(names)
        }
        folder.mkdir(exist_ok=True)
        for k, (name, one) in enumerate(chosen.items(), start=len(names)):
            say = part_of(progress, k / count, (k + 1) / count, prefix=f"{name}: ")
            say("evaluation", 0.0)
            results[name] = one.result(measured, Workplace(folder, variant, quick, say))
    return results


def _measured(
    folder: Path, name: str, variant: Variant, progress: Progress, *, quick: bool
) -> PaperSession:
    """A built-in configuration's session, measured."""
    config = read_lab_config(built_in()[name])
    folder.mkdir(parents=True)
    return measured_session(
        quickened(config) if quick else config, folder, variant=variant, progress=progress
    )


def _place(folder: Path, name: str, chosen: dict[str, Experiment]) -> Path:
    """Where an experiment's files are: a folder each, unless it is alone."""
    return folder / name if len(chosen) > 1 else folder


def _write_page(
    page: Path,
    results: dict[str, PaperResult],
    target: Path,
    chosen: dict[str, Experiment],
    *,
    quick: bool,
) -> None:
    command = f"palpate reproduce {ALL}{' --quick' if quick else ''} --page {page.as_posix()}"
    write_page(
        page, results, {name: _place(target, name, chosen) for name in results}, command=command
    )
