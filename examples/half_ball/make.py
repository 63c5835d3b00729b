"""Makes the half ball example: finite elements of our own, far from any boundary element code.

    python examples/half_ball/make.py            # about five minutes; rewrites the files beside it

A half ball (radius 30 mm, flat face clamped) is filled with curved hexahedra: a rounded block in
the middle, shells around it up to the true sphere. Each carries tensor-product Lagrange
polynomials (order 3), and conjugate gradients solve all probings side by side. Only NumPy and
SciPy are needed. `--check` solves a coarser mesh and a lower order too and prints how far the
displacements move.
"""

import argparse
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.sparse import coo_matrix, diags, identity, kron
from scipy.sparse.linalg import splu

HERE = Path(__file__).parent
RADIUS, YOUNG_MODULUS, POISSON_RATIO = 0.030, 60e3, 0.30
PATCH_RADIUS = 0.0055
BLOCK = 0.42  # half the width of the block in the middle, in radii
# name, polar angle and azimuth of the contact [degree], force [N], tilt off the inward normal
PROBES = (
    ("p1", 0.0, 0.0, 0.75, (4.0, 30.0)),
    ("p2", 25.0, 60.0, 0.70, (5.0, 140.0)),
    ("p3", 30.0, 190.0, 0.70, (3.0, 260.0)),
    ("p4", 45.0, 310.0, 0.60, (6.0, 20.0)),
    ("p5", 55.0, 100.0, 0.55, (4.0, 330.0)),
    ("p6", 60.0, 240.0, 0.50, (7.0, 80.0)),
)
CAMERA = np.array([0.25, -0.45, 0.86])  # the points are seen from here
OBSERVED, MISSING, GROSS = 240, 0.05, 0.02
FORCE_NOISE, NOISE, TIP_NOISE = 0.01, (3e-5, 3e-5, 5e-5), 5e-5  # relative; m; m


@dataclass(frozen=True, slots=True)
class Hexahedra:
    """Curved hexahedra of order p: `nodes` (n, 3) and `cells` (m, (p+1)^3), x fastest last."""

    nodes: np.ndarray
    cells: np.ndarray
    order: int


