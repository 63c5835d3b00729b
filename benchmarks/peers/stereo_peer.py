"""Stereo image correlation of another program on a pair of cameras."""

import tempfile
from pathlib import Path

import numpy as np

from benchmarks.peers.environment import Environment, last_line, run_command

HERE = Path(__file__).resolve().parent / "stereo"
PROGRAM = "al-dic-3d"
# Pixel, point and displacement at rest, by instant; NaN where it found nothing.
StereoField = tuple[np.ndarray, np.ndarray, np.ndarray]
_MILLI = 1e-3


def stereo_field(
    calibration: Path,
    left: str,
    right: str,
    region: tuple[int, int, int, int],
    *,
    window: int,
    make: bool,
) -> StereoField | str:
    """What al-dic-3d makes of two cameras' series, its other settings untouched.

    Parameters
    ----------
    calibration : Path        in DICe's format, millimetres
    left, right : str         patterns of the pictures, in time
    region : (xmin, xmax, ymin, ymax) [px]
    window : int [px]         side of its subsets, even
    make : bool               whether a missing environment may be made

    Returns
    -------
    pixel (n, 2), point (n, 3) [m], displacement (t, n, 3) [m] since the first instant; or why there
    is nothing
    """
    environment = Environment(HERE, PROGRAM)
    if problem := environment.problem(make=make):
        return problem
    xmin, xmax, ymin, ymax = region
    with tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "config.toml"
        config.write_text(
            f'[calibration]\nfile = "{calibration}"\nformat = "dice"\n'
            f'[sequence]\nleft = "{left}"\nright = "{right}"\n'
            f"[roi]\nxmin = {xmin}\nxmax = {xmax}\nymin = {ymin}\nymax = {ymax}\n"
            f"[matching]\nwinsize = {window}\nwinstepsize = {window // 2}\nstereo_search = 100\n"
            f'[output]\ndir = "{folder}/out"\nprefix = "run"\n',
            encoding="utf-8",
        )
        program = environment.python.parent / PROGRAM
        command = [str(program), "run", str(config), "--quiet", "--formats", "npz"]
        done = run_command(command, cwd=Path(folder))
        if done.returncode:
            return f"{PROGRAM} stopped: {last_line(done.stderr)}"
        result = np.load(Path(folder) / "out" / "run.npz")
        moved = _MILLI * result["displacement3D"][1:]
        return result["ref_coords"], _MILLI * result["points3D"][0], moved
