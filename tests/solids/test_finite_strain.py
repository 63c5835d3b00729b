"""Finite strain against the uniaxial closed form, derivatives, limits; Newton's method."""

import numpy as np
import pytest
from scipy.optimize import brentq
from solids.bodies import even_traction, half_ball, smooth_patch, traction_load
from surfaces import box

from palpate.errors import NotConvergedError
from palpate.solids.finite_elements import (
    held_nodes,
    hooke_moduli,
    make_body,
    quadratic_basis,
    solve_load,
)
from palpate.solids.finite_strain import (
    NeoHookean,
    Solver,
    SplitNeoHookean,
    deformation_gradient,
    energy,
    find_equilibrium,
    find_in_increments,
    internal_forces,
    load_slopes,
    solve_finite,
    tangent,
    yeoh,
)
from palpate.solids.tetrahedra import make_solid

SHEAR = 7e4
LAWS = pytest.mark.parametrize(
    "law", [NeoHookean, SplitNeoHookean, yeoh(3.0), yeoh(3.0, SplitNeoHookean)]
)


@pytest.fixture(scope="module")
def block():
    mesh = box((0.03, 0.02, 0.02))
    solid = make_solid(mesh, edge=0.01)
    return make_body(solid, solid.nodes[:, 2] == 0.0, shear_modulus=SHEAR, poisson_ratio=0.3)


@pytest.fixture(scope="module")
def basis(block):
    return quadratic_basis(block.solid)


def wavy(block, size):
    x = block.solid.nodes / 0.02
    field = np.column_stack(
        [np.sin(2 * x[:, 1]), x[:, 0] * x[:, 2], np.cos(x[:, 0]) - x[:, 2] ** 2]
    )
    return size * field


@LAWS
def test_forces_are_the_slope_of_the_energy(block, basis, law):
    at, along = wavy(block, 2e-3), wavy(block, 1.0)[::-1]
    step = 1e-7
    ahead, behind = (energy(law(*block.lame), basis, at + s * step * along) for s in (1, -1))
    force = internal_forces(law(*block.lame), basis, at)
    # Central differences: step^2 against rounding over step.
    assert (force * along).sum() == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)


@LAWS
def test_tangent_is_the_slope_of_the_forces(block, basis, law):
    at, along = wavy(block, 2e-3), wavy(block, 1.0)[::-1]
    step = 1e-7
    ahead, behind = (
        internal_forces(law(*block.lame), basis, at + s * step * along) for s in (1, -1)
    )
    matrix = tangent(law(*block.lame), basis, at)
    change = (matrix @ along.ravel()).reshape(-1, 3)
    other = (ahead - behind) / (2 * step)
    np.testing.assert_allclose(change, other, atol=1e-6 * np.abs(other).max())


@LAWS
def test_moduli_at_rest_are_hookes(block, basis, law):
    still = deformation_gradient(basis, np.zeros_like(block.solid.nodes))
    moduli = law(*block.lame).moduli(still)
    hooke = hooke_moduli(SHEAR, 0.3)
    # Rounding.
    np.testing.assert_allclose(moduli, hooke[..., None, None] + 0.0 * moduli, atol=1e-12 * SHEAR)


@LAWS
def test_a_turned_body_has_no_energy(block, basis, law):
    c, s = np.cos(1.0), np.sin(1.0)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    at = block.solid.nodes @ turn.T - block.solid.nodes
    assert abs(energy(law(*block.lame), basis, at)) < 1e-12 * SHEAR * 0.03 * 0.02**2
    assert np.abs(internal_forces(law(*block.lame), basis, at)).max() < 1e-12 * SHEAR * 0.02**2


def test_shape_and_volume_are_apart_in_the_split_law() -> None:
    law = SplitNeoHookean(SHEAR, 2 * SHEAR)
    larger, sheared = 1.2 * np.eye(3), np.eye(3) + 0.5 * np.eye(3, k=2)
    swollen, slid = (
        float(law.density(gradient[:, :, None, None]).item()) for gradient in (larger, sheared)
    )
    # K is 8/3 mu; rounding.
    assert swollen == pytest.approx(0.5 * (8 / 3 * SHEAR) * (1.2**3 - 1.0) ** 2, rel=1e-12)
    assert slid == pytest.approx(0.5 * SHEAR * 0.5**2, rel=1e-12)


