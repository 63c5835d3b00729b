"""Sessions on rollers: a block between platens without friction, exactly; what would slide away."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.errors import InputError
from palpate.geometry import closest_points
from palpate.pipeline import fit_session, make_object_model, poke_session, session_observations
from palpate.pipeline.model.supports import held_directions, rigid_modes, sliding_motion
from palpate.records import (
    EXACT,
    FREE,
    GIVEN,
    Contact,
    DisplacementField,
    Load,
    Probing,
    Session,
    Support,
)
from palpate.records.support import RigidMotion

# A block 20 mm wide and 30 mm high between two platens.
SIZE = np.array([0.02, 0.02, 0.03])
MESH = box(size=SIZE, cells=(3, 3, 4))
MIDDLE = MESH.vertices[MESH.triangles].mean(axis=1)
BOTTOM, TOP = (np.flatnonzero(np.abs(MIDDLE[:, 2] - z) < 1e-9) for z in (0.0, SIZE[2]))
UP = np.array([[0.0, 0.0, 1.0]])
SHEAR, NU = 2e4, 0.4
YOUNG = 2 * SHEAR * (1 + NU)
PRESS = 5.0
AXIS = np.array([0.01, 0.01, 0.0])
# Along the platen: a shift, and a turn about its normal.
SLID = np.array([3e-4, -1e-4, 0.0, 0.0, 0.0, 4e-3])


def shortened(points, force=PRESS, nu=NU, young=YOUNG):
    """Uniaxial compression, free to widen: the axis of the block and its foot stay."""
    return (points - AXIS) * np.array([nu, nu, -1.0]) * force / (SIZE[0] * SIZE[1] * young)


def session(*supports, points=None, moved=None, contact=None, force=(0.0, 0.0, -PRESS), **more):
    rng = np.random.default_rng(0)
    if points is None:
        points = rng.uniform(0.1, 0.9, (120, 3)) * SIZE
        points[:60, 0], points[60:, 1] = 0.0, SIZE[1]
    moved = shortened(points) if moved is None else moved(points)
    surface = closest_points(MESH, points)
    field = DisplacementField(points, moved, np.full_like(moved, 1e-6), None, surface, "n.csv")
    contact = contact or Contact(MIDDLE[TOP].mean(axis=0), None, "uniform", TOP)
    probing = Probing("n", contact, np.array(force), None, None, None, field, None, **more)
    held = np.sort(np.concatenate([support.triangles for support in supports]))
    return Session(
        "block", Path("block"), MESH, held, (probing,), None, None, None, (), supports=supports,
        errors=EXACT,
    )  # fmt: skip


def test_a_block_on_a_platen_without_friction():
    """Constants exact, and how the block slid along its platen."""

    def moved(points):
        return shortened(points) + rigid_modes(points, AXIS) @ SLID

    result = fit_session(session(Support(BOTTOM, directions=UP), moved=moved))
    estimate = result.estimate
    # Quadrature of 1e-6 an integral, of a field that the elements hold exactly.
    assert estimate.shear_modulus.value == pytest.approx(SHEAR, rel=1e-4)
    assert estimate.poisson_ratio.value == pytest.approx(NU, abs=1e-4)
    (slid,) = estimate.probes[0].supports
    # Told against the mean motion of the graded mesh's vertices, which are not quite even: a part
    # of what the block widens by.
    np.testing.assert_allclose((*slid.translation, *slid.rotation), SLID, atol=1e-5)
    assert np.abs(result.probes[0].residual).max() < 1e-8


def test_glued_to_the_platen_the_same_block_would_be_another():
    """The test above can fail: the same measurement means other constants where friction holds."""
    result = fit_session(session(Support(BOTTOM)))
    assert abs(result.estimate.poisson_ratio.value - NU) > 0.01
    # Residuals of 1e-8 m and less where the platen slides.
    assert np.abs(result.probes[0].residual).max() > 1e-6


def test_a_corner_of_three_rollers_needs_no_motion():
    """An eighth of a block by its symmetry: supports that touch, and nothing slides."""
    left, front = (np.flatnonzero(np.abs(MIDDLE[:, k]) < 1e-9) for k in (0, 1))
    x, y = np.eye(3)[:1], np.eye(3)[1:2]
    supports = [Support(t, directions=d) for t, d in ((BOTTOM, UP), (left, x), (front, y))]

    def moved(points):
        return shortened(points + AXIS)

    points = np.random.default_rng(1).uniform(0.1, 0.9, (80, 3)) * SIZE
    points[:40, 0], points[40:, 1] = SIZE[0], SIZE[1]
    given = session(*supports, points=points, moved=moved)
    assert sliding_motion(given) is None
    estimate = fit_session(given).estimate
    assert estimate.shear_modulus.value == pytest.approx(SHEAR, rel=1e-4)
    assert estimate.poisson_ratio.value == pytest.approx(NU, abs=1e-4)
    assert estimate.probes[0].supports == ()


@pytest.mark.parametrize("nu", [0.0, 0.45])
def test_a_platen_that_moves_takes_only_its_direction_with_it(nu):
    """Two platens, the upper one moves down and sideways: uniaxial compression all the same."""
    down = RigidMotion(np.array([5e-4, 0.0, -3e-4]), np.zeros(3))
    side = Contact(np.array([0.0, 0.01, 0.015]), 0.004, "smooth")
    given = session(
        Support(BOTTOM, directions=UP), Support(TOP, GIVEN, UP),
        contact=side, force=(1e-9, 0.0, 0.0), support_motion=down,
        moved=lambda points: np.zeros_like(points) + 1e-5,
    )  # fmt: skip
    with pytest.raises(InputError, match="shifts the object along x, which no support holds"):
        make_object_model(given)
    still = session(
        Support(BOTTOM, directions=UP), Support(TOP, GIVEN, UP),
        contact=side, force=(0.0, 0.0, -1e-9), support_motion=down,
    )  # fmt: skip
    model = make_object_model(still)
    (seen,) = session_observations(still, model)
    value = seen.response.value(nu)
    # Columns 4 to 9 are the motions of the upper platen, the last six those that slide.
    displacement = (value[:, 4:10] @ seen.motion[:6]).reshape(-1, 3)
    strain = 3e-4 / SIZE[2]
    exact = (seen.position - AXIS) * np.array([nu, nu, -1.0]) * strain
    away = (displacement - exact).ravel()
    slide = value[:, [10, 11, 15]]
    away -= slide @ np.linalg.lstsq(slide, away, rcond=None)[0]
    assert np.abs(away).max() < 1e-5 * np.abs(exact).max()


def test_a_poke_on_a_platen():
    """The platen answers with the whole force, and nothing but the force along its normal."""
    given = session(Support(BOTTOM, directions=UP))
    contact = Contact(np.array([0.012, 0.009, SIZE[2]]), 0.005, "smooth")
    inside = np.random.default_rng(2).uniform(0.1, 0.9, (50, 3)) * SIZE

    def poked(force):
        return poke_session(
            given, np.array(force), contact, shear_modulus=SHEAR, poisson_ratio=NU, interior=inside
        )

    estimate = poked([0.0, 0.0, -PRESS])
    np.testing.assert_allclose(estimate.reaction, [0.0, 0.0, PRESS], atol=1e-9)
    assert estimate.interior.displacement[:, 2].max() < 0.0
    with pytest.raises(InputError, match="the tool: 1 N of its force shifts the object along y"):
        poked([0.0, 1.0, 0.0])


def test_weight_and_pressure_along_the_platen_are_refused():
    given = replace(session(Support(BOTTOM, directions=UP)), density=1000.0)
    down, aside = np.array([0.0, 0.0, -9.81]), np.array([2.0, 0.0, -9.6])
    assert make_object_model(replace(given, gravity=down)).slides
    with pytest.raises(InputError, match=r"\[gravity\]: 0.024 N of its force shifts .* along x"):
        make_object_model(replace(given, gravity=aside))
    left = np.flatnonzero(np.abs(MIDDLE[:, 0]) < 1e-9)
    right = np.flatnonzero(np.abs(MIDDLE[:, 0] - SIZE[0]) < 1e-9)
    squeezed = [Load(Contact(MIDDLE[t].mean(axis=0), None, "uniform", t), pressure=1e3)
                for t in (left, right)]  # fmt: skip
    (probing,) = given.probings
    assert make_object_model(replace(given, probings=(replace(probing, loads=tuple(squeezed)),)))
    with pytest.raises(InputError, match="shifts the object along x"):
        make_object_model(replace(given, probings=(replace(probing, loads=(squeezed[0],)),)))


def test_a_turn_that_nothing_holds_is_refused():
    edge = Contact(np.array([0.02, 0.018, 0.015]), 0.002, "smooth")
    held_x = Support(BOTTOM, directions=np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]))
    given = session(held_x, contact=edge, force=(-1.0, 0.0, 0.0))
    assert held_directions(given)[0].tolist() == np.diag([1.0, 0.0, 1.0]).tolist()
    # Held along x and z over a face: it can shift along y only.
    assert (
        sliding_motion(given).free_projector.round(9).tolist()
        == np.diag([0, 1, 0, 0, 0, 0]).tolist()
    )
    fit = make_object_model(given)
    assert fit.slides
    rolling = session(Support(BOTTOM, directions=UP), contact=edge, force=(0.0, 0.0, -1.0))
    assert (
        sliding_motion(rolling).free_projector.round(9).tolist()
        == np.diag([1, 1, 0, 0, 0, 1]).tolist()
    )


@pytest.mark.slow
def test_a_free_roller_is_estimated_along():
    given = session(Support(BOTTOM, FREE, UP))
    estimate = fit_session(given).estimate
    assert estimate.shear_modulus.value == pytest.approx(SHEAR, rel=1e-3)


@pytest.mark.parametrize("directions", [None, UP])
def test_under_its_weight_what_is_held_does_not_move(directions):
    """The particular displacement of a body force is no displacement where the support answers."""
    corner = MESH.vertices[MESH.triangles[BOTTOM]].mean(axis=1)
    given = session(
        Support(BOTTOM, directions=directions), points=corner, moved=lambda x: 0 * x + 1e-5
    )
    given = replace(given, density=1000.0, gravity=np.array([0.0, 0.0, -9.81]))
    model = make_object_model(given)
    (seen,) = session_observations(given, model)
    weighed = seen.response.value(0.2)[:, 3].reshape(-1, 3)
    held = weighed[:, 2] if directions is not None else weighed
    # Beside 9.81e3 N/m^3 x (30 mm)^2: what the block sinks, times the shear modulus.
    assert np.abs(held).max() < 1e-9


def platens(force=(0.0, 0.0, -PRESS), upper=UP, lower=UP, motion=FREE, moved=None):
    pulled = Contact(MIDDLE[TOP].mean(axis=0), None, "rigid", TOP)
    supports = Support(BOTTOM, directions=lower), Support(TOP, motion, upper)
    return session(*supports, contact=pulled, force=force, moved=moved)


@pytest.mark.slow
def test_a_force_on_a_platen_without_friction():
    """Pressed by its upper platen the block is a column, whatever it slides on both."""

    def moved(points):
        return shortened(points) + rigid_modes(points, AXIS) @ SLID

    result = fit_session(platens(moved=moved))
    estimate = result.estimate
    assert estimate.shear_modulus.value == pytest.approx(SHEAR, rel=1e-4)
    assert estimate.poisson_ratio.value == pytest.approx(NU, abs=1e-4)
    assert np.abs(result.probes[0].residual).max() < 1e-8
    upper, _ = estimate.probes[0].supports
    # The shifts of what is pulled follow from the force, and a platen does not turn here.
    assert np.isnan(upper.translation).all()
    np.testing.assert_allclose(upper.rotation, 0.0, atol=1e-6)


def test_a_glued_grip_presses_otherwise():
    """The test above can fail: a grip that holds all directions keeps the end from widening."""
    glued = platens(upper=None, lower=None)
    assert abs(fit_session(glued).estimate.shear_modulus.value / SHEAR - 1.0) > 0.005


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"force": (1.0, 0.0, -5.0)}, "a roller, and 1 N of it are across its directions"),
        ({"upper": None}, r"along \((1, 0, 0|0, 1, 0)\) no other support holds the object"),
        ({"lower": np.eye(3)[:1]}, r"along \(0, 0, 1\) no other support holds the object"),
        ({"motion": "fixed"}, "whose motion is 'fixed'"),
    ],
)
def test_a_force_that_nothing_answers_is_refused(wrong, message):
    with pytest.raises(InputError, match=message):
        platens(**wrong)
