"""MuJoCo: a flex of linear tetrahedra, and a program that repeats the push."""

from pathlib import Path

import numpy as np

from palpate.geometry import enclosed_volume
from palpate.records import write_text
from palpate.simulation.format_texts import number_text, write_replay
from palpate.simulation.solid_model import Format, SolidModel

_POISSON = (0.0, 0.495)
_RUN = (
    "python replay.py [SHARE] repeats SHARE of the push (usually 0.02) and prints where its point"
    " comes to rest, over SHARE. MuJoCo's material (Saint Venant and Kirchhoff) gives way under"
    " large compression; a small share stays where the estimate holds. Written for MuJoCo 4; in"
    ' MuJoCo 3 replace integrator="discrete" by "implicitfast". MuJoCo may warn that the'
    " stiffness is ill-conditioned and the inertia close to singular: its solver stops early in"
    " single steps. The half ball of Palpate's examples comes to rest as far off with steps of a"
    " third."
)
_MODEL = """<mujoco model="{name}">
  <!-- SI units; made by Palpate, see README.txt -->
  <option timestep="0.01" gravity="0 0 0" integrator="discrete"/>
  <worldbody>
    <flexcomp name="body" type="direct" dim="3" mass="{mass}" radius="1e-4"
              point="{point}"
              element="{element}">
      <elasticity young="{young}" poisson="{poisson}" damping="0.01"/>
      <contact selfcollide="none"/>
      <pin id="{pin}"/>
    </flexcomp>
  </worldbody>
</mujoco>
"""
_REPLAY = '''"""Repeat the push of replay.json on model.xml; print where its point comes to rest."""

import json
import sys

import mujoco
import numpy as np

STEPS = 60
share = float(sys.argv[1]) if len(sys.argv) > 1 else 0.02
push = json.load(open("replay.json"))
model = mujoco.MjModel.from_xml_path("model.xml")
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
rest = data.flexvert_xpos.copy()
body = model.flex_vertbodyid[push["loaded_nodes"]]
for _ in range(STEPS):
    data.xfrc_applied[body, :3] = share * np.array(push["nodal_forces"])
    mujoco.mj_step(model, data)
moved = (data.flexvert_xpos - rest)[push["point_nodes"]]
found = np.array(push["point_shares"]) @ moved / share
wanted = np.array(push["displacement"])
print("displacement of the point in MuJoCo  [m]:", *found)
print("displacement of the point in Palpate [m]:", *wanted)
print("apart by", np.linalg.norm(found - wanted) / np.linalg.norm(wanted))
'''


def write_mujoco(folder: Path, model: SolidModel) -> None:
    """Write model.xml, replay.json and replay.py.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    body = model.body
    volume = enclosed_volume(body.session.mesh)
    text = _MODEL.format(
        name=body.session.path.parent.name.replace('"', "").replace("<", "").replace("&", ""),
        mass=number_text(np.array([volume * body.density])),
        point=number_text(model.nodes),
        element=number_text(model.linear),
        young=number_text(np.array([body.material.young_modulus])),
        poisson=number_text(np.array([body.material.poisson_ratio])),
        pin=number_text(np.flatnonzero(model.held)),
    )
    write_text(folder / "model.xml", text)
    write_replay(folder, model, model.linear_load)
    if body.push is not None:
        write_text(folder / "replay.py", _REPLAY)


MUJOCO = Format("MuJoCo", _POISSON, _RUN, of_solid=write_mujoco)
