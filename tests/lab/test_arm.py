"""The arm: where it goes, what it is refused, what the session holds."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.errors import InputError
from palpate.geometry import checked_mesh, enclosed_volume
from palpate.lab import Arm, Head, Material, built_in, read_lab_config
from palpate.lab.arm import _outline, aim, fine_place, probe_body, rod_at, solid_under
from palpate.lab.config import Probe, Specimen
from palpate.lab.facility import probe_tables
from palpate.lab.head import make_head
from palpate.lab.specimens import block, half_ball, toy
from palpate.records import Sphere
from palpate.solids import Tip
from palpate.solids.contact import touch
from palpate.solids.finite_elements import held_nodes, make_body
from palpate.solids.tetrahedra import make_solid

BALL = half_ball(radius=0.04, edge=0.006)
TOP = np.array([0.0, 0.0, 0.04])


def _rng(seed=0):
    return np.random.default_rng(seed)


def _probe(**values):
    return Probe(**{"name": "n01", "point": TOP, "depth": 2e-3, **values})


@pytest.fixture(scope="module")
def body():
    # Coarse: the elements under the tip are a third of what it touches.
    solid = make_solid(BALL, edge=0.015, fine=((TOP, 0.004, 0.0025),))
    base = np.flatnonzero((np.abs(BALL.vertices[BALL.triangles][:, :, 2]) < 1e-9).all(axis=1))
    held = held_nodes(solid, base)
    return make_body(solid, held, shear_modulus=2e4, poisson_ratio=0.3)


def test_an_arm_without_errors_goes_along_the_inward_normal():
    tip = aim(_probe(), Arm(radius=5e-3), BALL, rng=_rng())
    # The mean over the facets around the pole, which are alike: no sixth of one is left.
    np.testing.assert_allclose(tip.direction, [0.0, 0.0, -1.0], atol=1e-9)
    np.testing.assert_allclose(tip.point, [0.0, 0.0, 0.045], atol=1e-9)


@pytest.mark.parametrize("kind", ["sphere", "punch"])
def test_a_slanted_tip_touches_where_it_was_sent(body, kind):
    direction = np.array([0.4, 0.0, -1.0])
    tip = aim(_probe(direction=direction), Arm(tip=kind, radius=5e-3), BALL, rng=_rng())
    np.testing.assert_allclose(tip.direction, direction / np.linalg.norm(direction), atol=1e-12)
    touched = tip.point + touch(body.solid, tip) * tip.direction
    if kind == "sphere":
        # The centre is one radius over the touched place; facets of 6 mm make it uncertain.
        np.testing.assert_allclose(np.linalg.norm(touched - [0, 0, 0]), 0.045, atol=2e-4)
        np.testing.assert_allclose(touched / 0.045 * 0.04, TOP, atol=1e-3)
    else:
        np.testing.assert_allclose(tip.point, TOP, atol=1e-9)


def test_errors_of_the_arm_have_the_spread_that_was_asked_for():
    arm, down = Arm(radius=5e-3, misalignment=2.0, placement=1e-3), np.array([0.0, 0.0, -1.0])
    mesh = block(length=0.08, width=0.08, height=0.04, edge=0.02)
    rng = _rng(1)
    tips = [aim(_probe(direction=down), arm, mesh, rng=rng) for _ in range(600)]
    turned = np.degrees(np.array([tip.direction[:2] for tip in tips]))
    placed = np.array([tip.point - TOP - [0, 0, 5e-3] for tip in tips])
    # 600 draws: 3 % of chance; three of these and more.
    np.testing.assert_allclose(turned.std(axis=0), 2.0, rtol=0.12)
    np.testing.assert_allclose(placed[:, :2].std(axis=0), 1e-3, rtol=0.12)
    np.testing.assert_allclose(placed[:, 2], 0.0, atol=1e-15)
    assert abs(turned.mean(axis=0)).max() < 0.3


@pytest.mark.parametrize(
    ("probe", "text"),
    [
        (_probe(point=0.5 * TOP), r"probe 'n01': its point is .* mm inside the body"),
        (_probe(point=0.9 * TOP), r"its point is 3.9. mm inside the body"),
        (_probe(point=1.5 * TOP), r"its point is 20 mm away from the body"),
        (_probe(direction=TOP), r"its direction \[0.0, 0.0, 1.0\] leads out of the body"),
    ],
)
def test_a_probe_that_cannot_be_done_is_refused(probe, text):
    with pytest.raises(InputError, match=text):
        aim(probe, Arm(radius=5e-3), BALL, rng=_rng())


def test_an_arm_through_an_ear_of_the_toy_is_refused():
    head = toy(radius=0.035, edge=0.004)
    # From the side, below one ear and through the other.
    inner = head.vertices[np.argmin(np.linalg.norm(head.vertices - [0.012, 0.0, 0.066], axis=1))]
    probe = _probe(point=inner, direction=np.array([1.0, 0.0, -0.05]))
    with pytest.raises(InputError, match="the arm would run through the body at"):
        aim(probe, Arm(radius=3e-3), head, rng=_rng())


def test_steps_go_evenly_to_the_depth_or_to_the_force(body):
    tip = aim(_probe(), Arm(radius=6e-3), BALL, rng=_rng())
    deep = probe_body(body, _probe(steps=2), tip, finite=False)
    np.testing.assert_allclose([state.depth for state in deep], [1e-3, 2e-3], rtol=1e-12)
    pushed = probe_body(body, _probe(depth=None, force=0.2, steps=2), tip,
                    finite=False)  # fmt: skip
    forces = [state.force @ tip.direction for state in pushed]
    np.testing.assert_allclose(forces, [0.1, 0.2], rtol=1e-6)


@pytest.mark.slow
def test_a_soft_body_of_finite_strain_gives_way_farther(body):
    tip = aim(_probe(), Arm(radius=6e-3), BALL, rng=_rng())
    probe = _probe(depth=None, force=0.3)
    linear, far = (probe_body(body, probe, tip, finite=finite)[0] for finite in (False, True))
    np.testing.assert_array_equal(far.load, linear.load)
    # Several percent where a tenth of the radius is pressed in, and the tip goes along.
    assert 1.01 < far.depth / linear.depth < 1.3
    np.testing.assert_allclose(
        far.tip_position - linear.tip_position,
        (far.depth - linear.depth) * tip.direction,
        atol=1e-12,
    )


def test_a_sticking_tip_to_a_force_is_refused(body):
    tip = aim(_probe(), Arm(sticking=True), BALL, rng=_rng())
    with pytest.raises(InputError, match="goes to a force with a sticking tip; give a depth"):
        probe_body(body, _probe(depth=None, force=0.2), tip, finite=False)


@pytest.mark.parametrize(("kind", "tool"), [("sphere", "sphere"), ("punch", "flat")])
def test_the_session_holds_where_the_arm_was_sent_and_what_is_on_it(body, kind, tool):
    arm = Arm(tip=kind, radius=6e-3, placement=1e-3)
    tip = aim(_probe(), arm, BALL, rng=_rng(2))
    states = probe_body(body, _probe(), tip, finite=False)
    config = replace(read_lab_config(built_in()["demo"]), arm=arm)
    session, truth = probe_tables(config, _probe(), tip, states, rng=_rng())
    contact = session["contact"]
    np.testing.assert_allclose(truth["direction"], tip.direction)
    assert (contact["tool"], contact["tool_radius"], contact["friction"]) == (tool, 6e-3, "slides")
    np.testing.assert_array_equal(contact["point"], TOP)
    # What nobody sees stands beside the truth. Hertz: the root of radius times depth; a punch
    # touches with its face.
    hertz = np.sqrt(2e-3 / (1 / 6e-3 + 1 / 40e-3))
    touched = truth["contact_radius"]
    assert touched == pytest.approx(hertz if kind == "sphere" else 6e-3, rel=0.15)


@pytest.mark.parametrize(
    ("kind", "probe", "radius"),
    [
        ("sphere", _probe(), np.sqrt(1e-5)),
        ("sphere", _probe(depth=None, force=0.2), np.cbrt(0.75 * 0.2 * 5e-3 / (5e4 / 0.91))),
        ("punch", _probe(), 5e-3),
    ],
)
def test_elements_are_small_where_the_tip_touches(kind, probe, radius):
    tip = aim(probe, Arm(tip=kind, radius=5e-3), BALL, rng=_rng())
    point, reach, edge = fine_place(tip, probe, Material(5e4, 0.3))
    np.testing.assert_array_equal(point, TOP)
    assert (reach, edge) == pytest.approx((radius, radius / 3))


@pytest.mark.slow
def test_the_rim_of_a_punch_lies_on_nodes():
    mesh = block(length=0.05, width=0.04, height=0.03, edge=0.01)
    top = np.array([0.0, 0.0, 0.03])
    specimen = Specimen(mesh, mesh, np.arange(2), {}, 0.012)
    probe, arm = replace(_probe(), point=top), Arm(tip="punch", radius=5e-3, placement=1e-3)
    tip = aim(probe, arm, mesh, rng=_rng(3))
    solid = solid_under(specimen, tip, probe, Material(5e4, 0.3))
    outer = solid.nodes[np.unique(solid.facets)]
    gap = np.linalg.norm(tip.rim(5e-3 / 8)[:, None] - outer, axis=2).min(axis=1)
    # It is where the tip goes, a millimetre beside where it was sent; rounding.
    assert np.linalg.norm(tip.point - top) > 5e-4
    assert gap.max() < 1e-9


@pytest.mark.slow
def test_elements_are_small_where_the_support_ends():
    """Half of the base is held: nodes lie closely along its rim, which crosses the face."""
    mesh = block(length=0.05, width=0.04, height=0.03, edge=0.01)
    corner = mesh.vertices[mesh.triangles]
    held = np.flatnonzero((corner[:, :, 2] < 1e-9).all(axis=1) & (corner[:, :, 0] < 5.1e-3).all(1))
    specimen = Specimen(mesh, mesh, held, {}, 0.012)
    top = np.array([-0.02, 0.0, 0.03])
    probe = replace(_probe(), point=top)
    tip = aim(probe, Arm(radius=5e-3), mesh, rng=_rng(3))
    solid = solid_under(specimen, tip, probe, Material(5e4, 0.3))
    base = solid.nodes[np.unique(solid.facets)]
    base = base[base[:, 2] < 1e-9]

    def nearest(at: np.ndarray) -> float:
        return float(np.linalg.norm(base - at, axis=1).min())

    rim = [nearest(np.array([5e-3, y, 0.0])) for y in np.linspace(-0.018, 0.018, 37)]
    away = [nearest(np.array([0.02, y, 0.0])) for y in np.linspace(-0.018, 0.018, 37)]
    # Held are 40 mm times 30: a circle of 19.5 mm. Corners and middles of edges of a tenth of that
    # are half as far apart, and no place is farther than that from one.
    assert max(rim) < 0.98e-3
    assert max(away) > 1.5e-3


@pytest.mark.parametrize("kind", ["sphere", "punch"])
def test_the_rod_stands_on_the_tip_and_ends_before_the_cameras(body, kind):
    rig = make_head(Head(distance=0.4), BALL)
    tip = aim(_probe(), Arm(tip=kind, radius=5e-3), BALL, rng=_rng())
    state = probe_body(body, _probe(), tip, finite=False)[0]
    rod = rod_at(tip, state.tip_position, rig.cameras)
    checked_mesh(rod)
    along = (rod.vertices - state.tip_position) @ tip.direction
    assert along.max() == pytest.approx(5e-3 if kind == "sphere" else 0.0, abs=1e-12)
    assert 0.15 < -along.min() < 0.21
    beside = np.linalg.norm(
        rod.vertices - state.tip_position - along[:, None] * tip.direction, axis=1
    )
    # The widest ring is a few degrees off the equator.
    assert 0.99 * 5e-3 < beside.max() < 5e-3 * (1 + 1e-9)
    full = np.pi * 5e-3**2 * -along.min()
    if kind == "sphere":
        # A ball, and a shaft of 4 mm from where it leaves the ball, 3 mm above the centre.
        cap = np.pi * 2e-3**2 * (3 * 5e-3 - 2e-3) / 3
        full = 4 / 3 * np.pi * 5e-3**3 - cap + np.pi * 4e-3**2 * (-along.min() - 3e-3)
    assert enclosed_volume(rod) == pytest.approx(full, rel=0.02)


@pytest.mark.parametrize(("radius", "shaft"), [(0.003, 0.003), (0.012, 0.004)])
def test_the_end_of_a_balls_rod_is_the_ball(radius, shaft):
    end = _outline(Tip(Sphere(radius), TOP, np.array([0.0, 0.0, -1.0])))
    np.testing.assert_allclose(np.linalg.norm(end, axis=1), radius, rtol=1e-12)
    np.testing.assert_allclose(end[0], [0.0, -radius], atol=1e-15)
    assert end[-1] == pytest.approx([shaft, np.sqrt(radius**2 - shaft**2)], abs=1e-12)
    # Out and up: from the pole to the shaft, and nowhere back.
    assert (np.diff(end[:, 1]) > 0.0).all()
