"""Simulators to which an estimated object can be exported."""

from collections.abc import Mapping

from palpate.simulation.formats.calculix import CALCULIX
from palpate.simulation.formats.febio import FEBIO
from palpate.simulation.formats.genesis import GENESIS
from palpate.simulation.formats.isaaclab import ISAACLAB
from palpate.simulation.formats.mujoco import MUJOCO
from palpate.simulation.formats.npz import NPZ
from palpate.simulation.formats.obj import OBJ
from palpate.simulation.formats.openusd import OPENUSD
from palpate.simulation.formats.sofa import SOFA
from palpate.simulation.formats.vtu import VTU
from palpate.simulation.solid_model import Format

# To add a simulator: a file with its `Format`, and one line here.
FORMATS: Mapping[str, Format] = {
    "mujoco": MUJOCO,
    "calculix": CALCULIX,
    "febio": FEBIO,
    "sofa": SOFA,
    "vtu": VTU,
    "openusd": OPENUSD,
    "obj": OBJ,
    "genesis": GENESIS,
    "isaaclab": ISAACLAB,
    "npz": NPZ,
}
