"""Preview of a session that is not yet measured: what its cameras will see."""

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
from palpate.lab.arm import aim, rod_at
from palpate.lab.config import Arm, LabConfig, Look, Material, Pictures, Probe, Specimen
from palpate.lab.facility import AT_REST, check_picture_names
from palpate.lab.scene import Variant
from palpate.lab.studio import make_studio, photograph
from palpate.records import Probing, Rig, Session, read_rig
from palpate.shapes import Vertices

# Speckle diameter that is matched best [px].
_SPECKLE_PX = 4.0
# Contact profiles of a flat tool; all others are attributed to a ball.
_PUNCHES = ("flat", "uniform")
# Largest radius of a ball, in contact radii. With guessed constants Hertz' formula may give a
# larger one, which would occlude far more than any real tool.
_LARGEST_BALL = 4.0


def planned_pictures(
    session: Session,
    displacements: Sequence[Vertices],
    *,
    material: Material,
    pictures: Pictures = Pictures(),
    variant: Variant,
) -> Iterator[tuple[str, tuple[UInt[np.ndarray, "_ _"], ...]]]:
    """Render the pictures of all cameras at rest, and of each probing at full force.

    The object carries a speckle pattern of four pixels. A flat tool is drawn as a punch, any other
    as a ball on a shaft of at most 4 mm radius: with the probing's tool radius, or else the radius
    that gives its contact radius under its force (Hertz). A contact without radius has no tool.

    Parameters
    ----------
    session : Session               with a rig whose cameras have picture sizes
    displacements : sequence of (v, 3) float [m]    of the mesh's vertices in each probing
    material : Material             assumed constants, from which radii of balls follow
    pictures : Pictures             exposure, image sensor and lens
    variant : Variant               of Mitsuba

    Yields
    ------
    name, pictures                  "rest", then each probing's name; a tuple of (rows, columns)
                                    uint8 or uint16, one for each camera

    Raises
    ------
    InputError                      no rig; a contact that is not on the object; pictures that would
                                    have one name
    """
    if session.rig is None:
        raise InputError(f'{session.path}: has no cameras; add [rig] cameras = "rig.toml"')
    rig = read_rig(session.rig)
    check_picture_names([probing.name for probing in session.probings], rig)
    rods = [
        _rod(session, probing, displacement, material, rig)
        for probing, displacement in zip(session.probings, displacements, strict=True)
    ]
    studio = make_studio(
        _as_config(session, rig, material, pictures), rig, variant, rng=np.random.default_rng(1)
    )
    rest = studio.mesh.vertices
    nodes = displacement_nodes(session.mesh, split_sides(session.mesh, _one_side(session.mesh)))
    closest = closest_points(session.mesh, rest)
    interpolation = interpolation_matrix(nodes, closest.triangle, closest.barycentric)
    rng = np.random.default_rng(2)
    yield AT_REST, photograph(studio, [rest], rng=rng)
    for probing, displacement, rod in zip(session.probings, displacements, rods, strict=True):
        yield probing.name, photograph(studio, [rest + interpolation @ displacement], rod, rng=rng)


def _one_side(mesh: TriangleMesh) -> np.ndarray:
    """One label for all triangles: the displacement is continuous across creases."""
    return np.zeros(len(mesh.triangles), dtype=np.int64)


def _rod(
    session: Session, probing: Probing, displacement: Vertices, material: Material, rig: Rig
) -> TriangleMesh | None:
    """The arm's rod at a probing's displaced contact; None for a contact without radius."""
    contact = probing.contact
    if contact.radius is None:
        return None
    mesh = session.mesh
    probe = Probe(probing.name, contact.point, probing.force, depth=1.0)
    tip = aim(probe, _arm(probing, material), mesh, rng=np.random.default_rng(0))
    closest = closest_points(mesh, contact.point[None])
    corners = mesh.triangles[closest.triangle[0]]
    depth = float(closest.barycentric[0] @ displacement[corners] @ tip.direction)
    return rod_at(tip, tip.point + depth * tip.direction, rig.cameras)


def _arm(probing: Probing, material: Material) -> Arm:
    """The tool of a contact, or the one that its patch suggests."""
    contact, touched = probing.contact, float(probing.contact.radius or 0.0)
    is_flat = contact.profile in _PUNCHES
    if contact.tool is not None:
        return Arm(tip="punch" if is_flat else "sphere", radius=contact.tool.radius)
    if is_flat:
        return Arm(tip="punch", radius=touched)
    # Johnson, Contact Mechanics (1985), equation 4.22.
    modulus = material.young_modulus / (1.0 - material.poisson_ratio**2)
    ball = 4.0 * modulus * touched**3 / (3.0 * float(np.linalg.norm(probing.force)))
    return Arm(radius=float(np.clip(ball, touched, _LARGEST_BALL * touched)))


def _as_config(session: Session, rig: Rig, material: Material, pictures: Pictures) -> LabConfig:
    """A session's object and cameras as a configuration, meaningful only for rendering."""
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
