"""Supports that move and loads over faces, against closed forms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.geometry import closest_points
from palpate.pipeline import (
    fit_session,
    graded_session,
    make_object_model,
    refined_session,
    session_observations,
)
from palpate.pipeline.model.supports import moving_supports, rigid_modes
from palpate.records import (
    EXACT as NO_ERRORS,
    FREE,
    GIVEN,
    RIGID,
    Contact,
    DisplacementField,
    Load,
    Probing,
    Session,
    Support,
)
from palpate.records.support import RigidMotion

# A bar of 40 mm along x, 10 mm thick.
SIZE = np.array([0.04, 0.01, 0.01])
MESH = box(size=SIZE, cells=(4, 2, 2))
MIDDLE = MESH.vertices[MESH.triangles].mean(axis=1)
FOOT, HEAD = (np.flatnonzero(np.abs(MIDDLE[:, 0] - x) < 1e-9) for x in (0.0, SIZE[0]))
SHEAR, NU, NOISE = 1e5, 0.3, 1e-6
YOUNG = 2 * SHEAR * (1 + NU)
AREA = SIZE[1] * SIZE[2]
# Both ends of the bar may turn and shift.
TRANSLATION, ROTATION = np.array([2e-4, -1e-4, 5e-5]), np.array([2e-3, -4e-3, 1e-3])
CENTRE = MESH.vertices[np.unique(MESH.triangles[FOOT])].mean(axis=0)
# Quadrature of 1e-6 an integral: fields that the elements hold exactly come out to this.
EXACT = 1e-5


def stretched(points, stress, nu=NU, young=YOUNG):
    """Uniaxial tension along x; the axis of the bar stays, and the origin."""
    return (points - CENTRE) * np.array([1.0, -nu, -nu]) * stress / young


def turned(points):
    return rigid_modes(points, CENTRE) @ np.concatenate([TRANSLATION, ROTATION])


def field_at(points, moved, std=NOISE):
    return DisplacementField(
        points, moved, np.full_like(moved, std), None, closest_points(MESH, points), "field.csv"
    )


def side_points(rng, count=60):
    """Points of the long faces."""
    points = rng.uniform(0.1, 0.9, (count, 3)) * SIZE
    points[: count // 2, 1] = 0.0
    points[count // 2 :, 2] = SIZE[2]
    return points


def bar(probing, *supports, **more):
    held = np.concatenate([support.triangles for support in supports])
    return Session(
        "bar", Path("bar"), MESH, held, (probing,), more.pop("density", None), None, None, (),
        supports=supports, **{"errors": NO_ERRORS} | more,
    )  # fmt: skip


def pulled(moved, points, *, contact=None, force=(2.0, 0.0, 0.0), **more):
    contact = contact or Contact(MIDDLE[HEAD].mean(axis=0), None, "uniform", HEAD)
    return Probing(
        "n", contact, np.array(force), None, None, None, field_at(points, moved), None, **more
    )


def columns(session, nu):
    model = make_object_model(session)
    (seen,) = session_observations(session, model)
    return seen, seen.response.value(nu)


@pytest.mark.parametrize("nu", [0.0, 0.45])
def test_the_only_support_moves_the_whole_object(nu):
    points = side_points(np.random.default_rng(0), 20)
    probing = pulled(np.zeros_like(points), points)
    seen, value = columns(bar(probing, Support(FOOT, FREE)), nu)
    assert value.shape == (60, 10)
    expected = rigid_modes(points, CENTRE).reshape(60, 6)
    np.testing.assert_allclose(value[:, 4:], expected, atol=EXACT * np.abs(expected).max())
    np.testing.assert_array_equal(seen.motion, 0.0)
    assert seen.motion_std.min() > 0.02


def test_a_bar_in_tension_whose_foot_contracts_and_moves():
    """The foot's own motion is given by points: constants and fit are exact."""
    rng = np.random.default_rng(1)
    points, foot = side_points(rng), rng.uniform(0.0, 1.0, (40, 3)) * SIZE * [0.0, 1.0, 1.0]
    stress = 2.0 / AREA
    measured = field_at(foot, stretched(foot, stress) + turned(foot))
    probing = pulled(
        stretched(points, stress) + turned(points), points, support_displacement=measured
    )
    result = fit_session(bar(probing, Support(FOOT, GIVEN)))
    estimate = result.estimate
    assert estimate.shear_modulus.value == pytest.approx(SHEAR, rel=1e-4)
    assert estimate.poisson_ratio.value == pytest.approx(NU, abs=1e-4)
    (support,) = estimate.probes[0].supports
    # The mesh is granted an error, which takes a thousandth of it.
    np.testing.assert_allclose(support.translation, TRANSLATION, atol=2e-7)
    np.testing.assert_allclose(support.rotation, ROTATION, atol=1e-5)
    assert np.abs(result.probes[0].residual).max() < 2e-7


