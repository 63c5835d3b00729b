"""Range flow, and the contract of a method that measures it.

Purpose    : what every flow method takes and gives, and the pixel grid that it measures on.
Takes      : a `SurfaceMap` of the reference camera; matches, from the methods.
Gives      : `FlowMethod`; `RangeFlow` with an `Outcome` for every point, `VertexDisplacement`;
             points and triangles of the grid.
Depends on : `vision.cameras`, `geometry`, `records`.
Read first : `flow.py`, then `grid.py`.
"""
