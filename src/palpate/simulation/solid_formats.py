"""Simulators that take the tetrahedra: CalculiX and Abaqus, FEBio, VTU, SOFA, MuJoCo.

CalculiX, FEBio and VTU, the files of ParaView and meshio, take ten-node tetrahedra with the held
nodes and the push as nodal forces; SOFA corotational linear tetrahedra with the push as a constant
force, and for a body that creeps branches of Maxwell by its plugin SofaViscoElastic beside them;
MuJoCo a flex of linear tetrahedra for every modulus, with a program that repeats the push.

Source
------
FEBio User Manual 4, "Free format input" (help.febio.org). VTK file formats, "XML File Formats",
https://docs.vtk.org; a quadratic tetrahedron is cell type 24. SOFA's documentation of StaticSolver,
TetrahedronFEMForceField, FixedProjectiveConstraint and ConstantForceField
(sofa-framework.github.io). Sources and creep test of github.com/SofaDefrost/SofaViscoElastic: a
branch takes a step whenever its force is asked for, so the solver must ask once a step.
"""

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from palpate.geometry import enclosed_volume, unit_normals
from palpate.records import json_text, write_text
from palpate.simulation.estimated_object import Format, SolidModel
from palpate.simulation.laws import (
    abaqus_law,
    febio_material,
    sofa_branches,
    write_abaqus_prony,
    write_febio_prony,
)

# Radius of the ball to push with where no tool is known, in radii of the contact; distance of its
# centre from the surface, in its own radii.
_BALL_RADII, _BALL_AWAY = 2.0, 1.5
_HEAD = """<?xml version="1.0" encoding="UTF-8"?>
<!-- SI units; made by Palpate, see README.txt -->
<febio_spec version="4.0">
  <Module type="solid"/>
  <Control>
    <analysis>STATIC</analysis>
    <time_steps>1</time_steps>
    <step_size>1</step_size>
    <solver type="solid"><symmetric_stiffness>symmetric</symmetric_stiffness></solver>
  </Control>
  <Material>
{materials}
  </Material>
  <Mesh>
    <Nodes name="nodes">
"""
_QUADRATIC_TETRAHEDRON = 24
_PLUGINS = (
    "Constraint.Projective", "LinearSolver.Direct", "Mass", "MechanicalLoad", "ODESolver.Backward",
    "SolidMechanics.FEM.Elastic", "StateContainer", "Topology.Container.Constant",
    "Topology.Container.Dynamic", "Visual",
)  # fmt: skip
_SCENE = """<?xml version="1.0"?>
<!-- SI units; made by Palpate, see README.txt -->
<Node name="root" gravity="0 0 0" dt="{step:.6g}">
{plugins}
  <VisualStyle displayFlags="showBehaviorModels showForceFields"/>
  <DefaultAnimationLoop/>
  <Node name="body">
{solver}
    <EigenSimplicialLDLT template="CompressedRowSparseMatrixMat3x3"/>
    <{container} name="mesh" position="{position}" tetrahedra="{tetrahedra}"/>
    <MechanicalObject name="state" template="Vec3d" src="@mesh"/>
    <UniformMass totalMass="{mass:.9g}"/>
    <TetrahedronFEMForceField template="Vec3d" method="large" youngModulus="{young}"
                              poissonRatio="{poisson:.9g}"/>
{branches}    <FixedProjectiveConstraint indices="{held}"/>
{push}  </Node>
</Node>
"""
_AT_REST = """\
    <NewtonRaphsonSolver name="newton" maxNbIterationsNewton="100" maxNbIterationsLineSearch="1"
                         warnWhenLineSearchFails="false"/>
    <StaticSolver newtonSolver="@newton"/>"""
_OVER_TIME = """\
    <RequiredPlugin name="SofaViscoElastic"/>
    <EulerImplicitSolver firstOrder="true" rayleighMass="0" rayleighStiffness="0"/>"""