def lagrange(order: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Values and slopes (len(at), order + 1) of Lagrange polynomials on equal steps of [0, 1]."""
    knots = np.linspace(0.0, 1.0, order + 1)
    value = np.ones((len(at), order + 1))
    slope = np.zeros_like(value)
    for i in range(order + 1):
        others = np.delete(knots, i)
        scale = np.prod(knots[i] - others)
        value[:, i] = np.prod(at[:, None] - others, axis=1) / scale
        for j in range(order):
            slope[:, i] += np.prod(at[:, None] - np.delete(others, j), axis=1) / scale
    return value, slope


def sphere_direction(cube: np.ndarray) -> np.ndarray:
    """Unit directions of points on the surface of the cube [-1, 1]^3, in equal angles a side."""
    angle = np.tan(np.pi / 4 * cube)
    return angle / np.linalg.norm(angle, axis=-1, keepdims=True)


def ball_point(cube: np.ndarray, depth: np.ndarray, radius: float) -> np.ndarray:
    """Points between the block (`depth` 0, where `cube` may lie inside) and the sphere (1)."""
    largest = np.abs(cube).max(axis=-1, keepdims=True)
    on_cube = cube / np.where(largest > 0, largest, 1.0)
    on_cube = np.where(largest > 0, on_cube, [0.0, 0.0, 1.0])  # any: weighted by zero below
    depth = depth[..., None]
    return radius * ((1 - depth) * BLOCK * cube + depth * sphere_direction(on_cube))


def half_ball(sides: int, shells: int, order: int, *, radius: float) -> Hexahedra:
    """Half ball z >= 0 of `sides` cells across the block and `shells` layers around it."""
    fine = np.linspace(-1, 1, sides * order + 1)
    half = np.linspace(0, 1, (sides // 2) * order + 1)
    out = np.linspace(0, 1, shells * order + 1)
    out = graded(out, shells)
    blocks = []
    x, y, z = np.meshgrid(fine, fine, half, indexing="ij")
    blocks.append(ball_point(np.stack([x, y, z], -1), np.zeros_like(x), radius))
    x, y, t = np.meshgrid(fine, fine, out, indexing="ij")
    blocks.append(ball_point(np.stack([x, y, np.ones_like(x)], -1), t, radius))
    x, z, t = np.meshgrid(fine, half, out, indexing="ij")
    one = np.ones_like(x)
    blocks += [
        ball_point(np.stack(sides_of, -1), t, radius)
        for sides_of in ((x, one, z), (-x, -one, z), (one, -x, z), (-one, x, z))
    ]
    return merged([as_cells(block, order) for block in blocks], order)


def graded(out: np.ndarray, shells: int) -> np.ndarray:
    """Layers that grow thinner toward the sphere, equal steps inside a layer."""
    steps = np.linspace(0, 1, shells + 1)
    return np.interp(out, steps, 1 - (1 - steps) ** 1.5)


def as_cells(block: np.ndarray, order: int) -> np.ndarray:
    """Node positions (cells, (p+1)^3, 3) of the cells of a structured block."""
    steps = [(size - 1) // order for size in block.shape[:3]]
    local = np.arange(order + 1)
    cells = [
        block[np.ix_(i * order + local, j * order + local, k * order + local)].reshape(-1, 3)
        for i in range(steps[0])
        for j in range(steps[1])
        for k in range(steps[2])
    ]
    return np.array(cells)


def merged(blocks: list[np.ndarray], order: int) -> Hexahedra:
    """One mesh of all blocks, nodes at one place made one."""
    positions = np.concatenate(blocks)
    key = np.round(positions.reshape(-1, 3) / 1e-8).astype(np.int64)
    _, first, number = np.unique(key, axis=0, return_index=True, return_inverse=True)
    nodes = positions.reshape(-1, 3)[first]
    return Hexahedra(nodes, number.reshape(len(positions), -1), order)


def stiffness(mesh: Hexahedra, young_modulus: float, poisson_ratio: float) -> np.ndarray:
    """Element matrices (cells, 3k, 3k) of linear elasticity, full Gauss quadrature."""
    shear = young_modulus / (2 * (1 + poisson_ratio))
    bulk = 2 * shear * poisson_ratio / (1 - 2 * poisson_ratio)
    point, weight = np.polynomial.legendre.leggauss(mesh.order + 2)
    value, slope = lagrange(mesh.order, 0.5 * (point + 1))
    parts = [(slope, value, value), (value, slope, value), (value, value, slope)]
    local = np.stack(
        [np.einsum("ai,bj,ck->abcijk", *p).reshape(len(point) ** 3, -1) for p in parts], -1
    )
    weights = np.einsum("a,b,c->abc", weight, weight, weight).ravel() / 8
    k = local.shape[1]
    matrices = np.empty((len(mesh.cells), 3 * k, 3 * k))
    for e, cell in enumerate(mesh.cells):
        jacobian = np.einsum("qkr,kx->qxr", local, mesh.nodes[cell])
        volume = np.linalg.det(jacobian)
        if volume.min() * volume.max() <= 0:
            raise ValueError(f"cell {e} is folded over; change the blend in ball_point")
        gradient = np.einsum("qkr,qrx->kxq", local, np.linalg.inv(jacobian)).reshape(3 * k, -1)
        gram = ((gradient * (weights * np.abs(volume))) @ gradient.T).reshape(k, 3, k, 3)
        matrix = bulk * gram + shear * gram.transpose(0, 3, 2, 1)
        trace = shear * np.einsum("axbx->ab", gram)
        for i in range(3):
            matrix[:, i, :, i] += trace
        matrices[e] = matrix.reshape(3 * k, 3 * k)
    return matrices


def assembled(mesh: Hexahedra, matrices: np.ndarray):
    """Sparse stiffness of all cells."""
    rows = (3 * mesh.cells[:, :, None] + np.arange(3)).reshape(len(mesh.cells), -1)
    n, k = 3 * len(mesh.nodes), rows.shape[1]
    left = np.repeat(rows, k, axis=1).ravel().astype(np.int32)
    right = np.tile(rows, (1, k)).ravel().astype(np.int32)
    return coo_matrix((matrices.ravel(), (left, right)), shape=(n, n)).tocsr()


def patch_load(mesh: Hexahedra, centre: np.ndarray, patch: float, radius: float) -> np.ndarray:
    """Nodal weights (n,) of a unit force spread as (1 - s^2)^2 over the patch, s = chord/patch."""
    width = mesh.order + 1
    faces = mesh.cells.reshape(-1, width, width, width)[..., -1]
    corners = mesh.nodes[faces]
    outside = np.abs(np.linalg.norm(corners, axis=-1) - radius).max(axis=(1, 2)) < 1e-9
    near = np.linalg.norm(corners - centre, axis=-1).min(axis=(1, 2)) < patch + 0.1 * radius
    point, weight = np.polynomial.legendre.leggauss(24)
    value, slope = lagrange(mesh.order, 0.5 * (point + 1))
    load = np.zeros(len(mesh.nodes))
    for face, corner in zip(faces[outside & near], corners[outside & near], strict=True):
        position = np.einsum("ai,bj,ijx->abx", value, value, corner)
        along = np.einsum("ai,bj,ijx->abx", slope, value, corner)
        across = np.einsum("ai,bj,ijx->abx", value, slope, corner)
        area = np.linalg.norm(np.cross(along, across), axis=-1) * np.outer(weight, weight) / 4
        s2 = ((position - centre) ** 2).sum(-1) / patch**2
        pressure = np.where(s2 < 1, (1 - s2) ** 2, 0.0) * area
        np.add.at(load, face, np.einsum("ab,ai,bj->ij", pressure, value, value))
    return load / load.sum()


def corner_interpolation(mesh: Hexahedra):
    """Sparse (3n, 3c): nodal values of a field that is trilinear in each cell, from its corners."""
    hat, _ = lagrange(1, np.linspace(0, 1, mesh.order + 1))
    local = np.einsum("ai,bj,ck->abcijk", hat, hat, hat).reshape(mesh.cells.shape[1], 8)
    corners = mesh.cells[:, (local > 1 - 1e-12).argmax(axis=0)]
    used, corners = np.unique(corners, return_inverse=True)
    corners = corners.reshape(-1, 8)
    shape = (len(mesh.nodes), len(used))
    rows = np.broadcast_to(mesh.cells[:, :, None], (*mesh.cells.shape, 8)).ravel()
    cols = np.broadcast_to(corners[:, None, :], (*mesh.cells.shape, 8)).ravel()
    weight = np.broadcast_to(local, (*mesh.cells.shape, 8)).ravel()
    summed = coo_matrix((weight, (rows, cols)), shape=shape).tocsr()
    count = coo_matrix((np.ones_like(weight) / 8, (rows, cols)), shape=shape).tocsr()
    share = np.asarray(count.sum(axis=1)).ravel()  # cells around a node, each wrote its weights
    return kron(diags(1 / share) @ summed, identity(3)).tocsr()


def solved(matrix, load, free, coarse, *, tolerance: float = 1e-8) -> np.ndarray:
    """Conjugate gradients, all columns side by side, zero where not free.

    Preconditioner: the diagonal plus an exact solve in the trilinear fields (`coarse`).
    """
    matrix, coarse = matrix[free][:, free], coarse[free]
    coarse = coarse[:, np.asarray(abs(coarse).sum(axis=0)).ravel() > 0]
    small = splu((coarse.T @ matrix @ coarse).tocsc())
    scale = 1.0 / matrix.diagonal()[:, None]
    u, r = np.zeros_like(load[free]), load[free].copy()
    p, rho = np.zeros_like(u), np.ones(u.shape[1])
    goal = tolerance * np.linalg.norm(r, axis=0)
    for _ in range(2000):
        z = scale * r + coarse @ small.solve(coarse.T @ r)
        rho, before = (r * z).sum(0), rho
        p = z + rho / before * p
        q = matrix @ p
        step = rho / (p * q).sum(0)
        u += step * p
        r -= step * q
        if (np.linalg.norm(r, axis=0) < goal).all():
            break
    else:
        raise RuntimeError("conjugate gradients did not converge in 2000 steps")
    full = np.zeros_like(load)
    full[free] = u
    return full


def sampled(mesh: Hexahedra, field: np.ndarray, points: np.ndarray, radius: float) -> np.ndarray:
    """Field (n, ...) at points of the sphere, by the cell's own polynomials in the angles."""
    width = mesh.order + 1
    faces = mesh.cells.reshape(-1, width, width, width)[..., -1]
    outside = np.abs(np.linalg.norm(mesh.nodes[faces], axis=-1) - radius).max(axis=(1, 2)) < 1e-9
    faces = faces[outside]
    cube = as_cube(mesh.nodes[faces].reshape(len(faces), -1, 3))
    result = np.empty((len(points), *field.shape[1:]))
    for i, point in enumerate(as_cube(points[:, None])[:, 0]):
        inside = (cube.min(axis=1) - 1e-9 <= point) & (point <= cube.max(axis=1) + 1e-9)
        face = np.flatnonzero(inside.all(axis=1))[0]
        corner = cube[face].reshape(width, width, 3)
        along, across = corner[-1, 0] - corner[0, 0], corner[0, -1] - corner[0, 0]
        offset = point - corner[0, 0]
        a, _ = lagrange(mesh.order, np.array([offset @ along / (along @ along)]))
        b, _ = lagrange(mesh.order, np.array([offset @ across / (across @ across)]))
        result[i] = np.einsum(
            "i,j,ij...->...", a[0], b[0], field[faces[face]].reshape(width, width, *field.shape[1:])
        )
    return result


def as_cube(points: np.ndarray) -> np.ndarray:
    """Points of the sphere on the cube in equal angles; a face's points share one face (k, n, 3)."""
    axis = np.abs(points.mean(axis=1, keepdims=True)).argmax(axis=-1, keepdims=True)
    largest = np.abs(np.take_along_axis(points, np.broadcast_to(axis, (*points.shape[:2], 1)), -1))
    return 4 / np.pi * np.arctan(points / largest)


def contacts() -> tuple[np.ndarray, np.ndarray]:
    """Contact points (k, 3) [m] and true forces (k, 3) [N] of the probings."""
    points, forces = [], []
    for _, polar, azimuth, force, (tilt, about) in PROBES:
        theta, phi, tilt, about = np.radians([polar, azimuth, tilt, about])
        normal = np.array([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)])
        across = np.array(
            [np.cos(theta) * np.cos(phi), np.cos(theta) * np.sin(phi), -np.sin(theta)]
        )
        along = np.cross(normal, across)
        aside = np.cos(about) * across + np.sin(about) * along
        points.append(RADIUS * normal)
        forces.append(force * (-np.cos(tilt) * normal + np.sin(tilt) * aside))
    return np.array(points), np.array(forces)


