"""OBJ: the surface, for everything that has no format of its own here."""

from pathlib import Path

from palpate.geometry import write_mesh
from palpate.simulation.solid_model import EstimatedObject, Format

_POISSON = (-0.999, 0.5)
_RUN = "surface.obj is the surface in metres; constants and the push are in palpate.json."
SURFACE = "surface.obj"


def write_obj(folder: Path, body: EstimatedObject) -> None:
    """Write surface.obj.

    Parameters
    ----------
    folder : Path
    body : EstimatedObject

    Raises
    ------
    MeshError                       the file cannot be written
    """
    write_mesh(folder / SURFACE, body.session.mesh)


OBJ = Format("OBJ", _POISSON, _RUN, of_surface=write_obj)