_BRANCH = """    <TetrahedronViscoelasticityFEMForceField name="branch{number}" template="Vec3d"
      topology="@mesh" materialName="MaxwellFirstOrder" ParameterSet="{shear:.9g} {time:.9g} 0"/>
"""
# A step of the branches in shares of the shortest relaxation time, as SofaViscoElastic advises. To
# a solver of first order mass is a resistance to motion: so small a share of it is none.
_STEP, _LITTLE_MASS = 0.01, 1e-6
_MODEL = """<mujoco model="{name}">
  <!-- SI units; made by Palpate, see README.txt -->
  <option timestep="0.01" gravity="0 0 0" integrator="discrete"/>
  <default>
    <joint type="slide"/>
  </default>
  <worldbody>
{bodies}{ball}
  </worldbody>
  <deformable>
{flexes}
  </deformable>
</mujoco>
"""
# A node that is not held; tetrahedra of one modulus, which share nodes with the others. No flex
# touches another.
_BODY = """    <body name="node{node}" pos="{place}">
      <inertial pos="0 0 0" mass="{mass}" diaginertia="1e-9 1e-9 1e-9"/>
      <joint axis="1 0 0"/><joint axis="0 1 0"/><joint axis="0 0 1"/>
    </body>"""
# To push with: it goes where a program, or the mouse, puts it, and touches the flexes alone. By
# MuJoCo's usual solimp nodes, which are light and stiff, would hardly resist it.
_BALL = """
    <body name="ball" mocap="true" pos="{place}">
      <geom type="sphere" size="{radius:.9g}" contype="0" conaffinity="1"
            solimp="0.999 0.9999 0.001" rgba="0.2 0.5 0.8 1"/>
    </body>"""
_FLEX = """    <flex name="body{number}" dim="3" radius="1e-4"
          body="{bodies}"
          vertex="{places}"
          element="{elements}">
      <elasticity young="{young}" poisson="{poisson}" damping="0.01"/>
      <contact selfcollide="none" contype="1" conaffinity="0" solimp="0.999 0.9999 0.001"/>
    </flex>"""
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
rest = data.xpos.copy()
# Held nodes are part of the world.
number = {model.body(k).name: k for k in range(model.nbody)}
body, point = (
    [number.get(f"node{node}", 0) for node in push[key]] for key in ("loaded_nodes", "point_nodes")
)
for _ in range(STEPS):
    data.xfrc_applied[body, :3] = share * np.array(push["nodal_forces"])
    mujoco.mj_step(model, data)
