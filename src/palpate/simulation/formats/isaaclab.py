"""Isaac Lab: the surface, and the material as a configuration of its spawners."""

from pathlib import Path

from palpate.simulation.formats.obj import write_obj_and_script
from palpate.simulation.solid_model import EstimatedObject, Format

_POISSON = (0.0, 0.495)
_RUN = (
    "import body.py in a task of Isaac Lab: PhysX fills the surface itself. Not tried in Isaac Lab"
    " itself."
)
_TEXT = '''"""The object's material for Isaac Lab; made by Palpate, see README.txt."""

from isaaclab_physx.sim.spawners.materials import PhysxDeformableBodyMaterialCfg

SURFACE = "surface.obj"
MATERIAL = PhysxDeformableBodyMaterialCfg(
    youngs_modulus={young:.9g},
    poissons_ratio={poisson:.9g},
    density={density:.9g},
)
'''


def write_isaaclab(folder: Path, body: EstimatedObject) -> None:
    """Write surface.obj and body.py.

    Parameters
    ----------
    folder : Path
    body : EstimatedObject

    Raises
    ------
    RecordError                     a file cannot be written
    """
    write_obj_and_script(folder, body, "body.py", _TEXT)


ISAACLAB = Format("Isaac Lab", _POISSON, _RUN, of_surface=write_isaaclab)
