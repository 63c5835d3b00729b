"""A rigid tool pressed far into soft bodies, by CalculiX: truth that is not ours.

CalculiX takes ten-node tetrahedra at finite strain and a tool of twenty-node hexahedra whose nodes
are moved; the surfaces meet face to face, without friction, by a penalty. Only where the nodes lie
is the facility's. The bodies are pressed in their plane of symmetry, y = 0, of which one half is
meshed. Run it with

    python -m benchmarks.calculix_press FOLDER [PRESS ...]

where `ccx` is installed; it writes what `benchmarks/data/calculix_press` holds.
"""

import itertools
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import manifold3d
import numpy as np
from jaxtyping import Float, Int

from benchmarks.bodies import BODIES
from palpate.geometry import TriangleMesh
from palpate.lab import half_ball
from palpate.records import FlatFace
from palpate.shapes import Points, Vector3
from palpate.solids import Solid, Tip, make_solid, surface_values
from palpate.solids.tetrahedra import FACES

SHEAR_MODULUS = 2e4
BALL = 10e-3
PUNCH = 6e-3
# C2 / C1 of the materials that stiffen, by Yeoh's law.
STIFFENING = 3.0
# Depths over the ball's radius.
DEPTHS = (0.2, 0.5)
# Depths of the ball and of the punch, whose forces are about 1 : 2 : 4 [m].
_BALL_DEPTHS, _PUNCH_DEPTHS = (1.6e-3, 2.4e-3, 3.6e-3), (0.9e-3, 1.5e-3, 2.5e-3)
# Edges of tetrahedra: away from the ball, and under it [m]; coarser and finer mesh.
MESHES = {"coarse": (9e-3, 2e-3), "fine": (7e-3, 1.4e-3)}
# Stiffness of the contact: its pressure over the depth to which surfaces pass each other is that of
# this many moduli a millimetre.
_PENALTY = 200.0
# The ball's cap: to either side of its pole, and elements along it.
_CAP, _ALONG = np.radians(62.0), 16
# Ten-node tetrahedra: numbers of the faces of `FACES` in CalculiX.
_FACE = np.array([1, 2, 4, 3])
# Nodes of a plane lie as near to it [m].
_FLAT = 1e-7
_MM = 1e3
_MPA = 1e-6


@dataclass(frozen=True, slots=True)
class Pressed:
    """A body, and where it is pressed.

    Attributes
    ----------
    surface : TriangleMesh          smooth
    poisson_ratio : float [-]
    point : (k, 3) float [m]        where the tool touches first
    inward : (k, 3) float           unit vectors of its motion
    depth : tuple of float [m]      of the tool, one after the other
    is_flat : bool                  pressed by the flat face of a punch; else by the ball
    stiffening : float              C2 / C1 of Yeoh's law
    """

    surface: TriangleMesh
    poisson_ratio: float
    point: Float[np.ndarray, "k 3"]
    inward: Float[np.ndarray, "k 3"]
    depth: tuple[float, ...] = tuple(each * BALL for each in DEPTHS)
    is_flat: bool = False
    stiffening: float = 0.0


def pressed_body(name: str) -> Pressed:
    """One of the bodies: `half_ball` of 40 mm, or `block` of 60 x 45 x 45 mm; the half ball under
    one of the tools, of a material that stiffens or not, is `ball_stiffens` and so on."""
    if name == "block":
        point = np.array([[4.0, 0.0, 45.0], [30.0, 0.0, 26.0]]) * 1e-3
        inward = np.array([[0.0, 0.0, -1.0], [-1.0, 0.0, 0.0]])
        return Pressed(BODIES["block"].make(5.2e-3), 0.4, point, inward)
    polar = np.radians([8.0, 55.0])
    up = np.stack([np.sin(polar), np.zeros(2), np.cos(polar)], axis=1)
    body = Pressed(half_ball(radius=40e-3, edge=1.5e-3), 0.3, 40e-3 * up, -up)
    if name == "half_ball":
        return body
    tool, material = name.split("_")
    is_flat = tool == "punch"
    return replace(
        body,
        point=body.point[:1],
        inward=body.inward[:1],
        depth=_PUNCH_DEPTHS if is_flat else _BALL_DEPTHS,
        is_flat=is_flat,
        stiffening=STIFFENING if material == "stiffens" else 0.0,
    )


