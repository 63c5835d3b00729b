"""The list of programs whose files are read, and the choice of the reader for a given file.

Each program has its own conventions, described in its file. A `Rig` always uses the same: metres,
x_camera = R x_object + t, the centre of the first pixel is (0, 0).
"""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from palpate.errors import RecordError
from palpate.files import read_errors
from palpate.records.measured_points import MeasuredPoints, in_metres
from palpate.records.program import CalibrationFile, Program, ProgramPoints
from palpate.records.programs.dice import DICE
from palpate.records.programs.kalibr import KALIBR
from palpate.records.programs.matchid import MATCHID
from palpate.records.programs.matlab import MATLAB
from palpate.records.programs.multidic import MULTIDIC
from palpate.records.programs.opencorr import OPENCORR
from palpate.records.programs.opencv import OPENCV
from palpate.records.programs.pyvale import PYVALE
from palpate.records.programs.toml_cameras import TOML_CAMERAS
from palpate.records.programs.vic3d import VIC3D
from palpate.records.programs.vtu import VTU
from palpate.records.rig import PictureTracks, Rig

# To add a program: a file next to these, and one line here.
PROGRAMS: tuple[Program, ...] = (
    DICE,
    VIC3D,
    MATCHID,
    PYVALE,
    OPENCORR,
    MATLAB,
    MULTIDIC,
    VTU,
    KALIBR,
    TOML_CAMERAS,
    OPENCV,
)


def import_kinds() -> dict[str, Program]:
    """Programs whose displacements can be imported, by their names in `palpate import`."""
    return {kind: program for program in PROGRAMS for kind in program.kinds}


def kinds_text() -> str:
    """Those names as text, with the suffixes of their files."""
    return ", ".join(f"{' or '.join(p.kinds)} ({p.results})" for p in PROGRAMS if p.kinds)


def read_measured(
    kind: str,
    path: Path | str,
    *,
    length_unit: str | None = None,
    frame: int | None = None,
    min_score: float | None = None,
    triangulate: Callable[[PictureTracks], ProgramPoints] | None = None,
) -> MeasuredPoints:
    """Points and displacements of one result file, in metres, in the program's own frame.

    Parameters
    ----------
    kind : str                      a name of `import_kinds`
    path : path
    length_unit : str or None       um, mm, cm, m or in, if the file states none
    frame : int or None             state, from 0, in files with several; None: the last one
    min_score : float or None       lowest correlation of a match that is accepted, -1 to 1; None:
                                    the program's own `min_score`
    triangulate : callable or None  triangulates matches in pixels; None: the file has 3-D points

    Returns
    -------
    MeasuredPoints

    Raises
    ------
    RecordError                     unknown kind, or one without matches in pixels; a file that is
                                    missing, damaged, 2-D or without measured points; a `min_score`
                                    out of range, or for a file without correlations
    InputError                      an optional package that reads the file is missing
    """
    program = import_kinds().get(kind)
    if program is None or program.read_points is None:
        raise RecordError(f"kind is '{kind}'; must be one of {', '.join(import_kinds())}")
    if min_score is not None and not -1.0 <= min_score <= 1.0:
        raise RecordError(f"--min-score is {min_score:g}; must be a correlation, -1 to 1")
    if triangulate is not None and program.read_tracks is None:
        raise RecordError(f"{path}: files of {kind} hold places, no pixels; leave --rig out")
    # Infinities from a damaged file are refused below; no warnings about them.
    cure = f"export it again from {kind}"
    with read_errors(Path(path), cure, what="cannot be read"), np.errstate(all="ignore"):
        if triangulate is not None and program.read_tracks is not None:
            given = triangulate(program.read_tracks(Path(path), frame))
        else:
            given = program.read_points(Path(path), frame)
    if min_score is not None and given.score is None:
        raise RecordError(
            f"{path}: has no correlation of its points; leave --min-score out, or export them"
            " with it"
        )
    return in_metres(
        given,
        Path(path),
        length_unit=length_unit,
        default_unit=program.default_unit,
        min_score=program.min_score if min_score is None else min_score,
    )


def read_calibration(path: Path, *, length_unit: str | None) -> Rig:
    """Rig from the calibration of another program, which is recognised by its content.

    Parameters
    ----------
    path : Path                     a file; or a folder with a file per camera (MultiDIC, OpenCV)
    length_unit : str or None       m, cm, mm or in, for files that state none; None: the program's
                                    usual unit

    Returns
    -------
    Rig                             the first camera is the reference

    Raises
    ------
    RecordError                     missing, not readable, not of a known program
    CalibrationError                missing or contradictory content
    """
    file = CalibrationFile.read(path, length_unit)
    with read_errors(path, "export the calibration again", what="cannot be read as a calibration"):
        for program in PROGRAMS:
            if program.holds_rig and program.read_rig and program.holds_rig(file):
                return program.read_rig(file)
    known = ", ".join(program.calibrations for program in PROGRAMS if program.calibrations)
    raise RecordError(
        f"{path}: is no camera calibration{_contents_text(file)}; known are rig.toml, {known}"
    )


def _contents_text(file: CalibrationFile) -> str:
    """The names of what a file holds instead, if there are any."""
    if file.path.is_dir():
        return ", and it holds none"
    if file.content is None or isinstance(file.content, str):
        return ""
    names = file.content if isinstance(file.content, dict) else (e.tag for e in file.content)
    return f" (it holds: {', '.join([str(name) for name in names][:8])})"