def displacements(sides: int, shells: int, order: int, at: np.ndarray, **body) -> np.ndarray:
    """Displacement (k, points, 3) of each probing at points of the sphere."""
    body = {
        "radius": RADIUS,
        "young_modulus": YOUNG_MODULUS,
        "poisson_ratio": POISSON_RATIO,
        "patch": PATCH_RADIUS,
        "contacts": contacts(),
    } | body
    mesh = half_ball(sides, shells, order, radius=body["radius"])
    matrix = assembled(mesh, stiffness(mesh, body["young_modulus"], body["poisson_ratio"]))
    load = np.stack(
        [
            np.outer(patch_load(mesh, point, body["patch"], body["radius"]), force).ravel()
            for point, force in zip(*body["contacts"], strict=True)
        ],
        axis=1,
    )
    free = np.repeat(mesh.nodes[:, 2] > 1e-9, 3)
    field = solved(matrix, load, free, corner_interpolation(mesh)).reshape(len(mesh.nodes), 3, -1)
    return sampled(mesh, field, at, body["radius"]).transpose(2, 0, 1)


def surface_mesh() -> tuple[np.ndarray, np.ndarray]:
    """Vertices (v, 3) [m] in rings on flat face and dome, and outward triangles (m, 3)."""
    rings = [(RADIUS * i / 8, 0.0, 6 * i) for i in range(9)]
    for angle in np.linspace(np.pi / 2, 0, 15)[1:]:
        rings.append((RADIUS * np.sin(angle), RADIUS * np.cos(angle), round(48 * np.sin(angle))))
    vertices, numbers = [], []
    for k, (r, z, count) in enumerate(rings):
        phi = 2 * np.pi * (np.arange(max(count, 1)) + 0.5 * (k % 2)) / max(count, 1)
        numbers.append(len(vertices) + np.arange(len(phi)))
        vertices += [(r * np.cos(p), r * np.sin(p), z) for p in phi]
    vertices = np.array(vertices)
    triangles = [t for pair in pairwise(numbers) for t in zipped(vertices, *pair)]
    return vertices, np.array(triangles)