@pytest.mark.parametrize("stretch", [0.7, 1.3])
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45])
@pytest.mark.parametrize("stiffening", [0.0, 2.0])
def test_uniaxial_stretch_is_in_equilibrium(block, basis, stretch, poisson, stiffening):
    """Sides free: the nominal stress P is 0 across; in principal stretches a, b, b with J = a b^2
    and I = (a^2 + 2 b^2) J^(-2/3), P_i = mu (l_i - 1/l_i) + lambda ln J / l_i
    + 2 mu stiffening (I - 3) (J^(-2/3) l_i - I / (3 l_i))."""
    lame = 2 * SHEAR * poisson / (1 - 2 * poisson)

    def nominal_stress(along, side):
        volume = stretch * side**2
        scale = volume ** (-2 / 3)
        shape = (stretch**2 + 2 * side**2) * scale
        hooke = SHEAR * (along - 1 / along) + lame * np.log(volume) / along
        return hooke + 2 * SHEAR * stiffening * (shape - 3) * (scale * along - shape / (3 * along))

    side = brentq(lambda b: nominal_stress(b, b), 0.3, 3.0, xtol=1e-15)
    nominal = nominal_stress(stretch, side)
    body = make_body(block.solid, block.held, shear_modulus=SHEAR, poisson_ratio=poisson)
    nodes = block.solid.nodes
    at = nodes * (np.array([side, side, stretch]) - 1.0)
    inner = internal_forces(yeoh(stiffening)(*body.lame), basis, at)
    ends = sum(
        traction_load(
            block.solid,
            even_traction([0.0, 0.0, sign * nominal]),
            lambda x, z=z: np.abs(x[2] - z) < 1e-9,
        )
        for z, sign in ((0.02, 1.0), (0.0, -1.0))
    )
    # Rounding.
    np.testing.assert_allclose(inner, ends, atol=1e-9 * SHEAR * 0.02**2)


def top_load(block, force):
    """A force spread evenly over the upper face."""
    return traction_load(
        block.solid,
        even_traction(np.array(force) / (0.03 * 0.02)),
        lambda x: np.abs(x[2] - 0.02) < 1e-9,
    )


def test_drawn_block_without_sideways_strain_is_the_closed_form(block, basis):
    """Poisson's ratio 0: the clamped end changes nothing, as nothing moves sideways."""
    body = make_body(block.solid, block.held, shear_modulus=SHEAR, poisson_ratio=0.0)
    stretch = 1.3
    # At nu = 0 lambda is 0, and free sides stay where they are (b = 1).
    force = SHEAR * (stretch - 1 / stretch) * 0.03 * 0.02
    solved = solve_finite(body, top_load(block, np.array([0.0, 0.0, force])))
    exact = (stretch - 1.0) * block.solid.nodes[:, 2]
    np.testing.assert_allclose(solved[:, 2], exact, atol=1e-9 * 0.02)
    np.testing.assert_allclose(solved[:, :2], 0.0, atol=1e-9 * 0.02)
    reaction = internal_forces(NeoHookean(*body.lame), basis, solved)[body.held].sum(axis=0)
    np.testing.assert_allclose(reaction, [0.0, 0.0, -force], atol=1e-9 * abs(force))
    stored = 0.5 * SHEAR * (stretch**2 - 1) - SHEAR * np.log(stretch)
    law = NeoHookean(*body.lame)
    # Of the load 1e-9 may be left.
    assert energy(law, basis, solved) == pytest.approx(stored * 0.03 * 0.02 * 0.02, rel=3e-9)


