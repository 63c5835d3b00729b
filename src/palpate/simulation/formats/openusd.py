"""OpenUSD: a TetMesh with the constants under the names of Newton and of Omniverse's PhysX.

Source
------
OpenUSD's UsdGeomTetMesh. The constants are written twice: as `physics:youngsModulus` and so on, by
the Alliance for OpenUSD's proposal for deformable bodies, which Newton reads (`get_tetmesh` of
`newton.usd`), and as `omniphysics:youngsModulus` and so on, the names of Omniverse's PhysX.
"""

from pathlib import Path

import numpy as np
from jaxtyping import Shaped

from palpate.records import write_text
from palpate.simulation.format_texts import write_replay
from palpate.simulation.solid_model import Format, SolidModel

_POISSON = (0.0, 0.495)
_RUN = (
    "any OpenUSD reader from 24.03 on opens model.usda; the prim variable `held` marks nodes that"
    " do not move, which a simulator has to be told. In Newton `held` is a custom attribute of the"
    " builder, and its VBD solver needs short steps: each begins where inertia alone would lead,"
    " which throws the light nodes under the contact. With steps of 0.1 ms, ten iterations and 2 %"
    " of the push, the half ball of Palpate's examples comes to rest 2.1 % from Palpate's model in"
    " Newton 1.8. Its material (stable neo-Hookean) gives way under large compression."
)
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
    material = model.body.material
    text = _STAGE.format(
        points=_tuples(model.nodes),
        tetrahedra=_tuples(model.linear),
        faces=_tuples(model.boundary_surface.triangles),
        held=", ".join(map(str, model.held.astype(int).tolist())),
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


OPENUSD = Format("OpenUSD", _POISSON, _RUN, of_solid=write_openusd)
