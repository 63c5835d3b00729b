"""NPZ: Green's functions around the contacts, for haptic loops."""

from pathlib import Path

from palpate.simulation.green_files import write_green_functions
from palpate.simulation.green_functions import make_green_functions
from palpate.simulation.solid_model import EstimatedObject, Format

_POISSON = (-0.999, 0.5)
_RUN = (
    "palpate.simulation.read_green_functions('green.npz'), or any reader of NPZ: its arrays are"
    " explained in docs/howto/simulate.md."
)
# Largest number of vertices that may be touched: those nearest to the session's contacts.
_NODES = 400


def write_npz(folder: Path, body: EstimatedObject) -> str:
    """Write green.npz: the Green's functions of the vertices nearest to the session's contacts.

    Parameters
    ----------
    folder : Path
    body : EstimatedObject

    Returns
    -------
    str                             sentence about vertices that are left out; empty: none

    Raises
    ------
    RecordError                     the file cannot be written
    """
    green = make_green_functions(body.session, body.material, most=_NODES)
    write_green_functions(folder / "green.npz", green)
    return green.left_out_text


NPZ = Format("NPZ", _POISSON, _RUN, of_surface=write_npz)