def test_a_sheared_block_stiffens_as_it_says() -> None:
    """In simple shear by s the secant modulus is mu (1 + 2 stiffening s^2)."""
    slid = np.eye(3)[:, :, None, None] + 0.0
    slid[0, 1] = 0.2
    stress = yeoh(3.0, SplitNeoHookean)(SHEAR, 2 * SHEAR).stress(slid)
    # Rounding.
    assert stress[0, 1].item() == pytest.approx(0.2 * SHEAR * 1.24, rel=1e-12)


def test_stiffening_is_of_third_order_in_the_load(block):
    gap = []
    for force in (0.8, 0.4):
        load = top_load(block, np.array([0.5 * force, 0.0, -force]))
        stiff, plain = (solve_finite(block, load, law=law) for law in (yeoh(3.0), NeoHookean))
        gap.append(np.linalg.norm(stiff - plain))
    # A fourth order of some percent is left.
    assert gap[0] / gap[1] == pytest.approx(8.0, rel=0.1)


def test_slopes_are_those_of_the_solutions(block):
    """By the logarithm of the load, Lame's lambda and the stiffening."""
    mu, lame = block.lame
    load = top_load(block, np.array([2.0, 0.0, -4.0]))
    law = yeoh(2.0)
    at = solve_finite(block, load, law=law)
    others = [law(mu, lame + 1e4), yeoh(3.0)(mu, lame)]
    derivatives = load_slopes(block, load, at, law=law(mu, lame), others=others)
    step = 1e-3

    def change(share: float, factor: float, by: str) -> np.ndarray:
        used = {
            "load": law,
            "lame": lambda mu, lame: law(mu, lame + share * 1e4),
            "stiffening": yeoh(2.0 + share),
        }[by]
        return solve_finite(block, factor * load, law=used, start=at).ravel()

    for column, by in zip(derivatives.T, ("load", "lame", "stiffening"), strict=True):
        ahead, behind = (
            change(s * step, np.exp(s * step) if by == "load" else 1.0, by) for s in (1, -1)
        )
        expected = (ahead - behind) / (2 * step)
        # Central differences: step^2, and Newton's 1e-9 over step.
        np.testing.assert_allclose(column, expected, atol=1e-5 * np.abs(expected).max())


@pytest.mark.slow
def test_a_block_that_buckles_is_refused(block):
    # Euler: pi^2 E I / (4 L^2) = 0.41 mu A for this block, the other end being free to sway.
    body = make_body(block.solid, block.held, shear_modulus=SHEAR, poisson_ratio=0.0)
    with pytest.raises(NotConvergedError, match="buckles"):
        solve_finite(body, top_load(block, np.array([0.0, 0.0, -0.6 * SHEAR * 0.03 * 0.02])))


def test_small_loads_converge_to_the_linear_body_at_first_order(block):
    difference = []
    for force in (0.4, 0.2):
        load = top_load(block, np.array([0.5 * force, 0.0, -force]))
        linear = solve_load(block, load)
        solved = solve_finite(block, load)
        gap = np.linalg.norm(solved - linear)
        difference.append(gap / np.linalg.norm(linear))
    assert difference[0] / difference[1] == pytest.approx(2.0, abs=0.1)


@pytest.mark.slow
def test_half_ball_pressed_far_goes_farther_than_linear(shared_data):
    # A measured 2 mm (linear) at a contact radius of 5.5 mm goes 15 % farther.
    data, solid, support = half_ball(
        shared_data,
        "pole_h80_nu020",
        edge=0.012,
        fine=((np.array([0.0, 0.0, 0.035]), 0.006, 0.003),),
    )
    nu = float(data["nu"])
    shear = float(data["E"]) / 2 / (1 + nu)
    body = make_body(solid, held_nodes(solid, support), shear_modulus=shear, poisson_ratio=nu)
    unit = smooth_patch(solid, data["load_point"], 0.0055, np.array([0.0, 0.0, -1.0]))
    pole = np.linalg.norm(solid.nodes - data["load_point"], axis=1).argmin()
    force = 2e-3 / -solve_load(body, unit)[pole, 2]
    solved = solve_finite(body, force * unit)
    inner = internal_forces(NeoHookean(*body.lame), quadratic_basis(solid), solved)
    reaction = inner[body.held].sum(axis=0)
    # Forces balance to Newton's 1e-9 of the load.
    np.testing.assert_allclose(reaction, [0.0, 0.0, force], atol=1e-8 * force)
    assert 1.08 < -solved[pole, 2] / 2e-3 < 1.22


