"""Tips at finite strain: closed forms, balance of forces, no entering, bodies with weight."""

import numpy as np
import pytest
from surfaces import box

from palpate.errors import InputError, NotConvergedError
from palpate.geometry import quadratic_shapes
from palpate.records import FlatFace, Sphere
from palpate.solids.contact import facet_samples
from palpate.solids.finite_contact import Sag, press_finite, press_slopes
from palpate.solids.finite_elements import Body, make_body, nodal_volumes, quadratic_basis
from palpate.solids.finite_strain import (
    Law,
    LawOf,
    NeoHookean,
    internal_forces,
    load_slopes,
    solve_finite,
    yeoh,
)
from palpate.solids.tetrahedra import make_solid
from palpate.solids.tips import Tip

SHEAR, SIDE = 2e4, 0.02
TOP = np.array([SIDE / 2, SIDE / 2, SIDE])
DOWN = np.array([0.0, 0.0, -1.0])


def _block(poisson_ratio: float) -> Body:
    solid = make_solid(box((SIDE, SIDE, SIDE)), edge=8e-3, fine=[(TOP, 4e-3, 4e-3)])
    held = solid.nodes[:, 2] == 0.0
    return make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=poisson_ratio)


def _entered(body: Body, tip: Tip, moved: np.ndarray, travel: float) -> float:
    """How deep the deepest node of the top is in a tip."""
    top = body.solid.nodes[:, 2] == SIDE
    return -float(tip.distance(travel, (body.solid.nodes + moved)[top])[0].min())


@pytest.mark.parametrize("stretch", [0.97, 0.9])
def test_a_plate_on_a_block_is_the_closed_form(stretch: float) -> None:
    """Without Poisson's ratio no width changes: P = mu (stretch - 1 / stretch). From 0.86 on the
    block would lean to a side."""
    body = _block(0.0)
    plate = Tip(FlatFace(2 * SIDE), TOP, DOWN)
    force = SIDE**2 * SHEAR * (1.0 / stretch - stretch)
    pressed = press_finite(body, plate, force)
    expected = (stretch - 1.0) * body.solid.nodes[:, 2]
    # Quadratic elements hold the field exactly; Newton leaves 1e-7 of the force.
    np.testing.assert_allclose(pressed.displacement[:, 2], expected, atol=1e-6 * SIDE)
    assert np.abs(pressed.displacement[:, :2]).max() < 1e-6 * SIDE
    # The springs give by pressure over 1000 mu / R.
    pressure = force / SIDE**2
    depth = (1.0 - stretch) * SIDE + pressure * plate.radius / (1000.0 * SHEAR)
    assert pressed.travel == pytest.approx(depth, rel=1e-5)


def test_a_ball_is_in_balance_and_enters_by_little() -> None:
    body, ball = _block(0.3), Tip(Sphere(6e-3), TOP, DOWN)
    force = 1.5
    pressed = press_finite(body, ball, force)
    inner = internal_forces(
        NeoHookean(*body.lame), quadratic_basis(body.solid), pressed.displacement
    )
    reaction = inner[body.held].sum(axis=0)
    # Newton leaves 1e-7; across, the block's mesh is not symmetric.
    assert reaction[2] == pytest.approx(force, rel=1e-5)
    assert np.abs(reaction[:2]).max() < 0.05 * force
    depth = pressed.travel + ball.radius
    assert depth > 0.2 * ball.radius
    # Pressures of twice the modulus, and more in the middle, over springs of 100 mu / R.
    assert _entered(body, ball, pressed.displacement, pressed.travel) < 0.04 * ball.radius
    # It is at rest there.
    again = press_finite(body, ball, force, start=pressed)
    np.testing.assert_array_equal(again.displacement, pressed.displacement)
    assert again.travel == pressed.travel


def test_what_cannot_be() -> None:
    body, ball = _block(0.3), Tip(Sphere(6e-3), TOP, DOWN)
    with pytest.raises(InputError, match="the force is -1"):
        press_finite(body, ball, -1.0)
    with pytest.raises(NotConvergedError, match="of the force under the tool"):
        press_finite(body, ball, 1e4)