def zipped(vertices: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> list[list[int]]:
    """Triangles between two rings: always the shorter of the two possible new edges."""
    if min(len(lower), len(upper)) > 1:  # begin at the nearest pair
        shift = np.argmin(np.linalg.norm(vertices[upper] - vertices[lower[0]], axis=1))
        upper = np.roll(upper, -shift)
    i = j = 0
    triangles = []
    n, m = len(lower) if len(lower) > 1 else 0, len(upper) if len(upper) > 1 else 0
    while i < n or j < m:
        a, b = lower[i % len(lower)], upper[j % len(upper)]
        next_a, next_b = lower[(i + 1) % len(lower)], upper[(j + 1) % len(upper)]
        reach_a = np.linalg.norm(vertices[next_a] - vertices[b]) if i < n else np.inf
        reach_b = np.linalg.norm(vertices[next_b] - vertices[a]) if j < m else np.inf
        if reach_a <= reach_b:
            triangles.append([a, next_a, b])
            i += 1
        else:
            triangles.append([a, next_b, b])
            j += 1
    return triangles


def seen_points() -> np.ndarray:
    """About `OBSERVED` points of the dome (n, 3) [m], evenly spread, as the camera sees them."""
    view = CAMERA / np.linalg.norm(CAMERA)
    k = np.arange(2 * OBSERVED) + 0.5
    z = 1 - k / len(k)
    phi = np.pi * (1 + 5**0.5) * k
    points = np.stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z], 1)
    points = points[(points @ view > 0.35) & (z > 0.06)]
    return RADIUS * points