def test_outliers_do_not_move_a_support():
    rng = np.random.default_rng(2)
    foot = rng.uniform(0.0, 1.0, (60, 3)) * SIZE * [0.0, 1.0, 1.0]
    moved = turned(foot) + NOISE * rng.normal(size=foot.shape)
    moved[:6] += 1e-3
    points = side_points(rng)
    probing = pulled(
        turned(points) + stretched(points, 2.0 / AREA), points,
        support_displacement=field_at(foot, moved),
    )  # fmt: skip
    seen, _ = columns(bar(probing, Support(FOOT, GIVEN)), 0.3)
    # The sixth motion's error is checked in its own sigmas; a tenth are gross outliers.
    expected = np.concatenate([TRANSLATION, ROTATION])
    assert np.abs((seen.motion[:6] - expected) / seen.motion_std[:6]).max() < 5.0
    assert 0.1 * NOISE < seen.motion_std[0] < NOISE


def test_a_free_motion_is_estimated_along():
    rng = np.random.default_rng(3)
    points = side_points(rng, 200)
    session = bar(pulled(np.zeros_like(points), points), Support(FOOT, FREE))
    # On the mesh that the fit takes.
    seen, value = columns(graded_session(refined_session(session)), NU)
    motion = np.concatenate([TRANSLATION, ROTATION])
    load = np.concatenate([seen.force / SHEAR, [1.0 / SHEAR], motion])
    moved = (value @ load).reshape(-1, 3) + NOISE * rng.normal(size=points.shape)
    result = fit_session(bar(pulled(moved, points), Support(FOOT, FREE)))
    estimate = result.estimate
    assert estimate.status == "ok"
    for name, truth in (("shear_modulus", SHEAR), ("poisson_ratio", NU)):
        constant = getattr(estimate, name)
        assert abs(constant.value - truth) < 4 * constant.std
    assert estimate.shear_modulus.std < 0.02 * SHEAR
    (support,) = estimate.probes[0].supports
    given_motion = np.array([*support.translation, *support.rotation])
    std = np.array([*support.translation_std, *support.rotation_std])
    # Six Gaussian deviations: beyond four sigmas once in 2600 seeds.
    assert np.abs((given_motion - motion) / std).max() < 4.0
    # What the mesh may be off by counts more than two hundred points with this noise.
    assert std[:3].max() < 10 * NOISE


def test_pressure_on_all_free_faces():
    """A cube-like bar under hydrostatic pressure shrinks alike in all directions."""
    points = side_points(np.random.default_rng(4), 20)
    free = np.setdiff1d(np.arange(len(MESH.triangles)), FOOT)
    load = Load(Contact(MIDDLE[HEAD].mean(axis=0), None, "uniform", free), pressure=3e3)
    shrunk = -3e3 * (1 - 2 * NU) / YOUNG
    foot = MESH.vertices[np.unique(MESH.triangles[FOOT])]
    probing = pulled(
        np.zeros_like(points), points, force=(0.0, 0.0, 0.0), loads=(load,),
        support_displacement=field_at(foot, shrunk * (foot - CENTRE)),
    )  # fmt: skip
    seen, value = columns(bar(probing, Support(FOOT, GIVEN)), NU)
    displacement = value @ np.concatenate([seen.force / SHEAR, [1.0 / SHEAR], seen.motion])
    expected = shrunk * (points - CENTRE)
    np.testing.assert_allclose(
        displacement.reshape(-1, 3), expected, atol=EXACT * np.abs(expected).max()
    )


