"""`palpate lab tutorial`: everything a bench records before it knows anything."""

from pathlib import Path

import numpy as np

from palpate.app.terminal.notes import print_notes
from palpate.app.terminal.output import print_text
from palpate.app.terminal.progress import progress_bar
from palpate.calibration import Charuco
from palpate.lab import Print, choose_variant, make_tutorial
from palpate.records import result_folder

# Board of the pictures, as given to `palpate calibrate`; dots a square of its print.
_BOARD = Charuco(7, 5, 16e-3, 12e-3)
_DOTS_PER_SQUARE = 80


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
        print_notes([variant.why])
        with progress_bar() as progress:
            make_tutorial(folder, printed_board(), variant=variant, progress=progress)
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
    return Print(np.ascontiguousarray(_BOARD.drawing(_DOTS_PER_SQUARE)), extent)