def write_session(seen: np.ndarray, field: np.ndarray, tips: np.ndarray) -> None:
    """Noise on everything that is measured; session.toml, CSVs in mm, truth.toml."""
    rng = np.random.default_rng(2026)
    points, forces = contacts()
    text, truth = [SESSION], [TRUTH]
    for i, (name, *_) in enumerate(PROBES):
        size = np.linalg.norm(forces[i])
        force = forces[i] + FORCE_NOISE * size * rng.normal(size=3)
        tip = tips[i] + TIP_NOISE * rng.normal(size=3)
        free = np.linalg.norm(seen - points[i], axis=1) > 1.3 * PATCH_RADIUS
        moved = field[i][free] + NOISE * rng.normal(size=(free.sum(), 3))
        gross = rng.random(len(moved)) < GROSS
        moved[gross] += rng.uniform(3e-4, 1e-3, (gross.sum(), 1)) * unit(rng, gross.sum())
        moved[rng.random(len(moved)) < MISSING] = np.nan
        rows = np.hstack([seen[free], moved, np.broadcast_to(NOISE, moved.shape)]) * 1e3
        np.savetxt(
            HERE / f"{name}.csv", rows, "%.4f", ",", header="x,y,z,ux,uy,uz,sx,sy,sz", comments=""
        )
        text.append(
            PROBE.format(
                name=name,
                point=listed(1e3 * points[i]),
                radius=1e3 * PATCH_RADIUS,
                force=listed(force),
                force_std=FORCE_NOISE * size,
                tip=listed(1e3 * tip),
                tip_std=1e3 * TIP_NOISE,
            )
        )
        truth.append(
            f'\n[[probe]]\nname = "{name}"\nforce = {listed(forces[i])}\n'
            f"tip_displacement = {listed(1e3 * tips[i])}\n"
            f"outlier_rows = {np.flatnonzero(gross).tolist()}\n"
        )
    (HERE / "session.toml").write_text("".join(text))
    (HERE / "truth.toml").write_text("".join(truth))


