"""`palpate lab` and `palpate reproduce`: virtual measurements, and the paper's experiments."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated, get_args, get_type_hints

import numpy as np
from cyclopts import Parameter
from rich.table import Table

from palpate.app.tables import terminal_table
from palpate.app.terminal import print_notes, print_tables, print_text, progress_bar
from palpate.calibration import Charuco
from palpate.campaign import check_workers, started_engine
from palpate.errors import InputError
from palpate.lab import (
    SHAPES,
    Arm,
    Head,
    LabConfig,
    Look,
    Material,
    Print,
    built_in,
    choose_variant,
    make_session,
    make_tutorial,
    read_lab_config,
)
from palpate.paper import (
    EXPERIMENTS,
    ExperimentRun,
    check_page,
    run_experiments,
    shown_rows,
    write_page,
    write_result,
)
from palpate.records import TomlTable, parts_folder, record_inputs, result_folder, session_files
from palpate.threads import Distribute

# Board of the pictures, as given to `palpate calibrate`; dots a square of its print.
_BOARD = Charuco(7, 5, 16e-3, 12e-3)
_DOTS_PER_SQUARE = 80
ALL = "all"
# Sessions stay in the result, so that a figure can be followed to its pictures.
_SESSIONS = "sessions"
_SHORTER = "more --workers, smaller pictures, fewer probings or steps, a larger `element`"
_NEEDED = ("distributed", "cryptography")


def lab(
    config: str | None = None,
    out: Path | None = None,
    /,
    *,
    seed: int | None = None,
    list_: Annotated[bool, Parameter(name="--list")] = False,
    force: bool = False,
    scheduler: str | None = None,
    workers: int | None = None,
    insecure: bool = False,
) -> int:
    """Measure a virtual specimen: pictures, forces and the true constants, as a session folder.

    Parameters
    ----------
    config
        A configuration (TOML, format palpate-lab/1), or the name of a built-in one.
    out
        Folder of the session; it appears whole or not at all.
    seed
        Use this seed instead of the configuration's: different noise, texture and misalignments.
    list_
        List the settings and the built-in configurations, and stop.
    force
        Overwrite even if the target is not an unchanged result of this command; the old content is
        kept as NAME.old.
    scheduler
        Address of a Dask scheduler whose workers compute the probings, such as
        tls://192.168.1.7:8786. Default: one after the other in this process.
    workers
        Number of processes on this machine that compute the probings, one thread each.
    insecure
        Accept a scheduler without TLS, tcp://HOST:PORT: anybody who reaches it can run code as you.

    Returns
    -------
    int
        0.
    """
    if list_:
        print_tables(*_choice_tables())
        return 0
    if config is None or out is None:
        raise InputError(
            "give a configuration and a folder: palpate lab CONFIG.toml OUT; --list shows the"
            f" built-in ones: {', '.join(built_in())}"
        )
    check_workers(scheduler, workers, insecure=insecure)
    file = _config_file(config)
    plan = read_lab_config(file)
    plan = plan if seed is None else replace(plan, seed=seed)
    # What is found out while it is made is the configuration's, too.
    errors_named = TomlTable(file, "", {}).error_context()
    with result_folder(out, kind="lab", force=force) as folder:
        record_inputs(folder, session_files(file))
        variant = choose_variant()
        with (
            progress_bar(_SHORTER, resumes=True) as progress,
            distribution(scheduler, workers, insecure=insecure) as distribute,
            errors_named,
        ):
            make_session(
                plan,
                folder,
                variant=variant,
                progress=progress,
                parts=parts_folder(folder),
                distribute=distribute,
            )
    print_notes([variant.why])
    print_text(_closing_text(plan, out), wrapped=False)
    return 0


def tutorial(
    out: Path,
    /,
    *,
    force: bool = False,
) -> int:
    """Record boards, a turntable and presses of a virtual half ball, for the tutorial.

    Parameters
    ----------
    out
        Folder; it appears whole or not at all. Its subfolder `truth` holds the true values.
    force
        Overwrite even if the target is not an unchanged result of this command; the old content is
        kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    with result_folder(out, kind="lab", force=force) as folder:
        variant = choose_variant()
        with progress_bar() as progress:
            make_tutorial(folder, printed_board(), variant=variant, progress=progress)
    print_notes([variant.why])
    print_text(
        f"Pictures of boards, of a turntable and films of presses in {out}; next, in that folder:\n"
        "  palpate calibrate boards --columns 7 --rows 5 --square 16mm --marker 12mm --table 00"
        " --out rig",
        wrapped=False,
    )
    return 0


