"""Half balls with exactly the given facets, against quadratic finite elements on the same solid."""

from dataclasses import dataclass

import numpy as np

from benchmarks.figure import BEM, Figure
from benchmarks.machine import SHARED
from benchmarks.options import Options
from palpate.bem import (
    PressureDisc,
    SurfaceLoad,
    boundary_system,
    make_elastic_map,
    make_surface,
)
from palpate.geometry import TriangleMesh

CASES = {
    237: ("pole_h80_nu020",),
    573: ("pole_h50_nu020", "pole_h50_nu000", "pole_h50_nu045", "oblique_h50_nu020"),
    1167: ("pole_h35_nu020", "oblique_h35_nu020"),
}
REMAINING = "the finite elements' own error is 0.08 to 0.17 % at 573, 0.13 % at 1167 vertices"


@dataclass(frozen=True, slots=True, eq=False)
class _Pressure:
    """(1 - s^2)^2 at chord distance s * radius from a point of the ball, not of its facets."""

    centre: np.ndarray
    radius: float

    def of_distance(self, s: np.ndarray) -> np.ndarray:
        return np.clip(1 - s * s, 0, None) ** 2

    def of_place(self, triangle: np.ndarray, barycentric: np.ndarray, position: np.ndarray):
        return self.of_distance(np.linalg.norm(position - self.centre, axis=1) / self.radius)


def measure(options: Options) -> list[Figure]:
    """Worst case of each size with our elements, and the classical linear elements beside."""
    sizes = (573,) if options.quick else (573, 1167)
    figures = []
    for size in sizes:
        name = f"half ball of flat facets, {size} vertices: relative L2 error in u"
        figures.append(_worst(size, name, quadratic=True))
        figures.append(_worst(size, f"{name}, linear elements", quadratic=False))
    return figures


def facet_error(case: str, *, quadratic: bool = True) -> float:
    """Relative L2 error of the displacement of all vertices in one case.

    Parameters
    ----------
    case : str                a file of halfball_facets
    quadratic : bool          False: linear elements, as in the paper
    """
    data = np.load(SHARED / "halfball_facets" / f"{case}.npz")
    mesh = TriangleMesh(data["V"].astype(float), data["F"].astype(np.int64))
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] <= 1e-6).all(axis=1))
    surface = make_surface(mesh, held, smooth=False, quadratic=quadratic)
    pressure = _Pressure(data["load_point"], float(data["patch_radius"]))
    centre = mesh.vertices[mesh.triangles].mean(axis=1)
    near = np.linalg.norm(centre - pressure.centre, axis=1) < 1.6 * pressure.radius
    disc = PressureDisc(pressure.centre, pressure.radius, pressure.of_distance)
    load = SurfaceLoad(np.flatnonzero(near), pressure.of_place, disc)
    nu, young = float(data["nu"]), float(data["E"])
    elastic = make_elastic_map(
        boundary_system(surface), shear_modulus=young / (2 * (1 + nu)), poisson_ratio=nu
    )
    (state,) = elastic.respond([load], float(data["force"]) * data["direction"][None])
    truth = data["uV"]
    return float(np.linalg.norm(state.displacement - truth) / np.linalg.norm(truth))


def _worst(size: int, name: str, *, quadratic: bool) -> Figure:
    errors = {case: 100 * facet_error(case, quadratic=quadratic) for case in CASES[size]}
    listed = ", ".join(f"{case} {error:.3g} %" for case, error in errors.items())
    return Figure(BEM, name, max(errors.values()), "%", note=f"worst of {listed}; {REMAINING}")
