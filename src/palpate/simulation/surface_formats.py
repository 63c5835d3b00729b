"""Simulators that mesh the object themselves, or need no solid; and OpenUSD.

Genesis takes the surface, finer under the push, and a scene that fills and holds it; Isaac Lab the
surface, and the material as a configuration of its spawners; OBJ is the surface for programs
without a format of their own here. NPZ holds Green's functions around the contacts, for haptic
loops. OpenUSD is a TetMesh with the constants under the names of Newton and of Omniverse's PhysX.

Source
------
Genesis 1.4: tetrahedra that it makes keep the vertices of the file first, in their order. OpenUSD's
UsdGeomTetMesh: the constants are written twice, as `physics:youngsModulus` and so on, by the
Alliance for OpenUSD's proposal for deformable bodies, which Newton reads (`get_tetmesh` of
`newton.usd`), and as `omniphysics:youngsModulus` and so on, the names of Omniverse's PhysX.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from palpate.geometry import TriangleMesh, enclosed_volume, write_mesh
from palpate.records import json_text, write_text
from palpate.simulation.estimated_object import EstimatedObject, Format, SolidModel
from palpate.simulation.green_functions import make_green_functions, write_green_functions
from palpate.simulation.solid_formats import write_replay, young_moduli

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
_ISAACLAB_TEXT = '''"""The object's material for Isaac Lab; made by Palpate, see README.txt."""

from isaaclab_physx.sim.spawners.materials import PhysxDeformableBodyMaterialCfg

SURFACE = "surface.obj"
MATERIAL = PhysxDeformableBodyMaterialCfg(
    youngs_modulus={young:.9g},
    poissons_ratio={poisson:.9g},
    density={density:.9g},
)
'''
_SURFACE = "surface.obj"
# Largest number of vertices that may be touched: those nearest to the session's contacts.
_NODES = 400
_STAGE = """#usda 1.0
(
    defaultPrim = "Object"
    metersPerUnit = 1
    kilogramsPerUnit = 1
    upAxis = "Z"
    doc = "SI units; made by Palpate, see README.txt"
)

def Xform "Object" (
    kind = "component"
)
{{
    def TetMesh "Body" (
        prepend apiSchemas = ["MaterialBindingAPI"]
    )
    {{
        point3f[] points = [{points}]
        int4[] tetVertexIndices = [{tetrahedra}]
        int3[] surfaceFaceVertexIndices = [{faces}]
        uniform token orientation = "rightHanded"
        int[] primvars:held = [{held}] (
            interpolation = "vertex"
        )
        float[] primvars:youngsModulus = [{moduli}] (
            interpolation = "{interpolation}"
        )
        rel material:binding:physics = </Object/Estimated>
    }}

    def Material "Estimated" (
        prepend apiSchemas = [
            "PhysicsVolumeDeformableMaterialAPI", "OmniPhysicsDeformableMaterialAPI"
        ]
    )
    {{
        float physics:youngsModulus = {young:.9g}
        float physics:poissonsRatio = {poisson:.9g}
        float physics:density = {density:.9g}
        float omniphysics:youngsModulus = {young:.9g}
        float omniphysics:poissonsRatio = {poisson:.9g}
        float omniphysics:density = {density:.9g}
    }}
}}
"""


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
    write_mesh(folder / _SURFACE, TriangleMesh(model.nodes[nodes], triangles))
    write_text(folder / "held.json", json_text({"vertices": held}))
    text = _SCENE.format(
        volume=enclosed_volume(surface) / len(model.linear),
        young=body.material.young_modulus,
        poisson=body.material.poisson_ratio,
        density=body.density,
    )
    write_text(folder / "scene.py", text)
    write_replay(folder, replace(model, node=vertex[model.node]), model.linear_load[nodes])


GENESIS = Format(
    "Genesis",
    (0.0, 0.495),
    "python scene.py, where Genesis is installed: it fills the surface with about as many"
    " tetrahedra of its own as the other formats have, and holds the vertices of held.json."
    " replay.json has the push as forces on vertices of surface.obj, which are the first in"
    " Genesis, too. It takes no forces on nodes: add force / mass * dt to their velocities before"
    " every step. Its corotational material gives way under large compression: repeat a share of"
    " the push. The half ball of Palpate's examples comes to rest 5.0 % from Palpate's model in"
    " Genesis 1.4, under 2 % of the push.",
    of_solid=write_genesis,
)


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
    _write_obj_and_script(folder, body, "body.py", _ISAACLAB_TEXT)


ISAACLAB = Format(
    "Isaac Lab",
    (0.0, 0.495),
    "import body.py in a task of Isaac Lab: PhysX fills the surface itself. Not tried in Isaac Lab"
    " itself.",
    of_surface=write_isaaclab,
)


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
    write_mesh(folder / _SURFACE, body.session.mesh)


def _write_obj_and_script(folder: Path, body: EstimatedObject, name: str, text: str) -> None:
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


OBJ = Format(
    "OBJ",
    (-0.999, 0.5),
    "surface.obj is the surface in metres; constants and the push are in palpate.json.",
    of_surface=write_obj,
)


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
    green = make_green_functions(body.session, body.material, modulus=body.modulus, most=_NODES)
    write_green_functions(folder / "green.npz", green)
    return green.left_out_text


NPZ = Format(
    "NPZ",
    (-0.999, 0.5),
    "palpate.simulation.read_green_functions('green.npz'), or any reader of NPZ: its arrays are"
    " explained in docs/howto/simulate.md.",
    of_surface=write_npz,
    by_element=True,
)


def write_openusd(folder: Path, model: SolidModel) -> None:
    """Write model.usda and replay.json.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    material, moduli = model.body.material, young_moduli(model)
    text = _STAGE.format(
        points=_tuples(model.nodes),
        tetrahedra=_tuples(model.linear),
        faces=_tuples(model.boundary_surface.triangles),
        held=", ".join(map(str, model.held.astype(int).tolist())),
        moduli=", ".join(f"{young:.9g}" for young in moduli.tolist()),
        interpolation="uniform" if len(moduli) > 1 else "constant",
        young=material.young_modulus,
        poisson=material.poisson_ratio,
        density=model.body.density,
    )
    write_text(folder / "model.usda", text)
    write_replay(folder, model, model.linear_load)


def _tuples(rows: Shaped[np.ndarray, "n k"]) -> str:
    """Rows as tuples in parentheses, separated by commas."""
    form = "d" if np.issubdtype(rows.dtype, np.integer) else ".9g"
    return ", ".join(
        "(" + ", ".join(format(value, form) for value in row) + ")" for row in rows.tolist()
    )


OPENUSD = Format(
    "OpenUSD",
    (0.0, 0.495),
    "any OpenUSD reader from 24.03 on opens model.usda; the prim variable `held` marks nodes that"
    " do not move, which a simulator has to be told. In Newton `held` is a custom attribute of the"
    " builder, and its VBD solver needs short steps: each begins where inertia alone would lead,"
    " which throws the light nodes under the contact. With steps of 0.1 ms, ten iterations and 2 %"
    " of the push, the half ball of Palpate's examples comes to rest 2.1 % from Palpate's model in"
    " Newton 1.8. Its material (stable neo-Hookean) gives way under large compression. The prim"
    " variable `youngsModulus` has the modulus of every tetrahedron, which a simulator has to be"
    " told, too, where it is not the same everywhere; the material has that of the table.",
    of_solid=write_openusd,
    is_linear=True,
    by_element=True,
)
