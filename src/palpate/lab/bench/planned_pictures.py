"""What the cameras of a session will see, before there is a picture."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import UInt8

from palpate.errors import InputError
from palpate.geometry import TriangleMesh
from palpate.lab.bench.arm import aim, rod_at
from palpate.lab.config import Arm, LabConfig, Look, Material, Probe, Specimen
from palpate.lab.pictures import Variant, make_studio, photograph
from palpate.records import Rig, Session, read_rig

# A speckle of so many pixels is best matched.
_SPECKLE_PX = 4.0


def planned_pictures(
    session: Session, *, variant: Variant
) -> Iterator[tuple[str, UInt8[np.ndarray, "_ _"]]]:
    """Pictures of every camera at rest, and with a tool at each contact.

    The object carries a speckle of four pixels; the tool is a ball on a shaft, as wide as the
    contact at least. Nothing is deformed.

    Parameters
    ----------
    session : Session               with a rig whose cameras have sizes
    variant : Variant               of Mitsuba

    Yields
    ------
    name, (rows, columns) uint8     `rest_c0`, then `n01_c0` and so on

    Raises
    ------
    InputError                      no rig; a contact that is not on the object
    """
    if session.rig is None:
        raise InputError(f'{session.path}: has no cameras; add [rig] cameras = "rig.toml"')
    rig = read_rig(session.rig)
    config = _as_config(session, rig)
    studio = make_studio(config, rig, variant, rng=np.random.default_rng(1))
    rest = studio.mesh.vertices
    rng = np.random.default_rng(2)
    for name, rod in _instants(session, config, rig):
        pictures = photograph(studio, [rest], rod, rng=rng)
        for camera, picture in zip(rig.cameras, pictures, strict=True):
            yield f"{name}_{camera.name}", picture


def _instants(
    session: Session, config: LabConfig, rig: Rig
) -> Iterator[tuple[str, TriangleMesh | None]]:
    """Rest, and each probing with its tool where it touches the object at rest."""
    yield "rest", None
    for probing in session.probings:
        arm = Arm(radius=max(config.arm.radius, probing.contact.radius or 0.0))
        probe = Probe(probing.name, probing.contact.point, probing.force, depth=1.0)
        tip = aim(probe, arm, session.mesh, rng=np.random.default_rng(0))
        yield probing.name, rod_at(tip, tip.point, rig.cameras)


def _as_config(session: Session, rig: Rig) -> LabConfig:
    """A session's object and cameras as the facility's: only what pictures need is meant."""
    mesh, camera = session.mesh, rig.cameras[rig.reference]
    depth = float(
        np.median(mesh.vertices @ camera.T_camera_object[2, :3]) + camera.T_camera_object[2, 3]
    )
    return LabConfig(
        name=session.name,
        specimen=Specimen(mesh, mesh, session.held_triangles, {}, depth),
        material=Material(1.0, 0.3),
        look=Look(size=_SPECKLE_PX * depth / float(camera.matrix[0, 0])),
        probes=tuple(
            Probe(probing.name, probing.contact.point, depth=1.0) for probing in session.probings
        ),
    )
