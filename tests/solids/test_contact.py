"""Rigid tips on an elastic body against Hertz, Boussinesq, laws and every refusal."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from surfaces import box

from palpate.errors import InputError
from palpate.records import STICKS, FlatFace, Sphere
from palpate.solids.contact import facet_samples, press, press_to_force, touch
from palpate.solids.finite_elements import (
    hooke_moduli,
    make_body,
    quadratic_basis,
    stiffness_matrix,
    surface_values,
)
from palpate.solids.tetrahedra import make_solid
from palpate.solids.tips import Tip

SHEAR, POISSON = 7e4, 0.3
CONTACT_MODULUS = 2 * SHEAR / (1 - POISSON)
SIZE = 0.2
TOP = np.array([SIZE / 2, SIZE / 2, SIZE])
DOWN = np.array([0.0, 0.0, -1.0])
BALL = Tip(Sphere(0.01), TOP, DOWN)
GLUED = Tip(Sphere(0.01, friction=STICKS), TOP, DOWN)
FINE = 1e-3


@pytest.fixture(scope="module")
def block():
    """A large block, fine where it is touched, glued to the ground."""
    mesh = box((SIZE, SIZE, SIZE))
    solid = make_solid(mesh, edge=0.05, fine=((TOP, 0.0025, FINE),))
    held = solid.nodes[:, 2] == 0.0
    return make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=POISSON)


def hertz(depth):
    return 4 / 3 * CONTACT_MODULUS * np.sqrt(BALL.radius * depth**3)


def test_a_ball_presses_as_hertz_says(block):
    depths = np.array([2e-4, 4e-4])
    states = press(block, BALL, depths)
    for state, depth in zip(states, depths, strict=True):
        # Hertz's half space is larger than the block (1 %), and the circle has 2 elements a radius.
        assert -state.force[2] == pytest.approx(hertz(depth), rel=0.04)
        assert state.radius == pytest.approx(np.sqrt(BALL.radius * depth), rel=0.06)
        # Sideways forces are the mesh's own lack of symmetry.
        assert np.abs(state.force[:2]).max() < 2e-3 * hertz(depth)
    # The power 3/2, with errors of either depth cancelling in part.
    power = np.log(states[1].force[2] / states[0].force[2]) / np.log(2.0)
    assert power == pytest.approx(1.5, abs=0.03)


def test_a_flat_punch_presses_as_boussinesq_says():
    radius, depth = 0.002, 1e-4
    punch = Tip(FlatFace(radius), TOP, DOWN)
    apart = 0.5 * radius
    rim = punch.rim(apart)
    fine = [(TOP, 0.0, apart), *((point, 0.0, apart) for point in rim)]
    solid = make_solid(box((SIZE, SIZE, SIZE)), edge=0.05, fine=fine, marked=rim)
    held = solid.nodes[:, 2] == 0.0
    body = make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=POISSON)
    (state,) = press(body, punch, np.array([depth]))
    ratio = -float(state.force[2]) / (2 * radius * CONTACT_MODULUS * depth)
    # The rim's elements hold the surface down beyond it: too stiff by 0.083 of their size over the
    # radius, as halving it shows, and the block by 0.006, as it is no half space. Between nodes the
    # rim would be that of a smaller punch, 3 % too soft.
    assert ratio == pytest.approx(1.0 + 0.083 / 2 + 0.006, abs=0.015)
    under = np.linalg.norm((solid.nodes - TOP)[:, :2], axis=1) < 0.9 * radius
    under &= solid.nodes[:, 2] == SIZE
    # None is in the punch; a corner between pressed middles may hang below it by a little.
    assert (state.displacement[under, 2] < -depth * (1 - 1e-9)).all()
    np.testing.assert_allclose(state.displacement[under, 2], -depth, rtol=0.05)
    # Beside it (Johnson 1985, equation 3.38, under the force that was found); the block's ground
    # lifts the dip by half a per cent at two radii.
    beside = np.array([2.0, 3.0])
    angle = 2 * np.pi * np.arange(16) / 16
    around = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    places = TOP + radius * (beside[:, None, None] * around).reshape(-1, 3)
    dip = (surface_values(solid, places) @ state.displacement)[:, 2].reshape(2, -1).mean(axis=1)
    exact = -depth * ratio * 2 / np.pi * np.arcsin(1 / beside)
    np.testing.assert_allclose(dip, exact, rtol=0.012)


def test_nothing_enters_the_tip_and_nothing_is_pulled(block):
    depth = 4e-4
    (state,) = press(block, BALL, np.array([depth]))
    at = block.solid.nodes + state.displacement
    offset = at - state.tip_position
    assert np.linalg.norm(offset, axis=1).min() > BALL.radius * (1 - 1e-9)
    assert ((state.load * offset).sum(axis=1) >= 0.0).all()
    # Forces are along the tip's normal: no friction.
    assert np.abs(np.cross(state.load, offset)).max() < 1e-9 * BALL.radius
    # Where a node is pushed it lies on the tip.
    pushed = (state.load != 0.0).any(axis=1)
    gap = np.linalg.norm(offset[pushed], axis=1) - BALL.radius
    assert np.abs(gap).max() < 1e-8 * BALL.radius


def test_reaction_equals_force(block):
    stiffness = stiffness_matrix(quadratic_basis(block.solid), hooke_moduli(SHEAR, POISSON))
    for tip in (BALL, GLUED):
        (state,) = press(block, tip, np.array([3e-4]))
        inner = (stiffness @ state.displacement.ravel()).reshape(-1, 3)
        # Rounding; forces are 0.2 N.
        np.testing.assert_allclose(inner[block.held].sum(axis=0), -state.force, atol=1e-9)
        np.testing.assert_allclose(inner[~block.held], state.load[~block.held], atol=1e-9)


def test_a_press_to_a_force_is_the_press_to_its_depth(block):
    (state,) = press(block, BALL, np.array([2.5e-4]))
    state_again = press_to_force(block, BALL, -float(state.force[2]))
    assert state_again.depth == pytest.approx(2.5e-4, rel=1e-6)
    np.testing.assert_allclose(state_again.displacement, state.displacement, atol=1e-6 * 2.5e-4)


def test_what_sticks_moves_with_the_tip(block):
    depths = np.linspace(5e-5, 4e-4, 8)
    slid, stuck = (press(block, tip, depths) for tip in (BALL, GLUED))
    before, after = stuck[-2:]
    pushed = (before.load != 0.0).any(axis=1) & (after.load != 0.0).any(axis=1)
    assert pushed.sum() > 10
    moved = (after.displacement - before.displacement)[pushed]
    otherwise = np.abs(moved - (depths[-1] - depths[-2]) * DOWN).max(axis=1) > 1e-9
    # At the rim one may be torn loose within a step, and slides until the next.
    assert otherwise.sum() <= 1
    # Spence (1968): a sticking ball needs at most a few per cent more (2 % at nu 0.3).
    ratio = stuck[-1].force[2] / slid[-1].force[2]
    assert 1.0 < ratio < 1.04


def test_a_flat_face_that_sticks_presses_as_far_in_one_step_as_in_many():
    radius, depth = 0.002, 1e-4
    glued = Tip(FlatFace(radius, friction=STICKS), TOP, DOWN)
    rim = glued.rim(0.5 * radius)
    fine = [(TOP, 0.0, 0.5 * radius), *((point, 0.0, 0.5 * radius) for point in rim)]
    solid = make_solid(box((SIZE, SIZE, SIZE)), edge=0.05, fine=fine, marked=rim)
    held = solid.nodes[:, 2] == 0.0
    body = make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=POISSON)
    (once,) = press(body, glued, np.array([depth]))
    often = press(body, glued, np.linspace(depth / 5, depth, 5))[-1]
    # All of it sticks from the first: rounding.
    np.testing.assert_allclose(often.load, once.load, atol=1e-9 * np.abs(once.load).max())
    # The mesh's own lack of symmetry; a node torn loose on the way leaves 2 %.
    assert np.abs(once.force[:2]).max() < 2e-3 * abs(once.force[2])
    # Spence (1968), equation for the flat face: the stiffness over that without friction.
    slid = press(body, replace(glued, tool=FlatFace(radius)), np.array([depth]))[0]
    spence = (1 - POISSON) * np.log(3 - 4 * POISSON) / (1 - 2 * POISSON)
    assert once.force[2] / slid.force[2] == pytest.approx(spence, abs=0.006)


def test_touch_knows_where_the_surface_is(block):
    assert touch(block.solid, BALL) == pytest.approx(-BALL.radius, abs=2e-6)
    far = Tip(Sphere(0.01), TOP - 0.05 * DOWN, DOWN)
    assert touch(block.solid, far) == pytest.approx(0.04, abs=2e-6)
    punch = Tip(FlatFace(0.002), TOP - 0.05 * DOWN, 3.0 * DOWN)
    assert touch(block.solid, punch) == pytest.approx(0.05, abs=1e-12)


def test_a_tilted_way_gives_a_sideways_force(block):
    tilt = np.array([np.sin(0.1), 0.0, -np.cos(0.1)])
    (state,) = press(block, Tip(Sphere(0.01), TOP, tilt), np.array([3e-4]))
    # Without friction the force is the plane's normal, but for the dent's own slope.
    assert abs(state.force[0]) < 0.02 * abs(state.force[2])
    stuck = press(block, replace(GLUED, direction=tilt), np.linspace(5e-5, 3e-4, 6))[-1]
    # A flat bonded punch has 2 (1 - nu) / (2 - nu) of its normal stiffness sideways (0.82).
    assert 0.04 < stuck.force[0] / abs(stuck.force[2]) < 0.09


def test_what_sticks_is_let_go_where_it_would_be_pulled(block):
    # Dragged along, the tip leaves what lies behind it.
    steep = np.array([np.sin(1.4), 0.0, -np.cos(1.4)])
    tip = replace(GLUED, point=TOP - 0.01 * DOWN, direction=steep)
    states = press(block, tip, np.linspace(1e-4, 1.5e-3, 15))
    for state in states:
        offset = block.solid.nodes + state.displacement - state.tip_position
        push = (state.load * offset).sum(axis=1)
        assert push.min() >= -1e-12 * push.max()
    touched = [(state.load != 0.0).any(axis=1) for state in states]
    assert any((before & ~after).any() for before, after in pairwise(touched))


@pytest.mark.parametrize("depths", [[], [0.0], [-1e-4], [2e-4, 1e-4]])
def test_bad_depths_are_refused(block, depths):
    with pytest.raises(InputError, match="must be positive and increasing"):
        press(block, BALL, np.array(depths))


@pytest.mark.parametrize("force", [0.0, -1.0, np.nan])
def test_bad_forces_are_refused(block, force):
    with pytest.raises(InputError, match="must be positive, in newtons"):
        press_to_force(block, BALL, force)


@pytest.mark.parametrize("radius", [0.0, -1.0, np.nan])
def test_bad_radii_are_refused(radius):
    with pytest.raises(InputError, match="tool_radius is"):
        Sphere(radius)


def test_a_tip_without_direction_is_refused():
    with pytest.raises(InputError, match="zero vector"):
        Tip(Sphere(0.01), TOP, np.zeros(3))


def test_a_tip_that_passes_the_body_is_refused(block):
    with pytest.raises(InputError, match="passes the body"):
        press(block, Tip(Sphere(0.01), np.array([1.0, 0.0, SIZE]), DOWN), np.array([1e-4]))


def test_a_tip_between_the_nodes_is_refused(block):
    # In the middle of the largest facet on top a sphere meets no node.
    corners = block.solid.nodes[block.solid.facets[:, :3]]
    size = np.ptp(corners, axis=1).max(axis=1) * (corners[:, :, 2] == SIZE).all(axis=1)
    widest = size.argmax()
    corner = block.solid.nodes[block.solid.facets[widest, :3]].mean(axis=0)
    with pytest.raises(InputError, match="no node"):
        press(block, Tip(Sphere(0.01), corner, DOWN), np.array([1e-4]))


def test_a_sphere_deeper_than_its_radius_is_refused(block):
    with pytest.raises(InputError, match="a sphere goes in by less than its radius"):
        press(block, BALL, np.array([1e-4, BALL.radius]))


def test_a_force_that_a_body_could_bear_only_as_a_thin_layer_is_refused(block):
    # Hertz, as in test_tips: the depth that the message names.
    force = 4 / 3 * CONTACT_MODULUS * np.sqrt(BALL.radius * 0.12**3)
    with pytest.raises(InputError, match="a half space of this material in by 120 mm"):
        press_to_force(block, BALL, force)


def test_samples_of_a_face_are_of_degree_two():
    samples = facet_samples()
    assert samples.shape == (48, 3)
    assert (samples > 0.0).all()
    # Means over a triangle: a 1/3, a^2 1/6, a b 1/12; the rule is exact.
    np.testing.assert_allclose(samples.mean(axis=0), 1 / 3, rtol=1e-12)
    np.testing.assert_allclose(
        samples.T @ samples / 48, (np.ones((3, 3)) + np.eye(3)) / 12, rtol=1e-12
    )
