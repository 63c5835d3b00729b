"""SOFA: a scene with corotational linear tetrahedra and the push as a constant force.

Source
------
SOFA's documentation of StaticSolver, TetrahedronFEMForceField, FixedProjectiveConstraint and
ConstantForceField (sofa-framework.github.io).
"""

from pathlib import Path

import numpy as np

from palpate.geometry import enclosed_volume
from palpate.records import write_text
from palpate.simulation.format_texts import number_text, write_replay
from palpate.simulation.solid_model import Format, SolidModel

_POISSON = (0.0, 0.495)
_RUN = (
    "runSofa model.scn: the object comes to rest under the push; replay.json has the nodes around"
    " its point and their shares. Not tried in SOFA itself."
)
_PLUGINS = (
    "Constraint.Projective", "LinearSolver.Direct", "Mass", "MechanicalLoad", "ODESolver.Backward",
    "SolidMechanics.FEM.Elastic", "StateContainer", "Topology.Container.Constant", "Visual",
)  # fmt: skip
_SCENE = """<?xml version="1.0"?>
<!-- SI units; made by Palpate, see README.txt -->
<Node name="root" gravity="0 0 0" dt="0.01">
{plugins}
  <VisualStyle displayFlags="showBehaviorModels showForceFields"/>
  <DefaultAnimationLoop/>
  <Node name="body">
    <NewtonRaphsonSolver name="newton" maxNbIterationsNewton="100" maxNbIterationsLineSearch="1"
                         warnWhenLineSearchFails="false"/>
    <StaticSolver newtonSolver="@newton"/>
    <EigenSimplicialLDLT template="CompressedRowSparseMatrixMat3x3"/>
    <MeshTopology name="mesh" position="{position}" tetrahedra="{tetrahedra}"/>
    <MechanicalObject name="state" template="Vec3d" src="@mesh"/>
    <UniformMass totalMass="{mass:.9g}"/>
    <TetrahedronFEMForceField template="Vec3d" method="large" youngModulus="{young:.9g}"
                              poissonRatio="{poisson:.9g}"/>
    <FixedProjectiveConstraint indices="{held}"/>
{push}  </Node>
</Node>
"""


def write_sofa(folder: Path, model: SolidModel) -> None:
    """Write model.scn and replay.json.

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
        forces = number_text(model.linear_load[loaded])
        push = f'    <ConstantForceField indices="{number_text(loaded)}" forces="{forces}"/>\n'
    plugins = "\n".join(f'  <RequiredPlugin name="Sofa.Component.{name}"/>' for name in _PLUGINS)
    text = _SCENE.format(
        plugins=plugins,
        position=number_text(model.nodes),
        tetrahedra=number_text(model.linear),
        mass=enclosed_volume(body.session.mesh) * body.density,
        young=body.material.young_modulus,
        poisson=body.material.poisson_ratio,
        held=number_text(np.flatnonzero(model.held)),
        push=push,
    )
    write_text(folder / "model.scn", text)
    write_replay(folder, model, model.linear_load)


SOFA = Format("SOFA", _POISSON, _RUN, of_solid=write_sofa)
