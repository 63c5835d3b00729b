"""Constants that are estimated on a scanned mesh, against those on the true one.

    python -m benchmarks.scanned_constants [FOLDER] [--vertices 1000]

The folder is that of `benchmarks.scanning`: a half ball and a toy on a turntable. Quadratic
tetrahedra of the true shape are pressed at five places; the same displacements, at the same points,
then go with either mesh, without noise and without errors that are fitted along, and with a noise
of 1 % and the errors that a session has by default. What differs is the mesh. The toy stands in a
block up to 25 mm, where it is widest: above its own foot, which it hides from the cameras, a scan
guesses, and `--on-foot` shows what that costs.
"""

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from benchmarks.body_truth import SHEAR_MODULUS, Truth
from benchmarks.figure import DOOR, Figure
from benchmarks.machine import MADE
from benchmarks.options import Options
from benchmarks.report import with_notes
from benchmarks.scanning import RADIUS, turntable
from palpate.geometry import TriangleMesh, closest_points, read_mesh, write_mesh
from palpate.lab import SHAPES
from palpate.pipeline import fit_session
from palpate.records import EXACT, Contact, DisplacementField, Estimate, Probing, Session
from palpate.records.error_priors import ErrorPriors
from palpate.scanning import read_scan, scan_surface
from palpate.scanning.plane import Plane
from palpate.scanning.remesh import remeshed
from palpate.scanning.solid import above
from palpate.shapes import Points
from palpate.solids import make_body, make_solid

POISSON_RATIO, PATCH, FORCE = 0.3, 6e-3, 1.0
# Edges of the exact surface and of the elements [m]; vertices of the elements' surface, of the mesh
# whose vertices are the points that are seen, and of the meshes that are compared.
_EXACT, _ELEMENT = 1e-3, 5e-3
_FINE, _SEEN, _VERTICES = 4000, 1200, 1000
# What is above the support [m].
_HEIGHT = {"half-ball": 0.0, "toy": 0.025}
# Triangles of a scan's foot lie this near to the plane that it was closed with.
_FOOT = 1e-4
_TOWARD = [
    [0.05, 0.08, 1.0],
    [0.7, 0.1, 0.7],
    [-0.5, 0.6, 0.7],
    [-0.4, -0.7, 0.6],
    [0.6, -0.6, 0.6],
]
_NOISE = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class Pressed:
    """A true body that was pressed.

    Attributes
    ----------
    place, force : (k, 3) float     [m], [N]
    points : (n, 3) float [m]       that were seen
    moved : (k, n, 3) float [m]
    """

    place: Points
    force: Points
    points: Points
    moved: Float[np.ndarray, "k n 3"]


def support_of(shape: str, on_foot: bool) -> Plane:
    """The plane on which the object is held."""
    return Plane(
        np.array([0.0, 0.0, 0.0 if on_foot else _HEIGHT[shape]]), np.array([0.0, 0.0, 1.0])
    )


def true_mesh(shape: str, vertices: int, support: Plane) -> TriangleMesh:
    """The exact shape above its support, in even triangles."""
    whole = SHAPES[shape].make(radius=RADIUS[shape], edge=_EXACT)
    cut = whole if support.point[2] == 0.0 else above(whole, support)
    return remeshed(cut, vertices=vertices, creases=False, support=support)


def pressed(shape: str, file: Path, support: Plane) -> Pressed:
    """What the true body does; computed once."""
    if not file.exists():
        surface = true_mesh(shape, _FINE, support)
        height = float(support.point[2])
        points = true_mesh(shape, _SEEN, support).vertices
        points = points[points[:, 2] > height + 4e-3]
        middle = [0.0, 0.0, 0.6 * height + 0.4 * float(surface.vertices[:, 2].max())]
        away = surface.vertices - middle
        away /= np.linalg.norm(away, axis=1, keepdims=True)
        toward = np.array(_TOWARD) / np.linalg.norm(_TOWARD, axis=1, keepdims=True)
        number = (away @ toward.T).argmax(axis=0)
        position = surface.vertices[number]
        force = -FORCE * away[number]
        fine = [(point, 1.2 * PATCH, 0.5 * _ELEMENT) for point in position]
        solid = make_solid(surface, edge=_ELEMENT, fine=fine)
        held = np.zeros(len(solid.nodes), dtype=bool)
        held[solid.facets[(solid.nodes[solid.facets][:, :, 2] < height + 1e-6).all(axis=1)]] = True
        truth = Truth(
            make_body(solid, held, shear_modulus=SHEAR_MODULUS, poisson_ratio=POISSON_RATIO)
        )
        moved = [
            truth.at(truth.displacement(*push, PATCH), points)
            for push in zip(position, force, strict=True)
        ]
        np.savez(file, place=position, force=force, points=points, moved=moved)
    with np.load(file) as stored:
        return Pressed(**stored)


