"""Makes the half ball example: finite elements of our own, far from any boundary element code.

    python examples/half_ball/make.py            # about five minutes; rewrites the files beside it

A half ball (radius 30 mm, flat face clamped) is solved for six probings with `finite_elements.py`,
sampled where a camera would see it, and given noise. Only NumPy and SciPy are needed. `--check`
solves other meshes and another order too and prints how far the displacements move.
"""

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from finite_elements import (
    assembled,
    corner_interpolation,
    half_ball,
    patch_load,
    sampled,
    solved,
    stiffness,
)

HERE = Path(__file__).parent
RADIUS, YOUNG_MODULUS, POISSON_RATIO = 0.030, 60e3, 0.30
PATCH_RADIUS = 0.0055
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