def printed_board() -> Print:
    """The board of the tutorial as it is printed.

    Returns
    -------
    Print
    """
    extent = _BOARD.columns * _BOARD.square, _BOARD.rows * _BOARD.square
    return np.ascontiguousarray(_BOARD.drawing(_DOTS_PER_SQUARE)), extent


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
        with (
            progress_bar("--quick, or more --workers", resumes=True) as progress,
            distribution(scheduler, workers, insecure=insecure, by_default=True) as distribute,
        ):
            parts = parts_folder(folder)
            work = ExperimentRun(folder / _SESSIONS, variant, quick, progress, parts, distribute)
            results = run_experiments(names, work)
        for name, result in results.items():
            (folder / subfolder[name]).mkdir(exist_ok=True)
            write_result(folder / subfolder[name], result)
    print_notes([variant.why])
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


@contextmanager
def distribution(
    scheduler: str | None, workers: int | None, *, insecure: bool = False, by_default: bool = False
) -> Iterator[Distribute]:
    """`map` on workers for the duration of the block, or in this process.

    Parameters
    ----------
    scheduler, workers, insecure    as in `started_engine`
    by_default : bool               start a cluster of this machine's cores where neither is given
                                    and Dask and what makes certificates are installed

    Yields
    ------
    callable                        as `map`

    Raises
    ------
    InputError                      as in `started_engine`
    """
    asked = scheduler is not None or workers is not None
    if not asked and not (by_default and all(map(find_spec, _NEEDED))):
        yield map
        return
    with started_engine(scheduler, workers, insecure=insecure) as engine:
        yield engine.map


def _config_file(config: str) -> Path:
    """The file that a name means."""
    path, known = Path(config), built_in()
    # A folder that happens to have the name of a built-in one is not meant.
    if config in known and not path.is_file():
        return known[config]
    if path.exists():
        return path
    raise InputError(
        f"{config}: no such file, and no built-in configuration; there are: {', '.join(known)}"
    )


def _closing_text(config: LabConfig, out: Path) -> str:
    what = (
        f"{len(config.probes)} probings"
        if config.stage is None
        else f"{config.stage.steps} steps of a rigid motion"
    )
    then = "fit" if config.stage is None else "flow"
    return f"{config.name}: {what} in {out}; next: palpate {then} {out}"


def _choice_tables() -> list[Table]:
    """Tables of the experiments and benches to choose from."""
    ready = [
        (name, file.read_text(encoding="utf-8").splitlines()[0].lstrip("# "))
        for name, file in built_in().items()
    ]
    shapes = [
        (name, ", ".join((*shape.lengths, "edge")), shape.summary) for name, shape in SHAPES.items()
    ]
    shapes.append(("-", "mesh, element", 'any closed surface: mesh = "file.ply", and [support]'))
    words = [
        (f"[{table}] {key}", ", ".join(get_args(get_type_hints(kind)[key])))
        for kind, table, key in (
            (Material, "material", "law"), (Look, "look", "texture"), (Arm, "arm", "tip"),
            (Head, "head", "layout"),
        )
    ]  # fmt: skip
    return [
        terminal_table("Built-in configurations", ("name", "what"), ready),
        terminal_table("Specimens: shape, in [specimen]", ("shape", "lengths (m)", "what"), shapes),
        terminal_table("Choices", ("key", "one of"), words),
    ]


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