def scanned(folder: Path, file: Path, shape: str, vertices: int, support: Plane) -> TriangleMesh:
    """The mesh that `palpate scan` makes of the turntable; made once."""
    if not file.exists():
        scan = read_scan(turntable(folder, shape) / "scan.toml")
        made = scan_surface(scan.views, vertices=vertices, support=support)
        write_mesh(file, made.mesh)
    return read_mesh(file)


def session(
    shape: str, mesh: TriangleMesh, body: Pressed, errors: ErrorPriors, noise: float
) -> Session:
    """What was measured, with one of the meshes."""
    rng = np.random.default_rng(1)
    heights = mesh.vertices[mesh.triangles][:, :, 2].max(axis=1)
    foot = heights < heights.min() + _FOOT
    surface = closest_points(mesh, body.points)
    probings = []
    for k, (position, force, moved) in enumerate(
        zip(body.place, body.force, body.moved, strict=True)
    ):
        sigma = noise * float(np.sqrt((moved**2).mean()))
        seen = moved + sigma * rng.normal(size=moved.shape)
        std = np.full_like(seen, sigma) if noise else None
        point = closest_points(mesh, position[None]).position[0]
        field = DisplacementField(surface.position, seen, std, None, surface, "truth")
        probings.append(
            Probing(f"n{k}", Contact(point, PATCH, "smooth"), force, None, None, None, field, None)
        )
    held = np.flatnonzero(foot)
    return Session(shape, Path(), mesh, held, tuple(probings), None, None, None, (), errors=errors)


def shape_figures(folder: Path, shape: str, vertices: int, *, on_foot: bool) -> list[Figure]:
    """Constants on the scan of one shape against those on its exact mesh."""
    support, mark = support_of(shape, on_foot), "_foot" * on_foot
    body = pressed(shape, folder / f"{shape}{mark}_pressed.npz", support)
    scan = scanned(folder, folder / f"{shape}{mark}_{vertices}.ply", shape, vertices, support)
    true = true_mesh(shape, vertices, support)
    figures = []
    for name, errors, noise in (("clean", EXACT, 0.0), ("noise of 1 %", ErrorPriors(), _NOISE)):
        before, after = (
            fit_session(
                session(shape, mesh, body, errors, noise), cache=folder / "integrals"
            ).estimate
            for mesh in (true, scan)
        )
        note = f"{_said('true', true, before)}; {_said('scanned', scan, after)}"
        young = 100 * (after.young_modulus.value / before.young_modulus.value - 1.0)
        ratio = after.poisson_ratio.value - before.poisson_ratio.value
        what = f"fit on the scan of the {shape}{' down on its foot' * on_foot}, {name}"
        figures += [
            Figure(DOOR, f"{what}: E against the true mesh", abs(young), "%",
                   note=f"{young:+.2f} %. {note}"),
            Figure(DOOR, f"{what}: nu against the true mesh", abs(ratio), note=f"{ratio:+.4f}"),
        ]  # fmt: skip
    return figures


def _said(name: str, mesh: TriangleMesh, estimate: Estimate) -> str:
    """One estimate against the truth."""
    young, ratio = estimate.young_modulus, estimate.poisson_ratio
    true = 2.0 * SHEAR_MODULUS * (1.0 + POISSON_RATIO)
    return (
        f"{name}, {len(mesh.vertices)} vertices: E {100 * (young.value / true - 1):+.2f} %"
        f" (+- {100 * young.std / true:.2f}), nu {ratio.value - POISSON_RATIO:+.4f}"
        f" (+- {ratio.std:.4f})"
    )


def measure(options: Options) -> list[Figure]:
    """The half ball, and the toy held where it is widest."""
    shapes, vertices = (("half-ball",), 300) if options.quick else (tuple(RADIUS), _VERTICES)
    folder = MADE / "turntables"
    return [
        figure
        for shape in shapes
        for figure in shape_figures(folder, shape, vertices, on_foot=False)
    ]


def main() -> None:
    """Print all figures."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.scanned_constants", description=__doc__
    )
    parser.add_argument("folder", type=Path, nargs="?", default=MADE / "turntables")
    parser.add_argument("--vertices", type=int, default=_VERTICES)
    parser.add_argument("--shape", choices=tuple(RADIUS))
    parser.add_argument("--on-foot", action="store_true", help="hold the toy by its own foot")
    options = parser.parse_args()
    for shape in [options.shape] if options.shape else RADIUS:
        figures = shape_figures(options.folder, shape, options.vertices, on_foot=options.on_foot)
        print(with_notes(figures), flush=True)


if __name__ == "__main__":
    main()