def session_mesh(name: str) -> TriangleMesh:
    """The surface of about 600 vertices that estimates, and whose vertices are seen."""
    if name == "block":
        return BODIES["block"].make(5.2e-3)
    return half_ball(radius=40e-3, edge=5.0e-3)


def half(surface: TriangleMesh) -> TriangleMesh:
    """Its part of positive y, closed."""
    whole = manifold3d.Manifold(
        manifold3d.Mesh64(surface.vertices.copy(), surface.triangles.astype(np.uint64))
    )
    cut = whole.trim_by_plane((0.0, 1.0, 0.0), 0.0).to_mesh64()
    return TriangleMesh(cut.vert_properties[:, :3], cut.tri_verts.astype(np.int64))


def input_deck(solid: Solid, body: Pressed, number: int) -> tuple[str, Int[np.ndarray, " s"]]:
    """CalculiX's input, in millimetres, newtons and MPa, and the nodes whose motion it prints."""
    point, inward = body.point[number], body.inward[number]
    held, mirrored = (
        np.unique(solid.facets[(np.abs(solid.nodes[solid.facets][:, :, axis]) < _FLAT).all(axis=1)])
        for axis in (2, 1)
    )
    tool, cells = _tool(body, number)
    first = len(solid.nodes) + 1
    young = 2.0 * SHEAR_MODULUS * (1 + body.poisson_ratio) * _MPA
    faces = _faces_near(solid, point, 1.3 * BALL)
    shown = np.unique(solid.facets)
    lines = [
        "*NODE, NSET=BODY",
        *_table(1, _MM * solid.nodes),
        "*NODE, NSET=MOVED",
        *_table(first, _MM * tool),
        "*ELEMENT, TYPE=C3D10, ELSET=SOLID",
        *_table(1, solid.elements + 1),
        "*ELEMENT, TYPE=C3D20, ELSET=TOOL",
        *_table(len(solid.elements) + 1, cells + first),
        "*NSET, NSET=HELD",
        *(f"{node + 1}," for node in held),
        "*NSET, NSET=MIRROR",
        *(f"{node + 1}," for node in mirrored),
        "*NSET, NSET=SHOWN",
        *(f"{node + 1}," for node in shown),
        "*MATERIAL, NAME=SOFT",
        *_law(body),
        "*MATERIAL, NAME=STEEL",
        "*ELASTIC",
        "2e5, 0.3",
        "*SOLID SECTION, ELSET=SOLID, MATERIAL=SOFT",
        "*SOLID SECTION, ELSET=TOOL, MATERIAL=STEEL",
        "*SURFACE, NAME=SKIN, TYPE=ELEMENT",
        *(f"{element + 1}, S{face}" for element, face in faces),
        "*SURFACE, NAME=ROUND, TYPE=ELEMENT",
        *(f"{len(solid.elements) + 1 + k}, S1" for k in range(len(cells))),
        "*SURFACE INTERACTION, NAME=TOUCH",
        "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
        f"{_PENALTY * young:.12g}",
        "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE",
        "SKIN, ROUND",
        "*BOUNDARY",
        "HELD, 1, 3, 0.",
        "MIRROR, 2, 2, 0.",
    ]
    for depth in body.depth:
        moved = _MM * depth * inward
        lines += [
            "*STEP, NLGEOM, INC=400",
            "*STATIC",
            "0.1, 1., 1e-5, 0.2",
            "*BOUNDARY",
            *(f"MOVED, {axis + 1}, {axis + 1}, {moved[axis]:.12g}" for axis in range(3)),
            "*NODE PRINT, NSET=SHOWN, FREQUENCY=1000",
            "U",
            "*NODE PRINT, NSET=MOVED, TOTALS=ONLY, FREQUENCY=1000",
            "RF",
            "*END STEP",
        ]
    return "\n".join(lines) + "\n", shown


