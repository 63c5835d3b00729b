"""Objects on springs: a column and a rigid block against their closed forms, derivatives against
differences, and the limit of springs that do not give."""

import numpy as np
import pytest
from surfaces import box

from palpate.bem import (
    boundary_system,
    face_columns,
    factorise,
    make_elastic_map,
    make_spring_factors,
    make_spring_system,
    make_springs,
    make_surface,
)

SIZE = np.array([0.02, 0.03, 0.04])
MESH = box(size=SIZE, cells=(2, 3, 4))
MIDDLE = MESH.vertices[MESH.triangles].mean(axis=1)
BOTTOM, TOP = (np.flatnonzero(np.abs(MIDDLE[:, 2] - z) < 1e-9) for z in (0.0, SIZE[2]))
BASE = np.flatnonzero(MESH.vertices[:, 2] == 0.0)
AREA = SIZE[0] * SIZE[1]
SHEAR, NU = 2e4, 0.35
FORCE = np.array([0.0, 0.0, -4.0])
# Quadrature of 1e-6 an integral, of fields that the elements hold exactly.
EXACT = 1e-5


def system_of(directions=None):
    given = None
    if directions is not None:
        given = np.tile(directions.T @ directions, (len(BOTTOM), 1, 1))
    return boundary_system(make_surface(MESH, BOTTOM, directions=given))


@pytest.fixture(scope="module")
def glued():
    return system_of()


@pytest.fixture(scope="module")
def rolling():
    return system_of(np.array([[0.0, 0.0, 1.0]]))


def moved(system, *, stiffness, shear, nu, force=FORCE, triangles=TOP):
    """Displacement of every vertex under a uniform traction over a face, and the reaction."""
    springs = make_springs(system, [BOTTOM], np.array([], dtype=np.int64))
    elastic = make_elastic_map(
        system, shear_modulus=shear, poisson_ratio=nu, springs=springs,
        compliance=np.array([1.0 / stiffness]),
    )  # fmt: skip
    right = face_columns(system, triangles).on_springs(
        elastic.springs.compliance, np.zeros((0, springs.support_fraction.shape[0]))
    )
    return elastic.state(elastic.springs.solve(right.at(nu)) @ force / shear)


@pytest.mark.parametrize("stiffness", [1e5, 1e7, 1e12])
def test_a_column_on_a_platen_that_gives(rolling, stiffness):
    """Uniaxial compression on top of what the springs give: exact whatever the springs."""
    state = moved(rolling, stiffness=stiffness, shear=SHEAR, nu=NU)
    stress = -FORCE[2] / AREA
    young = 2 * SHEAR * (1 + NU)
    centre = np.array([0.01, 0.015, 0.0])
    exact = (MESH.vertices - centre) * np.array([NU, NU, -1.0]) * stress / young
    exact[:, 2] -= stress / stiffness
    away = state.displacement - exact
    # Along the platen it slides as it likes.
    away[:, :2] -= away[:, :2].mean(axis=0)
    assert np.abs(away).max() < EXACT * np.abs(exact).max()
    np.testing.assert_allclose(state.reaction, -FORCE, rtol=1e-9)


def test_a_rigid_block_on_springs(glued):
    """Pushed aside at its top: it settles, shifts and rocks as its springs let it."""
    stiffness, force = 1e6, np.array([3.0, 0.0, -4.0])
    state = moved(glued, stiffness=stiffness, shear=1e10, nu=0.3, force=force)
    centre = np.array([0.01, 0.015, 0.0])
    offset = MESH.vertices - centre
    rock = force[0] * SIZE[2] / (stiffness * SIZE[0] ** 3 * SIZE[1] / 12)
    turn = np.array([0.0, rock, 0.0])
    exact = force / (stiffness * AREA) + np.cross(turn, offset)
    # The block is 1e10 / (1e6 * 0.04) = 2.5e5 times as stiff as its springs.
    # Forces balance exactly, moments as well as the mesh can (1.6 % here, 0.4 % on nine times as
    # many vertices): what the block rocks, but not what it settles and shifts.
    settled = state.displacement[BASE].mean(axis=0)
    np.testing.assert_allclose(settled, force / (stiffness * AREA), rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(state.displacement, exact, atol=2e-2 * np.abs(exact).max())


def test_springs_that_do_not_give_are_no_springs(glued):
    rigid = make_elastic_map(glued, shear_modulus=SHEAR, poisson_ratio=NU)
    plain = rigid.state(rigid.solve(face_columns(glued, TOP).at(NU)) @ FORCE / SHEAR)
    stiff = moved(glued, stiffness=1e16, shear=SHEAR, nu=NU)
    np.testing.assert_allclose(
        stiff.displacement, plain.displacement, atol=1e-9 * np.abs(plain.displacement).max()
    )


@pytest.mark.parametrize("compliance", [0.0, 0.5])
def test_what_a_softer_support_changes(glued, compliance):
    """The derivative that comes with the solution, against a central difference."""
    springs = make_springs(glued, [BOTTOM], np.array([], dtype=np.int64))
    factors = make_spring_factors(factorise(glued, NU), glued, springs)
    right = face_columns(glued, TOP)
    unit = springs.compliance(np.ones(1))

    def solved(at, compliance_derivatives):
        system = make_spring_system(factors, at * unit, compliance_derivatives)
        return system.solve(right.on_springs(at * unit, compliance_derivatives).at(NU))

    step = 1e-5
    difference = (
        solved(compliance + step, unit[None][:0]) - solved(compliance - step, unit[None][:0])
    ) / (2 * step)
    value, slope = np.split(solved(compliance, unit[None]), 2)
    np.testing.assert_allclose(value, solved(compliance, unit[None][:0]), rtol=1e-12)
    # A difference of 1e-5 leaves 1e-10 of the third derivative, and rounding of 1e-16 / 1e-5.
    np.testing.assert_allclose(slope, difference, atol=1e-6 * np.abs(difference).max())


def test_springs_that_two_supports_share(glued):
    halves = [BOTTOM[MIDDLE[BOTTOM, 1] < SIZE[1] / 2], BOTTOM[MIDDLE[BOTTOM, 1] > SIZE[1] / 2]]
    springs = make_springs(glued, halves, np.array([], dtype=np.int64))
    share = springs.support_fraction
    shared = (share > 0.0).all(axis=1)
    assert shared.any()
    assert not shared.all()
    np.testing.assert_allclose(share.sum(axis=1), 1.0)
    # Both give: each in proportion to its share, also in the derivatives.
    both = np.array([2e-8, 5e-8])
    np.testing.assert_allclose(springs.compliance(both), share @ both)
    np.testing.assert_array_equal(springs.compliance_derivatives(both), share.T)
    # One is rigid: what it holds, alone or together, does not give, however the other changes.
    compliance = np.array([0.0, 5e-8])
    np.testing.assert_allclose(
        springs.compliance(compliance), np.where(share[:, 0] > 0.0, 0.0, compliance[1])
    )
    assert (springs.compliance_derivatives(compliance)[:, shared] == 0.0).all()
    assert (springs.compliance_derivatives(compliance)[1, share[:, 1] == 1.0] == 1.0).all()