def unit(rng: np.random.Generator, count: int) -> np.ndarray:
    """Random unit vectors (count, 3)."""
    vectors = rng.normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def listed(values: np.ndarray) -> str:
    """A vector as TOML, five decimals."""
    return "[" + ", ".join(f"{value:.5f}" for value in values) + "]"


def write_mesh() -> None:
    """mesh.ply in mm, as text."""
    vertices, triangles = surface_mesh()
    head = (
        f"ply\nformat ascii 1.0\ncomment half ball, radius 30, unit mm\n"
        f"element vertex {len(vertices)}\nproperty double x\nproperty double y\n"
        f"property double z\nelement face {len(triangles)}\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = [" ".join(f"{1e3 * x:.6f}" for x in v) for v in vertices]
    rows += ["3 " + " ".join(map(str, t)) for t in triangles]
    (HERE / "mesh.ply").write_text(head + "\n".join(rows) + "\n")


SESSION = """format = "palpate-session/1"
name = "half ball of 30 mm, six probings (computed, with noise)"

[object]
mesh = "mesh.ply"
length_unit = "mm"             # of the mesh and of every length below and in the CSVs

[support]
plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-3 }
"""
PROBE = """
[[probe]]
name = "{name}"
contact = {{ point = {point}, radius = {radius:g}, profile = "smooth" }}
force = {force}
force_std = {force_std:.5f}
tip_displacement = {tip}
tip_displacement_std = {tip_std:g}
displacement = "{name}.csv"
"""
TRUTH = f"""# What the half ball was made with; lengths in mm.
young_modulus = {YOUNG_MODULUS:g}
poisson_ratio = {POISSON_RATIO:g}
shear_modulus = {YOUNG_MODULUS / (2 * (1 + POISSON_RATIO)):.6g}
"""


def main() -> None:
    """Write the example; with --check also say how far coarser solutions are from it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--check", action="store_true", help="compare with coarser solutions")
    check = parser.parse_args().check
    seen, (points, _) = seen_points(), contacts()
    at = np.vstack([seen, points])
    best = displacements(12, 6, 3, at)
    write_mesh()
    write_session(
        seen,
        best[:, : len(seen)],
        best[np.arange(len(points)), len(seen) :][np.arange(len(points)), np.arange(len(points))],
    )
    for mesh in ((10, 5, 3), (12, 6, 2), (16, 8, 2)) if check else ():
        other = displacements(*mesh, at)
        for i, (name, *_) in enumerate(PROBES):
            free = np.linalg.norm(at - points[i], axis=1) > 1.3 * PATCH_RADIUS
            rms = np.linalg.norm((other - best)[i, free]) / np.linalg.norm(best[i, free])
            tip = np.linalg.norm((other - best)[i, len(seen) + i]) / np.linalg.norm(
                best[i, len(seen) + i]
            )
            print(
                f"{mesh} {name}: {100 * rms:.2f} % rms over the points, {100 * tip:.2f} % tip",
                flush=True,
            )


if __name__ == "__main__":
    main()
