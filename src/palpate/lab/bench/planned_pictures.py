"""What the cameras of a session will see, before there is a picture."""

from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import UInt

from palpate.errors import InputError
from palpate.geometry import (
    TriangleMesh,
    closest_points,
    displacement_nodes,
    interpolation_matrix,
    split_sides,
)
from palpate.lab.bench.arm import aim, rod_at
from palpate.lab.bodies import TipName
from palpate.lab.config import Arm, LabConfig, Look, Material, Pictures, Probe, Specimen
from palpate.lab.pictures import Variant, make_studio, photograph
from palpate.records import FLAT, Probing, Rig, Session, read_rig
from palpate.shapes import Vertices

# A speckle of so many pixels is best matched.
_SPECKLE_PX = 4.0
# Profiles of a flat tool; all others are taken for a ball's.
_PUNCHES = (FLAT, "uniform")
# Of the circle that it touches: a ball that seems larger, for its constants are a guess, would hide
# what no tool hides.
_LARGEST_BALL = 4.0


def planned_pictures(
    session: Session,
    moved: Sequence[Vertices],
    *,
    material: Material,
    pictures: Pictures = Pictures(),
    variant: Variant,
) -> Iterator[tuple[str, tuple[UInt[np.ndarray, "_ _"], ...]]]:
    """Pictures of all cameras at rest, and of each probing at its full force.

    The object carries a speckle of four pixels. A flat tool is a punch, any other a ball on a shaft
    of at most 4 mm radius: the ball that the probing names, or that touches its circle under its
    force (Hertz). Where the patch has no radius, there is no tool to be seen.

    Parameters
    ----------
    session : Session               with a rig whose cameras have sizes
    moved : sequence of (v, 3) float [m]    displacement of the mesh's vertices in each probing
    material : Material             a guess: balls follow from it
    pictures : Pictures             how they are taken
    variant : Variant               of Mitsuba

    Yields
    ------
    name, pictures                  `rest`, then each probing's name; (rows, columns) uint8 for
                                    every camera

    Raises
    ------
    InputError                      no rig; a contact that is not on the object
    """
    if session.rig is None:
        raise InputError(f'{session.path}: has no cameras; add [rig] cameras = "rig.toml"')
    rig = read_rig(session.rig)
    rods = [
        _rod(session, probing, displacement, material, rig)
        for probing, displacement in zip(session.probings, moved, strict=True)
    ]
    studio = make_studio(
        _as_config(session, rig, material, pictures), rig, variant, rng=np.random.default_rng(1)
    )
    rest = studio.mesh.vertices
    nodes = displacement_nodes(session.mesh, split_sides(session.mesh, _one_side(session.mesh)))
    place = closest_points(session.mesh, rest)
    carried = interpolation_matrix(nodes, place.triangle, place.barycentric)
    rng = np.random.default_rng(2)
    yield "rest", photograph(studio, [rest], rng=rng)
    for probing, displacement, rod in zip(session.probings, moved, rods, strict=True):
        yield probing.name, photograph(studio, [rest + carried @ displacement], rod, rng=rng)


def _one_side(mesh: TriangleMesh) -> np.ndarray:
    """No triangle is told from another: displacement is continuous over creases."""
    return np.zeros(len(mesh.triangles), dtype=np.int64)


def _rod(
    session: Session, probing: Probing, moved: Vertices, material: Material, rig: Rig
) -> TriangleMesh | None:
    """The arm's rod where it presses a probing's contact in; None where no round patch is."""
    contact = probing.contact
    if contact.radius is None:
        return None
    mesh = session.mesh
    probe = Probe(probing.name, contact.point, probing.force, depth=1.0)
    tip = aim(probe, _arm(probing, material), mesh, rng=np.random.default_rng(0))
    place = closest_points(mesh, contact.point[None])
    corners = mesh.triangles[place.triangle[0]]
    depth = float(place.barycentric[0] @ moved[corners] @ tip.direction)
    return rod_at(tip, tip.point + depth * tip.direction, rig.cameras)


def _arm(probing: Probing, material: Material) -> Arm:
    """The tool that a contact's patch belongs to."""
    contact, touched = probing.contact, float(probing.contact.radius or 0.0)
    shape: TipName = "punch" if contact.profile in _PUNCHES else "sphere"
    if contact.tool is not None:
        return Arm(tip=shape, radius=contact.tool.radius)
    if shape == "punch":
        return Arm(tip=shape, radius=touched)
    # Johnson, Contact Mechanics (1985), equation 4.22.
    modulus = material.young_modulus / (1.0 - material.poisson_ratio**2)
    ball = 4.0 * modulus * touched**3 / (3.0 * float(np.linalg.norm(probing.force)))
    return Arm(tip=shape, radius=float(np.clip(ball, touched, _LARGEST_BALL * touched)))


def _as_config(session: Session, rig: Rig, material: Material, pictures: Pictures) -> LabConfig:
    """A session's object and cameras as the facility's: only what pictures need is meant."""
    mesh, camera = session.mesh, rig.cameras[rig.reference]
    depth = float(
        np.median(mesh.vertices @ camera.T_camera_object[2, :3]) + camera.T_camera_object[2, 3]
    )
    return LabConfig(
        name=session.name,
        specimen=Specimen(mesh, mesh, session.held_triangles, {}, depth),
        material=material,
        look=Look(size=_SPECKLE_PX * depth / float(camera.matrix[0, 0])),
        pictures=pictures,
        probes=tuple(
            Probe(probing.name, probing.contact.point, depth=1.0) for probing in session.probings
        ),
    )
