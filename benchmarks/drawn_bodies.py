"""Eight bodies as others draw them: solids of a modelling program, remeshed evenly.

No row of triangles follows their shape, as none does on a mesh by `palpate mesh`. All stand on
z = 0.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from manifold3d import CrossSection, Manifold

from benchmarks.bodies import Shape
from palpate.geometry import TriangleMesh, triangle_areas
from palpate.scanning.plane import Plane
from palpate.scanning.remesh import remeshed

_MM = 1e-3
# Sides of a circle; length of triangles' sides in a surface that is given by a function [mm].
_SIDES, _STEP = 128, 1.6
# Triangles of this size and less are the drawing's own, cut [m].
_FINE = 2.0 * _MM
# Vertices as near to the foot are meant to be on it [m].
_ON_FOOT = 2e-5
# Area of an equilateral triangle of side one, two triangles a vertex.
_AREA_A_VERTEX = 2 * 0.433


def _cylinder(radius: float, height: float) -> Any:
    return Manifold.cylinder(height, radius, radius, _SIDES)


def _ball(radius: float) -> Any:
    return Manifold.sphere(radius, _SIDES)


def _standing(solid: Any) -> Any:
    """What of a solid is above z = 0."""
    return solid.trim_by_plane([0, 0, 1], 0.0)


def _within(level: Callable[[np.ndarray], float]) -> Any:
    """Where a function of the place [mm] is positive, above z = 0."""
    bounds = [-60.0, -60.0, -30.0, 60.0, 60.0, 80.0]
    return _standing(Manifold.level_set(lambda *at: level(np.array(at)), bounds, _STEP))


def _tube() -> Any:
    return _cylinder(28, 60) - _cylinder(18, 62).translate([0, 0, -1])


def _star() -> Any:
    angle = np.arange(10) * np.pi / 5
    radius = np.where(np.arange(10) % 2 == 0, 40, 22)
    corner = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return CrossSection([corner]).extrude(35)


def _wedge() -> Any:
    """A desk's section, pierced from side to side."""
    section = CrossSection([[[-40, 0], [40, 0], [40, 16], [-40, 50]]])
    hole = _cylinder(9, 60).translate([0, 0, -30]).rotate([90, 0, 0]).translate([-12, 0, 20])
    return section.extrude(40).translate([0, 0, -20]).rotate([90, 0, 0]) - hole


def _bowl() -> Any:
    """A thick half shell, its rim below."""
    return (_ball(38) - _ball(28)).trim_by_plane([0, 0, 1], 8.0).translate([0, 0, -8])


def _pyramid() -> Any:
    return CrossSection.square([70, 70], True).extrude(45, scale_top=[0.45, 0.45])


def _dumbbell() -> Any:
    ball = _ball(22).translate([0, 0, 11])
    bar = _cylinder(9, 64).rotate([0, 90, 0]).translate([-32, 0, 11])
    return _standing(ball.translate([-32, 0, 0]) + ball.translate([32, 0, 0]) + bar)


def _potato() -> Any:
    rng = np.random.default_rng(5)
    toward = rng.normal(size=(12, 3))
    toward /= np.linalg.norm(toward, axis=1)[:, None]
    size = 1.6 * rng.normal(size=12)

    def level(point: np.ndarray) -> float:
        point = point - [0, 0, 15]
        radius = float(np.linalg.norm(point)) + 1e-9
        return 28.0 + float(size @ (toward @ point / radius) ** 3) - radius

    return _within(level)


def _kidney() -> Any:
    """An ellipsoid with a rounded dent."""
    round_by = 0.25

    def level(point: np.ndarray) -> float:
        x, y, z = point - [0, 0, 12]
        body = 1 - np.sqrt((x / 45) ** 2 + (y / 30) ** 2 + (z / 24) ** 2)
        dent = np.sqrt((x / 20) ** 2 + ((y - 34) / 18) ** 2 + (z / 40) ** 2) - 1
        share = float(np.clip(0.5 + 0.5 * (dent - body) / round_by, 0, 1))
        return 25 * (dent * (1 - share) + body * share - round_by * share * (1 - share))

    return _within(level)


def _surface(solid: Any) -> TriangleMesh:
    drawn = solid.to_mesh64()
    vertices = _MM * np.asarray(drawn.vert_properties, dtype=np.float64)[:, :3]
    same = np.arange(len(vertices))
    twins, first = (
        np.asarray(x, dtype=np.int64) for x in (drawn.merge_from_vert, drawn.merge_to_vert)
    )
    same[twins] = first
    used, triangles = np.unique(same[np.asarray(drawn.tri_verts)], return_inverse=True)
    return _on_foot(TriangleMesh(vertices[used], triangles.reshape(-1, 3)), 1e-7)


def _on_foot(mesh: TriangleMesh, near: float) -> TriangleMesh:
    vertices = mesh.vertices.copy()
    vertices[np.abs(vertices[:, 2]) < near, 2] = 0.0
    return TriangleMesh(vertices, mesh.triangles)


def _make(draw: Callable[[], Any], creases: bool, edge: float) -> TriangleMesh:
    if edge < _FINE:
        return _surface(draw().refine_to_length(1.3 * edge / _MM))
    fine = _surface(draw().refine_to_length(_FINE / _MM))
    vertices = round(float(triangle_areas(fine).sum()) / (_AREA_A_VERTEX * edge**2))
    foot = Plane(np.zeros(3), np.array([0.0, 0.0, 1.0]))
    return _on_foot(remeshed(fine, vertices=vertices, creases=creases, support=foot), _ON_FOOT)


def _shape(draw: Callable[[], Any], edge: float, ratio: float, *, creases: bool = True) -> Shape:
    return Shape(partial(_make, draw, creases), edge * _MM, poisson_ratio=ratio)


DRAWN_BODIES = {
    "tube": _shape(_tube, 6.31, 0.2),
    "star": _shape(_star, 5.21, 0.4),
    "wedge": _shape(_wedge, 5.67, 0.1),
    "bowl": _shape(_bowl, 5.05, 0.35),
    "pyramid": _shape(_pyramid, 5.6, 0.25),
    "dumbbell": _shape(_dumbbell, 4.69, 0.45),
    "potato": _shape(_potato, 4.41, 0.3, creases=False),
    "kidney": _shape(_kidney, 4.93, 0.48, creases=False),
}