def test_a_punch_ends_at_its_rim() -> None:
    body, punch = _block(0.3), Tip(FlatFace(4e-3), TOP, DOWN)
    pressed = press_finite(body, punch, 1.0)
    nodes = body.solid.nodes
    top = nodes[:, 2] == SIDE
    away = np.linalg.norm(nodes[:, :2] - TOP[:2], axis=1)
    # A face without end would push all of the top down; on a half space, a flat face of radius a
    # pushes down (2 / pi) asin(a / r) = 0.29 of it at 9 mm.
    outside = pressed.displacement[top & (away > 9e-3), 2]
    assert -outside.min() < 0.35 * pressed.travel
    under = pressed.displacement[top & (away < 3e-3), 2]
    # It gives by pressure over 1000 mu / R, more towards the rim.
    assert -under.min() == pytest.approx(pressed.travel, rel=0.03)


def test_skin_that_is_drawn_in_under_a_rim_stays_below_the_face() -> None:
    body, punch, force = _block(0.3), Tip(FlatFace(4e-3), TOP, DOWN), 1.5
    pressed = press_finite(body, punch, force)
    nodes, facets = body.solid.nodes, body.solid.facets
    top = facets[(nodes[facets][:, :, 2] == SIDE).all(axis=1)]
    shape = quadratic_shapes(facet_samples())
    skin = np.einsum("vq,fva->fqa", shape, (nodes + pressed.displacement)[top]).reshape(-1, 3)
    entered = -punch.distance(pressed.travel, skin)[0]
    under = entered[punch.radial_distance(skin) < 0.95 * punch.radius]
    # Springs give by a thousandth of the radius where the pressure is mu; in elements as large as
    # the face it is less than six times its mean.
    mean = force / (np.pi * punch.radius**2 * SHEAR)
    assert under.max() < 6.0 * mean * 1e-3 * punch.radius


@pytest.mark.parametrize("tip", [Tip(Sphere(6e-3), TOP, DOWN), Tip(FlatFace(4e-3), TOP, DOWN)])
def test_slopes_are_those_of_the_presses(tip: Tip) -> None:
    """By the logarithm of the force, Lame's lambda and the stiffening."""
    body, force, law = _block(0.3), 0.8, yeoh(2.0)
    mu, lame = body.lame
    press = press_finite(body, tip, force, law=law)
    others = [law(mu, lame + mu), yeoh(3.0)(mu, lame)]
    derivatives = press_slopes(body, tip, force, press, law=law(mu, lame), others=others)
    step = 2e-3
    laws = {
        "force": lambda _: law,
        "lame": lambda share: lambda mu, lame: law(mu, lame + share * mu),
        "stiffening": lambda share: yeoh(2.0 + share),
    }
    for column, (by, changed) in zip(derivatives.T, laws.items(), strict=True):
        ends = [
            press_finite(
                body,
                tip,
                force * (np.exp(share) if by == "force" else 1.0),
                law=changed(share),
                start=press,
            ).displacement.ravel()
            for share in (step, -step)
        ]
        expected = (ends[0] - ends[1]) / (2 * step)
        # The tangent leaves out how normals turn under the ball, 5 %, and how skin is drawn in
        # under the rim of the face, 3 %.
        part = 0.1 if isinstance(tip.tool, Sphere) else 0.05
        assert np.linalg.norm(column - expected) < part * np.linalg.norm(expected), by


def _sag(body: Body, pull: np.ndarray, law: LawOf = NeoHookean) -> Sag:
    """Under a weight per volume, (3,) [N/m^3]; its slopes are those of a material that stiffens
    by 2."""
    weight = np.outer(nodal_volumes(body.solid), pull)
    moved, (mu, lame) = solve_finite(body, weight, law=law), body.lame
    others = [law(mu, lame + mu), yeoh(3.0)(mu, lame)]
    return Sag(weight, moved, load_slopes(body, weight, moved, law=law(mu, lame), others=others))


