"""Genesis: the surface, and a scene that meshes its interior."""

from pathlib import Path

from palpate.simulation.formats.obj import write_obj_and_script
from palpate.simulation.solid_model import EstimatedObject, Format

_POISSON = (0.0, 0.495)
_RUN = "python scene.py, where Genesis is installed: it fills the surface itself."
_TEXT = '''"""The object in Genesis; made by Palpate, see README.txt. The support is not written."""

import genesis as gs

gs.init()
scene = gs.Scene(fem_options=gs.options.FEMOptions(use_implicit_solver=True))
body = scene.add_entity(
    morph=gs.morphs.Mesh(file="surface.obj", scale=1.0),
    material=gs.materials.FEM.Elastic(
        E={young:.9g}, nu={poisson:.9g}, rho={density:.9g}, model="linear_corotated"
    ),
)
scene.build()
'''


def write_genesis(folder: Path, body: EstimatedObject) -> None:
    """Write surface.obj and scene.py.

    Parameters
    ----------
    folder : Path
    body : EstimatedObject

    Raises
    ------
    RecordError                     a file cannot be written
    """
    write_obj_and_script(folder, body, "scene.py", _TEXT)


GENESIS = Format("Genesis", _POISSON, _RUN, of_surface=write_genesis)
