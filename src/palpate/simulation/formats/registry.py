"""Simulators that an estimated object can be handed to."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from palpate.simulation.formats import (
    calculix,
    febio,
    genesis,
    isaaclab,
    mujoco,
    npz,
    obj,
    openusd,
    sofa,
    vtu,
)
from palpate.simulation.solid_model import EstimatedObject, SolidModel


@dataclass(frozen=True, slots=True)
class Format:
    """How an object is written for a simulator.

    Attributes
    ----------
    title : str                     the simulator's name
    poisson : (float, float)        Poisson's ratios that it takes
    run : str                       what to do with the files
    of_solid : callable or None     (folder, SolidModel): writes tetrahedra
    of_surface : callable or None   (folder, EstimatedObject): writes the surface; one of the two
    """

    title: str
    poisson: tuple[float, float]
    run: str
    of_solid: Callable[[Path, SolidModel], None] | None = None
    of_surface: Callable[[Path, EstimatedObject], None] | None = None


# To add a simulator: a file with what writes it, and one line here.
FORMATS: Mapping[str, Format] = {
    "mujoco": Format("MuJoCo", mujoco.POISSON, mujoco.RUN, mujoco.write_mujoco),
    "calculix": Format("CalculiX", calculix.POISSON, calculix.RUN, calculix.write_calculix),
    "febio": Format("FEBio", febio.POISSON, febio.RUN, febio.write_febio),
    "sofa": Format("SOFA", sofa.POISSON, sofa.RUN, sofa.write_sofa),
    "vtu": Format("VTU", vtu.POISSON, vtu.RUN, vtu.write_vtu),
    "openusd": Format("OpenUSD", openusd.POISSON, openusd.RUN, openusd.write_openusd),
    "obj": Format("OBJ", obj.POISSON, obj.RUN, of_surface=obj.write_obj),
    "genesis": Format("Genesis", genesis.POISSON, genesis.RUN, of_surface=genesis.write_genesis),
    "isaaclab": Format(
        "Isaac Lab", isaaclab.POISSON, isaaclab.RUN, of_surface=isaaclab.write_isaaclab
    ),
    "npz": Format("NPZ", npz.POISSON, npz.RUN, of_surface=npz.write_npz),
}