@pytest.mark.parametrize("direction", [-1.0, 1.0])
def test_a_plate_on_a_block_that_sags_is_the_closed_form(direction: float) -> None:
    """Without Poisson's ratio the stretch at a height z is that of what presses there, the force
    and the weight above: P = mu (stretch - 1 / stretch); on a block that stands or hangs."""
    body, plate, pull = _block(0.0), Tip(FlatFace(2 * SIDE), TOP, DOWN), 0.1 * SHEAR / SIDE
    force = 0.1 * SIDE**2 * SHEAR
    pressed = press_finite(
        body, plate, force, sag=_sag(body, np.array([0.0, 0.0, direction * pull]))
    )
    height = body.solid.nodes[:, 2]
    z = np.linspace(0.0, SIDE, 2001)
    pressure = force / SIDE**2 - direction * pull * (SIDE - z)
    stretch = np.sqrt(1.0 + (0.5 * pressure / SHEAR) ** 2) - 0.5 * pressure / SHEAR
    moved = np.append(0.0, np.cumsum(0.5 * (stretch[1:] + stretch[:-1] - 2.0) * np.diff(z)))
    # Quadratic elements of a third of the side: of what the weight adds, which is 5 % of the side
    # and nearly a parabola, little is left.
    expected = np.interp(height, z, moved)
    np.testing.assert_allclose(pressed.displacement[:, 2], expected, atol=2e-5 * SIDE)
    assert np.abs(pressed.displacement[:, :2]).max() < 2e-5 * SIDE


@pytest.mark.parametrize("tool", [Sphere(6e-3), FlatFace(4e-3)])
def test_no_weight_is_no_change(tool: Sphere | FlatFace) -> None:
    body, tip = _block(0.3), Tip(tool, TOP, DOWN)
    heavy, light = (
        press_finite(body, tip, 0.3, sag=sag) for sag in (None, _sag(body, np.zeros(3)))
    )
    np.testing.assert_array_equal(heavy.displacement, light.displacement)
    assert heavy.travel == light.travel


def test_little_weight_is_superposed() -> None:
    """Of weight and push at small strain what is left is of second order. A flat face would level a
    skin that weight has turned, however lightly it is pressed."""
    body, ball, force = _block(0.3), Tip(Sphere(6e-3), TOP, DOWN), 1e-3
    alone, sag = press_finite(body, ball, force), _sag(body, np.array([50.0, 0.0, -100.0]))
    pressed = press_finite(body, ball, force, sag=sag)
    left = pressed.displacement - alone.displacement - sag.displacement
    # The push's strain is about a thousandth, the ball's depth over the size of an element.
    assert np.abs(left).max() < 2e-3 * np.abs(sag.displacement).max()


# As heavy as what presses, towards a side: the skin under the tool moves by a tenth of its radius.
WEIGHT = np.array([6e4, 0.0, -6e4])


@pytest.mark.parametrize("tip", [Tip(Sphere(6e-3), TOP, DOWN), Tip(FlatFace(4e-3), TOP, DOWN)])
def test_slopes_with_weight_are_those_of_the_presses(tip: Tip) -> None:
    """By the logarithm of force and weight, Lame's lambda and the stiffening."""
    body, law = _block(0.3), yeoh(2.0)
    mu, lame = body.lame
    sag = _sag(body, WEIGHT, law)
    press = press_finite(body, tip, 0.8, law=law, sag=sag)
    others = [law(mu, lame + mu), yeoh(3.0)(mu, lame)]
    derivatives = press_slopes(body, tip, 0.8, press, law=law(mu, lame), others=others, sag=sag)

    def pressed(share: float, more: float, stiffer: float) -> np.ndarray:
        def other(mu: float, lame: float) -> Law:
            return yeoh(2.0 + stiffer)(mu, lame + more * mu)

        scale = np.exp(share)
        sag_of_body = _sag(body, scale * WEIGHT, other)
        return press_finite(
            body, tip, 0.8 * scale, law=other, start=press, sag=sag_of_body
        ).displacement

    step = 2e-3
    for column, change in zip(derivatives.T, step * np.eye(3), strict=True):
        expected = (pressed(*change) - pressed(*-change)).ravel() / (2 * step)
        # The tangent leaves out how normals turn under the ball, how skin is drawn in under the rim
        # of the face, and that its rim goes aside with the weight.
        assert np.linalg.norm(column - expected) < 0.15 * np.linalg.norm(expected)
