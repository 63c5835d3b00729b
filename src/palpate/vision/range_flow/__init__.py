"""Range flow, and the contract of a method that measures it.

Purpose    : what every flow method takes and gives, and the pixel grid that it measures on.
Takes      : a `SurfaceMap` of the reference camera; matches, from the methods.
Gives      : `FlowMethod`; `RangeFlow` with an `Outcome` for every point, `VertexDisplacement`;
             points and triangles of the grid.
Depends on : `vision.cameras`, `geometry`, `records`.
Read first : `flow.py`, then `grid.py`.
"""

from palpate.vision.range_flow.flow import (
    CAUSES as CAUSES,
    FlowMethod as FlowMethod,
    Outcome as Outcome,
    RangeFlow as RangeFlow,
    VertexDisplacement as VertexDisplacement,
    cause_counts as cause_counts,
    is_valid as is_valid,
    measured_vertices as measured_vertices,
)
from palpate.vision.range_flow.grid import (
    dense_maps as dense_maps,
    grid_points as grid_points,
    grid_triangles as grid_triangles,
)