def test_a_load_beyond_bearing_is_refused(block):
    # A point force on one node tears any mesh.
    load = np.zeros_like(block.solid.nodes)
    load[np.linalg.norm(block.solid.nodes - [0.015, 0.01, 0.02], axis=1).argmin(), 2] = -1e4
    with pytest.raises(NotConvergedError, match="no equilibrium beyond"):
        solve_finite(block, load)


class Hollow:
    """sqrt(1 + x^2): whole steps end at -x^3, farther off from wherever |x| > 1."""

    def value(self, at: np.ndarray) -> float:
        return float(np.hypot(1.0, at[0]))

    def forces(self, at: np.ndarray) -> np.ndarray:
        return -at / np.hypot(1.0, at)

    def solver(self, at: np.ndarray) -> Solver | None:
        size = float(np.hypot(1.0, at[0]) ** 3)
        return (lambda forces: forces * size) if abs(at[0]) < 50.0 else None


def test_steps_are_shortened_until_it_rests() -> None:
    equilibrium = find_equilibrium(Hollow(), np.array([5.0]), tolerance=1e-9)
    assert equilibrium is not None
    assert abs(equilibrium[0][0]) < 1e-9


def test_an_unstable_place_is_said() -> None:
    assert find_equilibrium(Hollow(), np.array([60.0]), tolerance=1e-9) is None


class Stiffening:
    """x^2 / 2 + (hard x)^4 / 4 - x; how often its tangent was made is counted."""

    def __init__(self, hard: float) -> None:
        self.hard, self.tangents = hard, 0

    def value(self, at: np.ndarray) -> float:
        return float(0.5 * at[0] ** 2 + 0.25 * (self.hard * at[0]) ** 4 - at[0])

    def forces(self, at: np.ndarray) -> np.ndarray:
        return 1.0 - at - self.hard**4 * at**3

    def solver(self, at: np.ndarray) -> Solver | None:
        self.tangents += 1
        size = float(1.0 + 3.0 * self.hard**4 * at[0] ** 2)
        return lambda forces: forces / size


def test_a_tangent_is_kept_while_it_serves() -> None:
    soft, hard = Stiffening(0.3), Stiffening(3.0)
    for potential in (soft, hard):
        equilibrium = find_equilibrium(potential, np.zeros(1), tolerance=1e-12)
        assert equilibrium is not None
        assert abs(potential.forces(equilibrium[0])[0]) <= 1e-12
    assert soft.tangents == 1
    assert hard.tangents > 1
    # One that is given, too, and none that leads nowhere.
    for stiff, tangents in ((1.5, 0), (1e9, 1), (-1.0, 1)):
        potential = Stiffening(0.3)
        equilibrium = find_equilibrium(
            potential, np.zeros(1), tolerance=1e-12, solver=lambda x, k=stiff: x / k
        )
        assert equilibrium is not None
        assert abs(potential.forces(equilibrium[0])[0]) <= 1e-12
        assert potential.tangents == tangents


@pytest.mark.parametrize(("bears", "done"), [(1.0, 1.0), (0.6, 0.6)])
def test_a_load_is_put_on_in_parts(bears: float, done: float) -> None:
    """As a body that takes three tenths at once, and so much in all."""

    def find(share: float, at: np.ndarray) -> np.ndarray | None:
        return np.array([share]) if share <= min(at[0] + 0.3, bears) else None

    end, reached = find_in_increments(find, np.zeros(1))
    # The last part tried is the smallest, a thousandth.
    assert reached == pytest.approx(done, abs=2e-3)
    assert end[0] == reached
