"""Sessions on a ball held at a cap, with displacements that the model itself says, and noise."""

from pathlib import Path

import numpy as np

from benchmarks.meshes import ball, cap
from palpate.bem import make_elastic_map
from palpate.geometry import closest_points, write_mesh
from palpate.pipeline import make_object_model
from palpate.records import (
    Contact,
    DisplacementField,
    Probing,
    Session,
    write_displacement,
)

RADIUS, CONTACT_RADIUS, CAP = 0.04, 0.006, -0.02  # m; the cap lies below z = CAP
SHEAR_MODULUS, POISSON_RATIO = 20e3, 0.3
NOISE = 3e-5  # m, 1 sigma
OBJECT = """format = "palpate-session/1"
name = "ball held at a cap"

[object]
mesh = "mesh.ply"
length_unit = "m"

[support]
box = {{ min = [-1, -1, -1], max = [1, 1, {cap}] }}
"""
PROBE = """
[[probe]]
name = "{name}"
contact = {{ point = {point}, radius = {radius}, profile = "smooth" }}
force = {force}
force_std = {force_std}
displacement = "{name}.csv"
"""


def write_ball_session(folder: Path, subdivisions: int, *, probings: int = 17) -> Path:
    """A session folder with noisy displacements at every free vertex away from the contact.

    Parameters
    ----------
    folder : Path             exists
    subdivisions : int        of the icosahedron: 3 is 642 vertices, 4 is 2562
    probings : int

    Returns
    -------
    Path                      the folder
    """
    session = _silent_session(subdivisions, probings)
    write_mesh(folder / "mesh.ply", session.mesh)
    text = [OBJECT.format(cap=CAP)]
    rng = np.random.default_rng(0)
    moved = _displacements(session)
    for probing, displacement in zip(session.probings, moved, strict=True):
        field = _observed(session, probing, displacement, rng)
        write_displacement(folder / f"{probing.name}.csv", field)
        text.append(
            PROBE.format(
                name=probing.name,
                point=probing.contact.point.tolist(),
                radius=CONTACT_RADIUS,
                force=probing.force.tolist(),
                force_std=0.01,
            )
        )
    (folder / "session.toml").write_text("".join(text), encoding="utf-8")
    return folder


def _silent_session(subdivisions: int, count: int) -> Session:
    """Contacts on a spiral over the upper half, forces a little off the inward normal."""
    mesh = ball(subdivisions, radius=RADIUS)
    height = 1 - (np.arange(count) + 0.5) / count * 0.8
    turn = np.arange(count) * np.pi * (3 - np.sqrt(5))
    across = np.sqrt(1 - height**2)
    outward = np.stack([across * np.cos(turn), across * np.sin(turn), height], axis=1)
    point = closest_points(mesh, RADIUS * outward).position
    tilt = 0.1 * np.stack([np.cos(turn), np.sin(turn), np.zeros(count)], axis=1)
    probings = tuple(
        Probing(
            name=f"n{k + 1:02d}",
            contact=Contact(point[k], CONTACT_RADIUS, "smooth"),
            force=tilt[k] - outward[k],
            force_std=None,
            tip_displacement=None,
            tip_displacement_std=None,
            displacement=None,
            images=None,
        )
        for k in range(count)
    )
    return Session("ball", Path(), mesh, cap(mesh, CAP), probings, None, None, None, ())


def _displacements(session: Session) -> list[np.ndarray]:
    """Exact displacement of every vertex in every probing, (v, 3) [m]."""
    model = make_object_model(session)
    elastic = make_elastic_map(
        model.system, shear_modulus=SHEAR_MODULUS, poisson_ratio=POISSON_RATIO
    )
    unit = elastic.solve(model.right.at(POISSON_RATIO)) / SHEAR_MODULUS
    return [
        elastic.state(unit[:, 3 * patch : 3 * patch + 3] @ probing.force).displacement
        for patch, probing in zip(model.loads.patch_of, session.probings, strict=True)
    ]


def _observed(
    session: Session, probing: Probing, displacement: np.ndarray, rng: np.random.Generator
) -> DisplacementField:
    vertices = session.mesh.vertices
    away = np.linalg.norm(vertices - probing.contact.point, axis=1) > 1.3 * CONTACT_RADIUS
    seen = np.flatnonzero(away & (vertices[:, 2] > CAP))
    noisy = displacement[seen] + NOISE * rng.normal(size=(seen.size, 3))
    return DisplacementField(
        points=vertices[seen],
        displacement=noisy,
        std=np.full((seen.size, 3), NOISE),
        vertex=seen,
        surface=closest_points(session.mesh, vertices[seen]),
        source="",
    )