def test_a_pulled_grip_stretches_a_bar_without_contraction():
    """nu = 0: the ends do not matter, u_x = F x / (E A), and no force across moves the bar."""
    points = side_points(np.random.default_rng(5), 20)
    contact = Contact(MIDDLE[HEAD].mean(axis=0), None, RIGID, HEAD)
    probing = pulled(np.zeros_like(points), points, contact=contact)
    session = bar(probing, Support(FOOT), Support(HEAD, FREE))
    seen, value = columns(session, 0.0)
    assert value.shape == (60, 7)
    along = value[:, 0].reshape(-1, 3)
    expected = np.outer(points[:, 0] / (2 * AREA), [1.0, 0.0, 0.0])
    np.testing.assert_allclose(along, expected, atol=EXACT * expected.max())
    # Its shifts follow from the force, its turns remain.
    assert seen.motion_std.shape == (3,)


def test_an_easily_bent_sheet_is_where_it_is_seen_not_where_forces_say():
    """The force across would have to be known to 1e-4 of the one along to say where the head of a
    thin sheet is: its shift across stands for it, of the same displacements in other terms."""
    size, nu = np.array([0.1, 0.02, 0.001]), 0.45
    mesh = box(size=size, cells=(40, 8, 1))
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    foot, head = (np.flatnonzero(np.abs(middle[:, 0] - x) < 1e-9) for x in (0.0, size[0]))
    points = mesh.vertices[mesh.vertices[:, 0] > 0.5 * size[0]]
    still, std = np.zeros_like(points), np.full_like(points, NOISE)
    field = DisplacementField(points, still, std, None, closest_points(mesh, points), "field.csv")
    contact = Contact(middle[head].mean(axis=0), None, RIGID, head)
    force = np.array([0.4, 0.0, 0.0])

    def columns_of(force_std):
        probing = Probing("n", contact, force, np.full(3, force_std), None, None, field, None)
        session = Session(
            "sheet", Path("sheet"), mesh, np.concatenate([foot, head]), (probing,), None, None,
            None, (), supports=(Support(foot, FREE), Support(head, FREE)), errors=NO_ERRORS,
        )  # fmt: skip
        return columns(session, nu)[1]

    by_force, by_shift = columns_of(0.0), columns_of(0.01)
    at_head = points[:, 0] > size[0] - 1e-9
    # The mesh's own error bends the sheet that is stretched, by a part of the stretch.
    along = by_force[:, 0].reshape(-1, 3)[at_head]
    assert np.abs(along[:, 2]).max() > 0.02 * np.abs(along[:, 0]).max()
    along = by_shift[:, 0].reshape(-1, 3)[at_head]
    assert np.abs(along[:, 2]).max() < 1e-9 * np.abs(along[:, 0]).max()
    used = [0, 1, 2, *range(4, by_force.shape[1])]
    old, new = (
        value[:, used] / np.linalg.norm(value[:, used], axis=0) for value in (by_force, by_shift)
    )
    missed = old - new @ np.linalg.lstsq(new, old)[0]
    assert np.linalg.norm(missed, axis=0).max() < 1e-6


def test_loads_add_up():
    points = side_points(np.random.default_rng(6), 20)
    contact = Contact(np.array([0.02, 0.005, 0.01]), 0.004, "smooth")
    second = Load(Contact(np.array([0.03, 0.0, 0.005]), 0.003, "uniform"), np.array([0.1, 0.5, 0]))
    session = bar(
        pulled(np.zeros_like(points), points, contact=contact, loads=(second,)), Support(FOOT)
    )
    _, both = columns(session, 0.3)
    alone = replace(session.probings[0], contact=second.contact, loads=())
    _, other = columns(replace(session, probings=(alone,)), 0.3)
    np.testing.assert_allclose(both[:, 3], other[:, :3] @ second.force, rtol=1e-6)


def test_a_rigid_motion_can_be_given_as_numbers():
    points = side_points(np.random.default_rng(7), 20)
    motion = RigidMotion(TRANSLATION, ROTATION)
    probing = pulled(np.zeros_like(points), points, support_motion=motion)
    session = bar(probing, Support(FOOT, GIVEN))
    seen, value = columns(session, 0.2)
    moved = (value[:, 4:] @ seen.motion).reshape(-1, 3)
    np.testing.assert_allclose(moved, turned(points), atol=EXACT * np.abs(moved).max())
    np.testing.assert_array_equal(seen.motion_std, 0.0)


def test_supports_are_numbered_as_the_session_counts():
    probing = pulled(np.zeros((1, 3)), side_points(np.random.default_rng(8), 1))
    supports = moving_supports(bar(probing, Support(FOOT), Support(HEAD[:1], FREE)))
    assert [support.number for support in supports] == [2]
