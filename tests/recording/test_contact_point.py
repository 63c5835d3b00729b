"""The contact from the motion of the surface, against finite elements and a rigid sphere."""

import numpy as np
import pytest
from surfaces import box

from palpate.errors import RecordError
from palpate.geometry import TriangleMesh
from palpate.recording.contact_point import ContactModel, find_contact, make_contact_model
from palpate.records import Sphere
from palpate.solids import Tip, held_nodes, make_body, make_solid, press_to_force, surface_values

_CONTACT = np.array([0.004, -0.003, 0.0])
_SIZE = np.array([0.05, 0.05, 0.025])


def _block(cells: int) -> TriangleMesh:
    mesh = box(size=tuple(_SIZE), cells=cells)
    return TriangleMesh(mesh.vertices - _SIZE * [0.5, 0.5, 1.0], mesh.triangles)


def _held(mesh: TriangleMesh) -> np.ndarray:
    low = mesh.vertices[:, 2] < -_SIZE[2] + 1e-9
    return np.flatnonzero(low[mesh.triangles].all(axis=1))


@pytest.fixture(scope="module")
def model() -> ContactModel:
    """The block, held from below, in boundary elements."""
    mesh = _block(6)
    return make_contact_model(mesh, _held(mesh))


def _pressing(contact: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """How points move under a sphere of 8 mm, its force, and the radius that it touches."""
    mesh = _block(5)
    solid = make_solid(mesh, edge=0.011, fine=((contact, 0.003, 0.0018),))
    body = make_body(solid, held_nodes(solid, _held(mesh)), shear_modulus=2e4, poisson_ratio=0.4)
    tip = Tip(Sphere(0.008), contact + np.array([0.0, 0.0, 0.008]), np.array([0.0, 0.0, -1.0]))
    state = press_to_force(body, tip, 0.5)
    return surface_values(solid, points) @ state.displacement, state.force, state.radius


@pytest.fixture(scope="module")
def pressed() -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Points beside a sphere, and their motion under it."""
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-0.022, 0.022, (700, 2)), np.zeros(700)])
    # The sphere's shaft hides its own place and all on one side of it.
    away = points - _CONTACT
    points = points[(np.linalg.norm(away, axis=1) > 0.006) & (away[:, 0] < 0.006)]
    return points, *_pressing(_CONTACT, points)


def test_a_pressed_block_shows_where(
    model: ContactModel, pressed: tuple[np.ndarray, np.ndarray, np.ndarray, float]
) -> None:
    points, moved, force, radius = pressed
    rng = np.random.default_rng(2)
    errors, claims = [], []
    for _ in range(3):
        seen = moved + 0.03 * np.abs(moved).max() * rng.standard_normal(moved.shape)
        point, std, explained = find_contact(
            model, points, seen, force, radius=radius, profile="hertz"
        )
        errors.append((point - _CONTACT)[:2])
        claims.append(std)
        # Noise is 3 % of the square; few Poisson's ratios and two coarse meshes leave twice that.
        assert explained > 0.87
    size = float(np.sqrt(np.mean(np.square(errors))))
    # A tenth of the touched radius: two methods and two coarse meshes are between truth and model.
    assert size < 3.5e-4
    assert size < 3.0 * float(np.mean(claims))


@pytest.mark.slow
def test_a_push_from_above_is_not_found_on_a_side(model: ContactModel) -> None:
    """Cameras see the side of the block alone, whose upper edge a sphere presses close by."""
    contact = np.array([0.017, 0.0, 0.0])
    rng = np.random.default_rng(1)
    across, up = rng.uniform(-0.022, 0.022, 300), rng.uniform(-0.02, -0.001, 300)
    points = np.column_stack([np.full(300, 0.025), across, up])
    moved, force, radius = _pressing(contact, points)
    point, _, _ = find_contact(model, points, moved, force, radius=radius, profile="hertz")
    assert point[2] == pytest.approx(0.0, abs=1e-12)
    # Points of one side tell less of how far from it the push is: half the touched radius.
    assert np.linalg.norm(point - contact) < 0.5 * radius


@pytest.mark.slow
def test_a_motion_from_nowhere_is_refused(
    model: ContactModel, pressed: tuple[np.ndarray, np.ndarray, np.ndarray, float]
) -> None:
    points, moved, force, radius = pressed
    noise = np.random.default_rng(2).standard_normal(moved.shape)
    with pytest.raises(RecordError, match="cannot be found"):
        find_contact(model, points, 1e-4 * noise, force, radius=radius, profile="hertz")
    with pytest.raises(RecordError, match="only 20 points"):
        find_contact(model, points[:20], moved[:20], force, radius=radius, profile="hertz")
