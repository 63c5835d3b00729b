"""Sessions whose supports give: a column on springs exactly, with and without knowing of them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from error_columns import columns_of
from surfaces import box

from palpate.estimation import FitMethod, FitSettings
from palpate.estimation.measured_components import observed_rows_of
from palpate.estimation.noise import Gaussian
from palpate.estimation.problem import make_problem
from palpate.geometry import closest_points
from palpate.pipeline import (
    fit_session,
    make_object_model,
    poke_session,
    session_observations,
)
from palpate.records import (
    EXACT,
    Contact,
    DisplacementField,
    Probing,
    Session,
    Support,
)

# A block 20 mm wide and 30 mm high on a platen without friction, which gives.
SIZE = np.array([0.02, 0.02, 0.03])
MESH = box(size=SIZE, cells=(3, 3, 4))
MIDDLE = MESH.vertices[MESH.triangles].mean(axis=1)
BOTTOM, TOP = (np.flatnonzero(np.abs(MIDDLE[:, 2] - z) < 1e-9) for z in (0.0, SIZE[2]))
UP = np.array([[0.0, 0.0, 1.0]])
SHEAR, NU = 2e4, 0.4
YOUNG = 2 * SHEAR * (1 + NU)
PRESS, AREA = 5.0, SIZE[0] * SIZE[1]
AXIS = np.array([0.01, 0.01, 0.0])
# Under it the block settles by 2.5 mm; it is 6.7 mm shorter.
STIFFNESS = 5e6


def pressed(points, force=PRESS):
    """Uniaxial compression, free to widen, on top of what the springs give."""
    moved = (points - AXIS) * np.array([NU, NU, -1.0]) * force / (AREA * YOUNG)
    moved[:, 2] -= force / (AREA * STIFFNESS)
    return moved


def session(stiffness, *, directions=UP, noise=0.0, probings=1, **errors):
    rng = np.random.default_rng(0)
    points = rng.uniform(0.1, 0.9, (120, 3)) * SIZE
    points[:60, 0], points[60:, 1] = 0.0, SIZE[1]
    surface = closest_points(MESH, points)
    contact = Contact(MIDDLE[TOP].mean(axis=0), None, "uniform", TOP)
    probes = []
    for k in range(probings):
        force = np.array([0.0, 0.0, -PRESS * (1 + k)])
        moved = pressed(points, -force[2])
        moved = moved + noise * rng.standard_normal(moved.shape)
        field = DisplacementField(
            points, moved, np.full_like(moved, max(noise, 1e-7)), None, surface, "n.csv"
        )
        probes.append(Probing(f"n{k}", contact, force, np.full(3, 1e-6), None, None, field, None))
    support = Support(BOTTOM, directions=directions, stiffness=stiffness)
    return Session(
        "block", Path("block"), MESH, BOTTOM, tuple(probes), None, None, None, (),
        supports=(support,), errors=replace(EXACT, **errors),
    )  # fmt: skip


def test_constants_of_a_block_whose_platen_gives():
    estimate = fit_session(session(STIFFNESS)).estimate
    # Quadrature of 1e-6 an integral, of a field that the elements hold exactly; the modulus about
    # which the model is taken settles to 1e-3, which leaves its square.
    assert estimate.shear_modulus.value == pytest.approx(SHEAR, rel=1e-4)
    assert estimate.poisson_ratio.value == pytest.approx(NU, abs=1e-4)


def test_without_the_stiffness_they_are_another_objects():
    """The test above can fail: the same measurement, taken for that of a rigid platen."""
    result = fit_session(session(None))
    assert abs(result.estimate.young_modulus.value / YOUNG - 1.0) > 0.05


@pytest.mark.slow
def test_a_platen_that_gives_more_than_it_is_said_to_is_an_error_with_a_prior():
    """Fitted along, the compliance is what it is, and the constants are right again."""
    noise = {"noise": 2e-5, "probings": 2}
    blind = fit_session(session(None, **noise)).estimate
    low, high = blind.young_modulus.ci95
    assert not low < YOUNG < high
    estimate = fit_session(session(None, support_compliance=2.0 / STIFFNESS, **noise)).estimate
    (given,) = [error for error in estimate.errors if error.name == "compliance of support 1"]
    assert (given.unit, given.prior_std) == ("m/Pa", 2.0 / STIFFNESS)
    # The platen's part of the motion is told apart from the block's by points at all heights.
    assert abs(given.value - 1.0 / STIFFNESS) < 4.0 * given.std < 0.2 / STIFFNESS
    for name, value in (("young_modulus", YOUNG), ("poisson_ratio", NU)):
        constant = getattr(estimate, name)
        assert abs(constant.value - value) < 3.0 * constant.std, name
    assert estimate.young_modulus.value == pytest.approx(YOUNG, rel=0.01)


def test_the_settlement_is_told_apart_from_the_objects_own_motion():
    """The derivative with respect to the modulus, and the response at another one, against the
    model taken there."""
    given = session(STIFFNESS)
    model = make_object_model(given)
    (seen,) = session_observations(given, model, shear_modulus=SHEAR)
    (softer,) = session_observations(given, model, shear_modulus=0.5 * SHEAR)
    for nu in (0.1, 0.45):
        # Pressed by its axis it takes the same pressure everywhere: affine without remainder.
        fixed, given_there = seen.response_terms(nu)[:, :, 2].T
        there, exact = fixed + 0.5 * SHEAR * given_there, softer.response.value(nu)[:, 2]
        np.testing.assert_allclose(there, exact, atol=1e-5 * np.abs(exact).max())
    glued = session(STIFFNESS, directions=None)
    model = make_object_model(glued)
    (seen,) = session_observations(glued, model, shear_modulus=SHEAR)
    step = 4e-3
    (higher,), (lower,) = (
        session_observations(glued, model, shear_modulus=SHEAR * np.exp(sign * step))
        for sign in (1.0, -1.0)
    )
    difference = (higher.response.value(0.3) - lower.response.value(0.3)) / (2 * step)
    # A difference of 4e-3 leaves 2e-5; responses in single precision some 6e-8 / 4e-3.
    np.testing.assert_allclose(
        seen.settlement.derivative(0.3), difference, atol=1e-4 * np.abs(difference).max()
    )


def test_the_slope_of_the_prediction_knows_that_the_settlement_stays():
    """Predictions against the modulus: the column of the Jacobian, and a modulus that is not the
    one about which the model was taken."""
    given = session(STIFFNESS, directions=None)
    (seen,) = session_observations(given, make_object_model(given), shear_modulus=SHEAR)
    rows = (observed_rows_of(seen),)
    problem = make_problem(rows, Gaussian(), poisson_ratio=0.3, shear_modulus=SHEAR)

    def at(modulus):
        theta = np.zeros(problem.layout.size)
        theta[:2] = 0.3, np.log(modulus)
        return theta

    step = 1e-4
    higher, lower = (problem.linearised(at(SHEAR * np.exp(x)))[0][0] for x in (step, -step))
    slope = problem.linearised(at(SHEAR))[1][0][1]
    difference = -(higher - lower) / (2 * step)
    # A central difference of 1e-4 leaves 1e-8.
    np.testing.assert_allclose(slope, difference, atol=1e-6 * np.abs(difference).max())
    rigid = -seen.response.value(0.3) @ np.append(seen.force, 1.0) / SHEAR
    # What the springs give is a quarter of what points move and does not depend on the modulus.
    assert np.abs(slope - rigid).max() > 0.1 * np.abs(slope).max()


def test_a_small_compliance_moves_the_points_as_springs_do():
    """The column of the error against sessions whose support really gives so little."""
    std = 1e-9
    rigid = session(None, directions=None, support_compliance=std)
    model = make_object_model(rigid)
    (seen,) = session_observations(rigid, model)
    (error,) = seen.nuisances
    load = np.append(seen.force, 1.0) / SHEAR
    (column,) = columns_of(error, seen.response.value(0.3), load, 0.3).T

    def moved(stiffness):
        there = session(stiffness, directions=None)
        (observations,) = session_observations(there, make_object_model(there), shear_modulus=SHEAR)
        return observations.response.value(0.3) @ load

    given = moved(1.0 / std) - moved(None)
    # Springs that give 1e-9 m/Pa are 1e-2 of the elements under them: so much is the next order.
    np.testing.assert_allclose(column, given, atol=1e-2 * np.abs(given).max())


def test_a_glued_block_on_a_soft_bed_is_found_again():
    """Its own model's data: the modulus about which that is taken settles on both meshes."""
    given = session(STIFFNESS, directions=None, probings=2)
    observed = session_observations(given, make_object_model(given), shear_modulus=SHEAR)
    probings = []
    for probing, seen in zip(given.probings, observed, strict=True):
        moved = seen.response.value(NU) @ np.append(seen.force, 1.0) / SHEAR
        field = replace(probing.displacement, displacement=moved.reshape(-1, 3))
        probings.append(replace(probing, displacement=field))
    estimate = fit_session(replace(given, probings=tuple(probings))).estimate
    # The graded mesh sees the given one's error, most of it explained by the step between both.
    assert estimate.shear_modulus.value == pytest.approx(SHEAR, rel=0.02)
    assert estimate.status != "not_converged"