moved = (data.xpos - rest)[point]
found = np.array(push["point_shares"]) @ moved / share
wanted = np.array(push["displacement"])
print("displacement of the point in MuJoCo  [m]:", *found)
print("displacement of the point in Palpate [m]:", *wanted)
print("apart by", np.linalg.norm(found - wanted) / np.linalg.norm(wanted))
'''


def write_calculix(folder: Path, model: SolidModel) -> None:
    """Write model.inp and replay.json; for a body that creeps viscoelastic.inp.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    materials, stiffens = model.materials, model.body.estimate.stiffening is not None
    elements = list(_numbered_lines(model.solid.elements))
    lines = [
        "** SI units; made by Palpate, see README.txt",
        "*NODE, NSET=ALL",
        *_numbered_lines(model.nodes),
    ]
    for number, (_, chosen) in enumerate(materials, start=1):
        lines += [f"*ELEMENT, TYPE=C3D10, ELSET=BODY{number}", *(elements[k] for k in chosen)]
    lines += [
        "*NSET, NSET=HELD",
        *(f"{node + 1}," for node in np.flatnonzero(model.held)),
    ]
    for number, (young, _) in enumerate(materials, start=1):
        lines += [
            f"*MATERIAL, NAME=ESTIMATED{number}",
            *abaqus_law(model, young),
            "*DENSITY",
            f"{model.body.density:.9g}",
            f"*SOLID SECTION, ELSET=BODY{number}, MATERIAL=ESTIMATED{number}",
        ]
    lines += ["*BOUNDARY", "HELD, 1, 3, 0."]
    if model.body.push is not None:
        lines += [
            "*NSET, NSET=POINT",
            *(f"{node + 1}," for node in model.node),
            "*STEP, NLGEOM" if stiffens else "*STEP",
            "*STATIC",
            "*CLOAD",
            *(
                f"{node + 1}, {axis + 1}, {model.load[node, axis]:.9g}"
                for node, axis in np.argwhere(model.load != 0.0)
            ),
            "*NODE FILE",
            "U",
            "*NODE PRINT, NSET=POINT",
            "U",
            "*END STEP",
        ]
    write_abaqus_prony(folder, model)
    write_replay(folder, model, model.load)
    write_text(folder / "model.inp", "\n".join(lines) + "\n")


CALCULIX = Format(
    "CalculiX",
    (-0.999, 0.499),
    "ccx model (Abaqus: abaqus job=model): equilibrium under the push; model.dat has the"
    " displacement of the nodes around its point, replay.json their shares.",
    of_solid=write_calculix,
    by_element=True,
    stiffens=True,
)


def write_febio(folder: Path, model: SolidModel) -> None:
    """Write model.feb and replay.json; for a body that creeps viscoelastic.xml.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    body, groups = model.body, list(enumerate(model.materials, start=1))
    materials = [febio_material(body, number, young) for number, (young, _) in groups]
    head = _HEAD.format(materials="\n".join(materials))
    nodes = [_row("node", k, row, ".9g") for k, row in enumerate(model.nodes.tolist(), start=1)]
    elements = []
    for number, (_, chosen) in groups:
        elements.append(f'    <Elements type="tet10" name="body{number}">')
        rows = (model.solid.elements[chosen] + 1).tolist()
        pairs = zip((chosen + 1).tolist(), rows, strict=True)
        elements += [*(_row("elem", k, row, "d") for k, row in pairs), "    </Elements>"]
    domains = [
        f'    <SolidDomain name="body{number}" mat="estimated{number}"/>' for number, _ in groups
    ]
    loaded = np.flatnonzero(model.load.any(axis=1))
    sets = [_node_set("held", np.flatnonzero(model.held))]
    if loaded.size:
        sets.append(_node_set("loaded", loaded))
    text = head + "\n".join(
        [
            *nodes,
            "    </Nodes>",
            *elements,
            *sets,
            "  </Mesh>",
            "  <MeshDomains>",
            *domains,
            "  </MeshDomains>",
            *_data(model, loaded),
            "  <Boundary>",
            '    <bc name="support" node_set="held" type="zero displacement">',
            "      <x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof>",
            "    </bc>",
            "  </Boundary>",
            *_loads(loaded.size > 0),
            "  <Output>",
            '    <plotfile type="febio"><var type="displacement"/></plotfile>',
            '    <logfile><node_data data="ux;uy;uz" file="displacement.csv" delim=","/></logfile>',
            "  </Output>",
            "</febio_spec>",
            "",
        ]
    )
    write_text(folder / "model.feb", text)
    write_febio_prony(folder, model)
    write_replay(folder, model, model.load)


def _row(
    tag: str, number: int, values: list[float] | list[int], form: str, *, key: str = "id"
) -> str:
    """One node, element or value with its number."""
    inside = ",".join(format(value, form) for value in values)
    return f'      <{tag} {key}="{number}">{inside}</{tag}>'


def _node_set(name: str, nodes: np.ndarray) -> str:
    numbers = ",".join(map(str, (nodes + 1).tolist()))
    return f'    <NodeSet name="{name}">{numbers}</NodeSet>'


def _data(model: SolidModel, loaded: np.ndarray) -> list[str]:
    """The nodal forces as a data map over the set of loaded nodes."""
    if not loaded.size:
        return []
    rows = model.load[loaded].tolist()
    return [
        "  <MeshData>",
        '    <NodeData name="forces" node_set="loaded" data_type="vec3">',
        *(_row("node", k, row, ".9g", key="lid") for k, row in enumerate(rows, start=1)),
        "    </NodeData>",
        "  </MeshData>",
    ]


def _loads(any_load: bool) -> list[str]:
    if not any_load:
        return []
    return [
        "  <Loads>",
        '    <nodal_load name="push" node_set="loaded" type="nodal_force">',
        '      <value type="map">forces</value>',
        "    </nodal_load>",
        "  </Loads>",
    ]


FEBIO = Format(
    "FEBio",
    (-0.999, 0.499),
    "febio4 -i model.feb: equilibrium under the push; displacement.csv has the displacement of"
    " every node. FEBio's isotropic elastic material (Saint Venant and Kirchhoff) gives way under"
    " large compression: scale the forces down where the push is deep. Not tried in FEBio itself.",
    of_solid=write_febio,
    by_element=True,
    stiffens=True,
)


def write_vtu(folder: Path, model: SolidModel) -> None:
    """Write model.vtu and replay.json.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    count, nodes = len(model.solid.elements), len(model.nodes)
    ends = 10 * np.arange(1, count + 1)
    young = model.body.material.young_modulus * np.exp(model.log_modulus)
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian">',
        "<UnstructuredGrid>",
        f'<Piece NumberOfPoints="{nodes}" NumberOfCells="{count}">',
        '<PointData Vectors="force">',
        *_array("force", "Float64", model.load, 3),
        *_array("held", "UInt8", model.held.astype(np.uint8), 1),
        "</PointData>",
        "<CellData>",
        *_array("young_modulus", "Float64", young, 1),
        "</CellData>",
        "<Points>",
        *_array("Points", "Float64", model.nodes, 3),
        "</Points>",
        "<Cells>",
        *_array("connectivity", "Int64", model.solid.elements, 1),
        *_array("offsets", "Int64", ends, 1),
        *_array("types", "UInt8", np.full(count, _QUADRATIC_TETRAHEDRON, dtype=np.uint8), 1),
        "</Cells>",
        "</Piece>",
        "</UnstructuredGrid>",
        "</VTKFile>",
    ]
    write_text(folder / "model.vtu", "\n".join(lines) + "\n")
    write_replay(folder, model, model.load)


def _array(name: str, kind: str, values: np.ndarray, components: int) -> Iterable[str]:
    """One array as text."""
    yield (
        f'<DataArray type="{kind}" Name="{name}" NumberOfComponents="{components}" format="ascii">'
    )
    yield _number_text(values)
    yield "</DataArray>"


VTU = Format(
    "VTU",
    (-0.999, 0.5),
    "ParaView or meshio open model.vtu; constants are in palpate.json.",
    of_solid=write_vtu,
    by_element=True,
)


def write_sofa(folder: Path, model: SolidModel) -> None:
    """Write model.scn and replay.json; for a body that creeps viscoelastic.scn.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    body = model.body
    loaded = np.flatnonzero(model.linear_load.any(axis=1))
    push = ""
    if body.push is not None:
        forces = _number_text(model.linear_load[loaded])
        push = f'    <ConstantForceField indices="{_number_text(loaded)}" forces="{forces}"/>\n'
    scene = {
        "plugins": "\n".join(f'  <RequiredPlugin name="Sofa.Component.{x}"/>' for x in _PLUGINS),
        "position": _number_text(model.nodes),
        "tetrahedra": _number_text(model.linear),
        "held": _number_text(np.flatnonzero(model.held)),
        "push": push,
    }
    mass = enclosed_volume(body.session.mesh) * body.density
    prony_branches = sofa_branches(body)
    text = _SCENE.format(
        **scene, step=0.01, solver=_AT_REST, container="MeshTopology", mass=mass,
        young=_number_text(young_moduli(model)), poisson=body.material.poisson_ratio, branches="",
    )  # fmt: skip
    write_text(folder / "model.scn", text)
    write_replay(folder, model, model.linear_load)
    # A branch has one modulus for all tetrahedra.
    if prony_branches is None or body.modulus is not None:
        return
    lame, shear, branches = prony_branches
    rows = [_BRANCH.format(number=k, shear=g, time=t) for k, (g, t) in enumerate(branches, start=1)]
    text = _SCENE.format(
        **scene, step=_STEP * min(time for _, time in branches), solver=_OVER_TIME,
        container="TetrahedronSetTopologyContainer", mass=_LITTLE_MASS * mass,
        young=f"{shear * (3.0 * lame + 2.0 * shear) / (lame + shear):.9g}",
        poisson=0.5 * lame / (lame + shear), branches="".join(rows),
    )  # fmt: skip
    write_text(folder / "viscoelastic.scn", text)


def young_moduli(model: SolidModel) -> Float[np.ndarray, " _"]:
    """Young's moduli of the linear tetrahedra [Pa]; a single one if it is the same everywhere.

    Parameters
    ----------
    model : SolidModel
    """
    young = model.body.material.young_modulus
    if model.body.modulus is None:
        return np.array([young])
    # Eight linear ones for each quadratic one.
    return np.repeat(young * np.exp(model.log_modulus), 8)


SOFA = Format(
    "SOFA",
    (0.0, 0.495),
    "runSofa model.scn: the object comes to rest under the push; replay.json has the nodes around"
    " its point and their shares. runSofa viscoelastic.scn, of an object that creeps: how it moves"
    " under the push as time passes; needs the plugin SofaViscoElastic of SOFA 25.12, earlier"
    " versions of which read its numbers differently. Not tried in SOFA itself.",
    of_solid=write_sofa,
    is_linear=True,
    by_element=True,
)


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
    mass = enclosed_volume(body.session.mesh) * body.density / len(model.nodes)
    bodies = [
        _BODY.format(node=node, place=_number_text(model.nodes[node]), mass=f"{mass:.9g}")
        for node in np.flatnonzero(~model.held)
    ]
    flexes = []
    for number, (young, chosen) in enumerate(model.materials, start=1):
        # Eight linear ones for each quadratic one.
        used, element = np.unique(model.linear.reshape(-1, 8, 4)[chosen], return_inverse=True)
        held = model.held[used]
        flexes.append(
            _FLEX.format(
                number=number,
                bodies=" ".join(np.where(held, "world", np.char.add("node", used.astype(str)))),
                places=_number_text(np.where(held[:, None], model.nodes[used], 0.0)),
                elements=_number_text(element),
                young=f"{young:.9g}",
                poisson=f"{body.material.poisson_ratio:.9g}",
            )
        )
    ball = ""
    if (push := body.push) is not None and push.radius is not None:
        tool = push.patch.contact.tool
        radius = _BALL_RADII * push.radius if tool is None else tool.radius
        outward = unit_normals(body.session.mesh)[push.patch.triangle]
        position = push.point + _BALL_AWAY * radius * outward
        ball = _BALL.format(place=_number_text(position), radius=radius)
    text = _MODEL.format(
        ball=ball,
        name=body.session.path.parent.name.replace('"', "").replace("<", "").replace("&", ""),
        bodies="\n".join(bodies),
        flexes="\n".join(flexes),
    )
    write_text(folder / "model.xml", text)
    write_replay(folder, model, model.linear_load)
    if body.push is not None:
        write_text(folder / "replay.py", _REPLAY)


MUJOCO = Format(
    "MuJoCo",
    (0.0, 0.495),
    "python replay.py [SHARE] repeats SHARE of the push (usually 0.02) and prints where its point"
    " comes to rest, over SHARE. MuJoCo's material (Saint Venant and Kirchhoff) gives way under"
    " large compression; a small share stays where the estimate holds. Written for MuJoCo 4; in"
    ' MuJoCo 3 replace integrator="discrete" by "implicitfast". MuJoCo may warn that the'
    " stiffness is ill-conditioned and the inertia close to singular: its solver stops early in"
    " single steps. The half ball of Palpate's examples comes to rest as far off with steps of a"
    " third. Where the modulus differs from place to place there is a flex for every 2 % of it;"
    " flexes share nodes, and do not touch each other. `ball` is a mocap body to push with: move"
    " data.mocap_pos, or drag it in the viewer. For real time export with --nodes 500.",
    of_solid=write_mujoco,
    is_linear=True,
    by_element=True,
)


def _number_text(values: Shaped[np.ndarray, "..."]) -> str:
    """Numbers separated by spaces, floating-point ones with nine digits.

    Parameters
    ----------
    values : array

    Returns
    -------
    str
    """
    flat = values.ravel()
    if np.issubdtype(flat.dtype, np.integer):
        return " ".join(map(str, flat.tolist()))
    return " ".join(f"{value:.9g}" for value in flat.tolist())


def _numbered_lines(rows: Shaped[np.ndarray, "n k"]) -> Iterable[str]:
    """Rows, each after its number from 1, separated by commas, 16 entries a line at most; nodes are
    numbered from 1, too.

    Parameters
    ----------
    rows : (n, k) array             floating-point values; or integers, indices of nodes from 0

    Yields
    ------
    str
    """
    whole = np.issubdtype(rows.dtype, np.integer)
    for number, row in enumerate(rows.tolist(), start=1):
        cells = [str(number), *(str(v + 1) if whole else f"{v:.9g}" for v in row)]
        lines = [", ".join(cells[k : k + 16]) for k in range(0, len(cells), 16)]
        yield ",\n".join(lines)


def write_replay(folder: Path, model: SolidModel, load: Float[np.ndarray, "n 3"]) -> None:
    """Write replay.json: the push, if any, as nodal forces, with the displacement in the model.

    Parameters
    ----------
    folder : Path
    model : SolidModel
    load : (n, 3) float [N]         nodal forces

    Raises
    ------
    RecordError                     the file cannot be written
    """
    push = model.body.push
    if push is None:
        return
    loaded = np.flatnonzero(load.any(axis=1))
    content = {
        "probing": push.name,
        "force": push.force.tolist(),
        "displacement": push.displacement.tolist(),
        "loaded_nodes": loaded.tolist(),
        "nodal_forces": load[loaded].tolist(),
        "point_nodes": model.node.tolist(),
        "point_shares": model.share.tolist(),
    }
    write_text(folder / "replay.json", json_text(content))
