"""Finite elements of a half ball: curved hexahedra up to the true sphere, its flat face clamped.

A rounded block in the middle, shells around it up to the sphere. Each cell carries tensor-product
Lagrange polynomials of any order; conjugate gradients solve all loads side by side.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix, diags, identity, kron
from scipy.sparse.linalg import splu

BLOCK = 0.42  # half the width of the block in the middle, in radii


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
    unity = np.ones_like(x)
    blocks += [
        ball_point(np.stack(sides_of, -1), t, radius)
        for sides_of in ((x, unity, z), (-x, -unity, z), (unity, -x, z), (-unity, x, z))
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
    """Points of the sphere (k, n, 3) on the cube, equal angles; each k keeps to one side."""
    axis = np.abs(points.mean(axis=1, keepdims=True)).argmax(axis=-1, keepdims=True)
    largest = np.abs(np.take_along_axis(points, np.broadcast_to(axis, (*points.shape[:2], 1)), -1))
    return 4 / np.pi * np.arctan(points / largest)
