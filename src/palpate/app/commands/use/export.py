"""`palpate export`: an estimated object in the files of a simulator."""

from pathlib import Path
from typing import Literal

from palpate.app.environment import check_cache
from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_text
from palpate.app.terminal.progress import progress_bar
from palpate.app.units import Length
from palpate.records import default_folder, record_inputs, result_folder
from palpate.simulation import FORMATS, export_fit, read_fit

Simulator = Literal[
    "mujoco", "calculix", "febio", "sofa", "vtu", "openusd", "obj", "genesis", "isaaclab", "npz"
]


def export(
    result: Path,
    /,
    *,
    to: Simulator,
    out: Path | None = None,
    probe: str | None = None,
    edge: Length | None = None,
    session: Path | None = None,
    cache: Path | None = None,
    force: bool = False,
) -> int:
    """Write an estimated object for a simulator: its shape, support and constants, and one push.

    Writes a folder with the simulator's files, and a README.txt and palpate.json that give the
    constants with their intervals and what was changed for the simulator.

    Parameters
    ----------
    result
        Result folder of `palpate fit`.
    to
        The simulator.
    out
        Folder; it appears whole or not at all. Default: the result folder's name followed by the
        simulator's, in the current folder.
    probe
        Probing to include, for replay in the simulator. Default: the first one left out of the
        estimate, else the first.
    edge
        Edge of the tetrahedra away from the contact, m, or with its unit: 3mm. Default: a ninth of
        the cube root of the volume.
    session
        Present location of the result's session, if it was moved.
    cache
        Folder in which to keep intermediate results for this object, for faster later runs.
    force
        Overwrite even if the target is not an unchanged export to this simulator; the old content
        is kept as NAME.old.

    Returns
    -------
    int
        0.
    """
    check_cache(cache)
    target = out or default_folder(result, to)
    with result_folder(target, kind=f"export --to {to}", force=force) as folder:
        source = read_fit(result, session)
        record_inputs(folder, source.files)
        with progress_bar() as progress:
            body = export_fit(
                folder, source, to, probe=probe, edge=edge, cache=cache, progress=progress
            )
    print_notes(body.notes)
    if body.push is not None:
        how = "left out of the estimate" if body.push.held_out else "used in the estimate"
        print_text(f"Push written along: probing {body.push.name}, {how}")
    print_text(f"{FORMATS[to].title} files in {target}; README.txt there says how to run them")
    return 0
