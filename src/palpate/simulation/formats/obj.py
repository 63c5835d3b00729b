"""OBJ: the surface, for programs without a format of their own here."""

from pathlib import Path

from palpate.geometry import write_mesh
from palpate.records import write_text
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
    RecordError                     the file cannot be written
    """
    write_mesh(folder / SURFACE, body.session.mesh)


def write_obj_and_script(folder: Path, body: EstimatedObject, name: str, text: str) -> None:
    """Write surface.obj, and a script with the material for a simulator that meshes the interior.

    Parameters
    ----------
    folder : Path
    body : EstimatedObject
    name : str                      file name of the script
    text : str                      with fields young, poisson and density, in SI units

    Raises
    ------
    RecordError                     a file cannot be written
    """
    write_obj(folder, body)
    material = body.material
    filled = text.format(
        young=material.young_modulus, poisson=material.poisson_ratio, density=body.density
    )
    write_text(folder / name, filled)


OBJ = Format("OBJ", _POISSON, _RUN, of_surface=write_obj)
