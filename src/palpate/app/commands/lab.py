"""`palpate lab`: a virtual measurement in, a session with its truth out."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated, get_args, get_type_hints

from cyclopts import Parameter
from rich.table import Table

from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_tables, print_text
from palpate.app.terminal.progress import progress_bar
from palpate.app.terminal.tables import terminal_table
from palpate.app.workers import distribution
from palpate.campaign import check_workers
from palpate.errors import InputError
from palpate.lab import (
    SHAPES,
    Arm,
    Head,
    LabConfig,
    Look,
    Material,
    built_in,
    choose_variant,
    make_session,
    read_lab_config,
)
from palpate.records import TomlTable, parts_folder, record_inputs, result_folder, session_files


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
        print_notes([variant.why])
        with (
            progress_bar() as progress,
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
    print_text(_closing_text(plan, out), wrapped=False)
    return 0


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
    """What there is to choose from."""
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