def test_the_slow_method_agrees():
    given = session(STIFFNESS, directions=None)
    model = make_object_model(given)
    (fast,) = session_observations(given, model, shear_modulus=SHEAR)
    slow_way = FitSettings(method=FitMethod.NELDER_MEAD)
    (slow,) = session_observations(given, model, settings=slow_way, shear_modulus=SHEAR)
    for nu in (0.05, 0.45):
        exact = slow.response.value(nu)
        # The reduced model's tolerance.
        np.testing.assert_allclose(fast.response.value(nu), exact, atol=1e-6 * np.abs(exact).max())


@pytest.mark.parametrize("gravity", [[0.0, 0.0, -9.81], [9.81, 0.0, 0.0]])
def test_a_stiff_block_under_its_weight(gravity):
    """Upright it sinks; lying against its side it shifts, and rocks about the middle of its foot.
    Displacement times the modulus of a block 1e6 times as stiff as its springs."""
    shear, density, gravity = 1e11, 1000.0, np.array(gravity)
    given = replace(session(STIFFNESS, directions=None), density=density, gravity=gravity)
    (seen,) = session_observations(given, make_object_model(given), shear_modulus=shear)
    displacement = seen.response.value(NU)[:, 3].reshape(-1, 3) / shear
    weight = density * gravity * SIZE.prod()
    inertia = SIZE[0] ** 3 * SIZE[1] / 12
    turn = np.cross([0.0, 0.0, 0.5 * SIZE[2]], weight) / (STIFFNESS * inertia)
    exact = weight / (STIFFNESS * AREA) + np.cross(turn, seen.position - AXIS)
    # Moments balance to the mesh's accuracy; what the particular solution of gravity presses on the
    # foot has 7 % of the moment.
    np.testing.assert_allclose(displacement, exact, atol=0.02 * np.abs(exact).max())


def test_a_poke_on_a_platen_that_gives():
    contact = Contact(np.array([0.01, 0.01, SIZE[2]]), 0.005, "smooth")

    def poked(stiffness):
        return poke_session(
            session(stiffness), np.array([0.0, 0.0, -PRESS]), contact,
            shear_modulus=SHEAR, poisson_ratio=NU,
        )  # fmt: skip

    rigid, soft = poked(None), poked(STIFFNESS)
    sunk = -PRESS / (AREA * STIFFNESS)
    # The pressure on the platen is no longer even, and evens out as the springs give: the block's
    # own deformation changes by a few per cent of itself.
    assert soft.displacement[2] - rigid.displacement[2] == pytest.approx(sunk, rel=0.1)
    np.testing.assert_allclose(soft.reaction, [0.0, 0.0, PRESS], atol=1e-9)
