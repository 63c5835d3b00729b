"""FEBio: a model of format 4.0 with ten-node tetrahedra and the push as nodal loads.

Source
------
FEBio User Manual 4, "Free format input" (help.febio.org).
"""

from pathlib import Path

import numpy as np

from palpate.records import write_text
from palpate.simulation.format_texts import write_replay
from palpate.simulation.solid_model import Format, SolidModel

_POISSON = (-0.999, 0.499)
_RUN = (
    "febio4 -i model.feb: equilibrium under the push; displacement.csv has the displacement of"
    " every node. FEBio's isotropic elastic material (Saint Venant and Kirchhoff) gives way under"
    " large compression: scale the forces down where the push is deep. Not tried in FEBio itself."
)
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
    <material id="1" name="estimated" type="isotropic elastic">
      <density>{density:.9g}</density>
      <E>{young:.9g}</E>
      <v>{poisson:.9g}</v>
    </material>
  </Material>
  <Mesh>
    <Nodes name="nodes">
"""


def write_febio(folder: Path, model: SolidModel) -> None:
    """Write model.feb and replay.json.

    Parameters
    ----------
    folder : Path
    model : SolidModel

    Raises
    ------
    RecordError                     a file cannot be written
    """
    material = model.body.material
    head = _HEAD.format(
        density=model.body.density, young=material.young_modulus, poisson=material.poisson_ratio
    )
    nodes = [_row("node", k, row, ".9g") for k, row in enumerate(model.nodes.tolist(), start=1)]
    elements = [
        _row("elem", k, row, "d") for k, row in enumerate((model.solid.elements + 1).tolist(), 1)
    ]
    loaded = np.flatnonzero(model.load.any(axis=1))
    sets = [_node_set("held", np.flatnonzero(model.held))]
    if loaded.size:
        sets.append(_node_set("loaded", loaded))
    text = head + "\n".join(
        [
            *nodes,
            "    </Nodes>",
            '    <Elements type="tet10" name="body">',
            *elements,
            "    </Elements>",
            *sets,
            "  </Mesh>",
            '  <MeshDomains><SolidDomain name="body" mat="estimated"/></MeshDomains>',
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


FEBIO = Format("FEBio", _POISSON, _RUN, of_solid=write_febio)
