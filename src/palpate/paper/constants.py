"""The paper's table 3 on the virtual bench: constants from pictures and forces, and a compression
test of the same material beside them."""

from dataclasses import dataclass

import numpy as np

from palpate.estimation import FitResult
from palpate.lab import Material, Tip, cylinder, held_nodes, make_body, make_solid, press
from palpate.paper.motion import Method, PaperSession
from palpate.pipeline import fit_session, measure_motion, with_measured_displacement
from palpate.records import Session, read_toml

# A cylinder as one would cut it from foam [m], and the shortening of the test.
_RADIUS, _HEIGHT, _SHORTENED = 0.015, 0.03, 0.01
_ELEMENT = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class EstimatedConstants:
    """What a method's motion and the forces say of a specimen.

    Attributes
    ----------
    session : Session               with the displacements that were measured
    result : FitResult
    """

    session: Session
    result: FitResult


@dataclass(frozen=True, slots=True)
class CompressionTest:
    """A cylinder on a plate to which it sticks, under a plate without friction.

    Attributes
    ----------
    radius, height, shortening : float [m]
    force : float [N]
    young_modulus : float [Pa]      F l / (A shortening), the paper's formula
    """

    radius: float
    height: float
    shortening: float
    force: float
    young_modulus: float


def true_material(session: Session) -> Material:
    """What the specimen of a facility's session is made of.

    Parameters
    ----------
    session : Session               with truth.toml beside its file

    Raises
    ------
    RecordError                     it cannot be read
    """
    truth = read_toml(session.path.parent / "truth.toml")
    return Material(truth.number("young_modulus"), truth.number("poisson_ratio"))


def estimated_constants(measured: PaperSession, method: Method) -> EstimatedConstants:
    """Constants from the motion that a method saw.

    Parameters
    ----------
    measured : PaperSession         with probings
    method : Method                 one that was measured

    Raises
    ------
    InputError                      a motion that could not be measured
    """
    session = with_measured_displacement(measured.session, measured.found[method])
    return EstimatedConstants(session, fit_session(session))


def pictures_measured(session: Session) -> Session:
    """A facility's session with its motion by the default method, the pose as the session gives it.

    Parameters
    ----------
    session : Session

    Returns
    -------
    Session                         the same where every probing's motion is known

    Raises
    ------
    InputError                      a motion that could not be measured
    """
    if all(probing.displacement is not None for probing in session.probings):
        return session
    found = measure_motion(session, pose="given")
    return with_measured_displacement(session, found)


def compression_test(material: Material) -> CompressionTest:
    """Compress a cylinder of a material by one percent, in finite elements.

    Parameters
    ----------
    material : Material

    Returns
    -------
    CompressionTest                 the lower end sticks, so that it says a little too much

    Source
    ------
    Lang and Pai (2001), section 5: E = F l / (A dl).
    """
    mesh = cylinder(radius=_RADIUS, height=_HEIGHT, edge=_ELEMENT / 5.0)
    solid = make_solid(mesh.vertices, mesh.triangles, edge=_ELEMENT)
    base = np.flatnonzero((np.abs(mesh.vertices[mesh.triangles][:, :, 2]) < 1e-9).all(axis=1))
    body = make_body(
        solid,
        held_nodes(solid, base),
        shear_modulus=material.shear_modulus,
        poisson_ratio=material.poisson_ratio,
    )
    plate = Tip(2.0 * _RADIUS, np.array([0.0, 0.0, _HEIGHT]), np.array([0.0, 0.0, -1.0]), flat=True)
    shortening = _SHORTENED * _HEIGHT
    (state,) = press(body, plate, np.array([shortening]))
    force = float(-state.force[2])
    young = force * _HEIGHT / (np.pi * _RADIUS**2 * shortening)
    return CompressionTest(_RADIUS, _HEIGHT, shortening, force, young)