def _law(body: Pressed) -> list[str]:
    """Lines of the material: shape and volume apart, (J - 1)^2 alone for the volume."""
    bulk = 2.0 * SHEAR_MODULUS * (1 + body.poisson_ratio) / (3 * (1 - 2 * body.poisson_ratio))
    first, volume = 0.5 * SHEAR_MODULUS * _MPA, 2.0 / (bulk * _MPA)
    if not body.stiffening:
        return ["*HYPERELASTIC, NEO HOOKE", f"{first:.12g}, {volume:.12g}"]
    numbers = (first, body.stiffening * first, 0.0, volume, 1e9 * volume, 1e9 * volume)
    return ["*HYPERELASTIC, YEOH", ", ".join(f"{number:.12g}" for number in numbers)]


def _table(first: int, rows: np.ndarray) -> Iterator[str]:
    """Numbered rows, sixteen entries a line at most."""
    number = "d" if rows.dtype.kind == "i" else ".12g"
    for k, row in enumerate(rows):
        entries = [str(first + k), *(format(value, number) for value in row)]
        parts = [entries[i : i + 11] for i in range(0, len(entries), 11)]
        yield ",\n".join(", ".join(part) for part in parts)


def _faces_near(solid: Solid, point: Vector3, reach: float) -> Int[np.ndarray, "f 2"]:
    """Elements and CalculiX's numbers of the faces of the skin around a point."""
    faces = np.sort(solid.elements[:, FACES[:, :3]].reshape(-1, 3), axis=1)
    outer = {tuple(row) for row in np.sort(solid.facets[:, :3], axis=1).tolist()}
    middle = solid.nodes[faces].mean(axis=1)
    near = np.flatnonzero(np.linalg.norm(middle - point, axis=1) < reach)
    chosen = np.array([k for k in near if tuple(faces[k].tolist()) in outer])
    return np.stack([chosen // 4, _FACE[chosen % 4]], axis=1)


def _tool(body: Pressed, number: int) -> tuple[Points, Int[np.ndarray, "c 20"]]:
    """Nodes and twenty-node hexahedra of a layer whose outer face is half of the ball's cap, or of
    the punch's face."""
    point, pole = body.point[number], body.inward[number]
    across = np.array([0.0, 1.0, 0.0])
    along = np.cross(across, pole)
    x, y = np.meshgrid(
        np.linspace(-1.0, 1.0, 2 * _ALONG + 1), np.linspace(0.0, 1.0, _ALONG + 1), indexing="ij"
    )
    if body.is_flat:
        # The square becomes a disc.
        u, v = x * np.sqrt(1.0 - 0.5 * y**2), y * np.sqrt(1.0 - 0.5 * x**2)
        face = point + PUNCH * (u[..., None] * along + v[..., None] * across)
        grid = face - np.array([0.0, 1e-3, 2e-3])[:, None, None, None] * pole
    else:
        x, y = np.tan(_CAP * x), np.tan(_CAP * y)
        toward = pole + x[..., None] * along + y[..., None] * across
        toward /= np.linalg.norm(toward, axis=2, keepdims=True)
        radii = BALL * np.array([1.0, 0.9, 0.8])
        grid = point - BALL * pole + radii[:, None, None, None] * toward
    node = np.arange(grid[..., 0].size).reshape(grid.shape[:3])
    # Outer face first: its corners run so that the normal points into the layer.
    corner = [(0, 0), (0, 2), (2, 2), (2, 0)]
    side = [(0, 1), (1, 2), (2, 1), (1, 0)]
    node_indices = [(0, *c) for c in corner] + [(2, *c) for c in corner]
    node_indices += [(0, *c) for c in side] + [(2, *c) for c in side] + [(1, *c) for c in corner]
    starts = [(2 * i, 2 * j) for i in range(_ALONG) for j in range(_ALONG // 2)]
    cells = np.array([[node[r, i + p, j + q] for r, p, q in node_indices] for i, j in starts])
    used, cells = np.unique(cells, return_inverse=True)
    return grid.reshape(-1, 3)[used], cells.reshape(-1, 20)


def run(
    text: str, shown: Int[np.ndarray, " s"], count: int, depths: int
) -> tuple[list[Points], list[Vector3]]:
    """Displacement [m] of all nodes (zero where it is not printed), and the force of the tool on
    the body [N], at each depth."""
    program = shutil.which("ccx")
    if program is None:
        raise SystemExit("CalculiX (ccx) is not installed: there is nothing to compare with")
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "press.inp").write_text(text, encoding="ascii")
        done = subprocess.run([program, "press"], cwd=folder, capture_output=True, text=True)
        printed = (Path(folder) / "press.dat").read_text(encoding="ascii")
    if printed.count("total force") < depths:
        raise SystemExit("CalculiX found no equilibrium:\n" + done.stdout[-2000:])
    moved, forces = [], []
    for part in re.split(r"\n(?= displacements \(vx)", printed)[1:]:
        rows, total = part.split("total force")
        table = np.array([line.split() for line in rows.splitlines()[2:] if len(line.split()) == 4])
        nodal = np.zeros((count, 3))
        nodal[table[:, 0].astype(int) - 1] = table[:, 1:].astype(float) / _MM
        moved.append(nodal)
        half_force = np.array(total.splitlines()[2].split(), dtype=float)
        forces.append(np.array([2.0, 0.0, 2.0]) * half_force)
    return moved, forces


def presses() -> Iterator[str]:
    """Names of all: body, number of the press, mesh."""
    stiff = (f"{tool}_{law}" for tool in ("ball", "punch") for law in ("stiffens", "plain"))
    for mesh, name in itertools.product(MESHES, ("half_ball", "block", *stiff)):
        for number in range(len(pressed_body(name).point)):
            yield f"{name}-{number}-{mesh}"


def make_truth(name: str, number: int, mesh: str) -> dict[str, np.ndarray]:
    """What one press of one body does to the vertices of the session's mesh."""
    body, seen = pressed_body(name), session_mesh(name).vertices
    edge, small = MESHES[mesh]
    fine = [(body.point[number], 8e-3, small), *_rim_regions(body, number, small / 3.0)]
    solid = make_solid(half(body.surface), edge=edge, fine=fine)
    text, shown = input_deck(solid, body, number)
    moved, forces = run(text, shown, len(solid.nodes), len(body.depth))
    at = surface_values(solid, np.column_stack([seen[:, 0], np.abs(seen[:, 1]), seen[:, 2]]))
    side = np.stack([np.ones(len(seen)), np.where(seen[:, 1] < 0.0, -1.0, 1.0), np.ones(len(seen))])
    print(name, number, mesh, len(solid.nodes), "nodes", np.round(forces, 4).tolist(), flush=True)
    return {
        "position": seen,
        "displacement": np.stack([side.T * (at @ nodal) for nodal in moved]),
        "force": np.stack(forces),
    }


def _rim_regions(body: Pressed, number: int, edge: float) -> list[tuple[Vector3, float, float]]:
    """Where elements are finer yet: along the rim of a flat face, where pressure is unbounded."""
    if not body.is_flat:
        return []
    rim = Tip(FlatFace(PUNCH), body.point[number], body.inward[number]).rim(edge)
    return [(point, 0.2 * PUNCH, edge) for point in rim]


def main(folder: Path, wanted: Iterable[str]) -> None:
    """Make and write the truth of some presses."""
    for key in wanted:
        name, number, mesh = key.rsplit("-", 2)
        np.savez_compressed(folder / f"{key}.npz", **make_truth(name, int(number), mesh))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:] or presses())
