"""Genesis: the surface, finer under the push, and a scene that fills and holds it.

Source
------
Genesis 1.4: tetrahedra that it makes keep the vertices of the file first, in their order.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.geometry import TriangleMesh, enclosed_volume, write_mesh
from palpate.records import json_text, write_text
from palpate.simulation.format_texts import write_replay
from palpate.simulation.formats.obj import SURFACE
from palpate.simulation.solid_model import Format, SolidModel

_POISSON = (0.0, 0.495)
_RUN = (
    "python scene.py, where Genesis is installed: it fills the surface with about as many"
    " tetrahedra of its own as the other formats have, and holds the vertices of held.json."
    " replay.json has the push as forces on vertices of surface.obj, which are the first in"
    " Genesis, too. It takes no forces on nodes: add force / mass * dt to their velocities before"
    " every step. Its corotational material gives way under large compression: repeat a share of"
    " the push. The half ball of Palpate's examples comes to rest 5.0 % from Palpate's model in"
    " Genesis 1.4, under 2 % of the push."
)
_SCENE = '''"""The object in Genesis, on its support; made by Palpate, see README.txt."""

import json

import genesis as gs

gs.init()
scene = gs.Scene(
    sim_options=gs.options.SimOptions(dt=0.01, gravity=(0.0, 0.0, 0.0)),
    fem_options=gs.options.FEMOptions(
        use_implicit_solver=True, enable_vertex_constraints=True, n_pcg_iterations=2000,
        newton_dx_threshold=1e-10, pcg_threshold=1e-10,
    ),
    show_viewer=False,
)
body = scene.add_entity(
    morph=gs.morphs.Mesh(file="surface.obj", scale=1.0, maxvolume={volume:.3g}),
    material=gs.materials.FEM.Elastic(
        E={young:.9g}, nu={poisson:.9g}, rho={density:.9g}, model="linear_corotated"
    ),
)
scene.build()
body.set_vertex_constraints(json.load(open("held.json"))["vertices"])
'''


def write_genesis(folder: Path, model: SolidModel) -> None:
    """Write surface.obj, held.json, scene.py and replay.json.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    body, surface = model.body, model.boundary_surface
    nodes, triangles = np.unique(surface.triangles, return_inverse=True)
    vertex = np.full(len(model.nodes), -1)
    vertex[nodes] = np.arange(len(nodes))
    triangles = triangles.reshape(-1, 3)
    held = np.flatnonzero(model.held[nodes]).tolist()
    write_mesh(folder / SURFACE, TriangleMesh(model.nodes[nodes], triangles))
    write_text(folder / "held.json", json_text({"vertices": held}))
    text = _SCENE.format(
        volume=enclosed_volume(surface) / len(model.linear),
        young=body.material.young_modulus,
        poisson=body.material.poisson_ratio,
        density=body.density,
    )
    write_text(folder / "scene.py", text)
    write_replay(folder, replace(model, node=vertex[model.node]), model.linear_load[nodes])


GENESIS = Format("Genesis", _POISSON, _RUN, of_solid=write_genesis)
