"""Tools on points of a half space, whose compliance is known in closed form: the laws of contact
and friction node by node, and what may not matter."""

from dataclasses import replace

import numpy as np
import pytest

from palpate.contact import ContactState, PlacedTool, gaps, move_tools, untouched
from palpate.errors import InputError
from palpate.records import Cone, FlatFace, Sphere, Tool

COUNT, APART, SHEAR, POISSON = 9, 1e-3, 2e4, 0.3
TOOLS = [Sphere(8e-3), FlatFace(3.2e-3), Cone(6e-3, 1.3)]
FRICTIONS = [0.0, 0.3, np.inf]


def _half_space() -> tuple[np.ndarray, np.ndarray]:
    """Points of a surface z = 0, and their compliance, (n, 3), (3 n, 3 n).

    Johnson, Contact Mechanics (1985), equations 3.75 and 3.76; a point's own is that of a uniform
    pressure and traction on a disc of the area it stands for.
    """
    axis = APART * (np.arange(COUNT) - (COUNT - 1) / 2)
    x, y = (grid.ravel() for grid in np.meshgrid(axis, axis, indexing="ij"))
    points = np.column_stack([x, y, np.zeros_like(x)])
    r = points[:, None] - points
    distance = np.linalg.norm(r, axis=2) + np.eye(len(x)) * 0.5 * APART
    block = np.zeros((len(x), 3, len(x), 3))
    outer = np.einsum("ija,ijb->iajb", r, r) / distance[:, None, :, None] ** 3
    block += POISSON * outer
    for a, size in enumerate((1 - POISSON, 1 - POISSON, 1 - POISSON)):
        block[:, a, :, a] += size / distance
    bend = 0.5 * (1 - 2 * POISSON) * r / distance[..., None] ** 2
    block[:, :2, :, 2] -= bend[..., :2].transpose(0, 2, 1)
    block[:, 2, :, :2] += bend[..., :2].transpose(0, 1, 2)
    return points, block.reshape(3 * len(x), -1) / (2 * np.pi * SHEAR)


REST, COMPLIANCE = _half_space()


def _walk(tool: Tool, way: np.ndarray, turn: np.ndarray | None = None) -> list[ContactState]:
    """The states of a tool along a way of its lowest point, all turned with the surface."""
    turn = np.eye(3) if turn is None else turn
    whole = np.kron(np.eye(len(REST)), turn)
    rest, compliance = REST @ turn.T, whole @ COMPLIANCE @ whole.T
    up = np.array([0.0, 0.0, tool.radius if isinstance(tool, Sphere) else 0.0])
    placed = [PlacedTool(tool, turn @ (lowest + up), turn) for lowest in way]
    states = [untouched(len(rest), placed[:1])]
    for tool_now in placed:
        states.append(move_tools(rest, np.ascontiguousarray(compliance), [tool_now], states[-1]))
    return states


def _way(depth: float, aside: float, steps: int = 12) -> np.ndarray:
    """Down from just above, then to a side."""
    down = np.linspace(-1e-6, depth, steps)[:, None] * [0.0, 0.0, -1.0]
    return np.vstack([down, down[-1] + np.linspace(0.0, aside, steps)[1:, None] * [1.0, 0.3, 0.0]])


def test_the_compliance_is_that_of_a_body() -> None:
    np.testing.assert_allclose(COMPLIANCE, COMPLIANCE.T, atol=1e-12 * COMPLIANCE.max())
    assert np.linalg.eigvalsh(COMPLIANCE).min() > 0.0


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("tool", TOOLS)
def test_forces_obey_contact_and_friction(tool: Tool, friction: float) -> None:
    tool = replace(tool, friction=friction)
    states = _walk(tool, _way(4e-4, 3e-4))
    counts = {len(state.touching) for state in states}
    assert len(counts) > 1
    for state in states[1:]:
        moved = (COMPLIANCE @ state.force.ravel()).reshape(-1, 3)
        size = max(np.abs(state.force).max(), 1e-12)
        np.testing.assert_allclose(state.displacement, moved, atol=1e-12)
        gap, _ = gaps(state.tools[0], REST + moved)
        # Nothing enters beyond what is left of the equations, and what presses touches.
        assert gap.min() > -1e-11
        touching = state.touching
        free = np.setdiff1d(np.arange(len(REST)), touching)
        assert not state.force[free].any()
        press = np.einsum("na,na->n", state.normal[touching], state.force[touching])
        assert (press >= -1e-9 * size).all()
        across = np.linalg.norm(
            state.force[touching] - press[:, None] * state.normal[touching], axis=1
        )
        if np.isfinite(friction):
            assert (across <= friction * press + 1e-9 * size).all()
        np.testing.assert_allclose(state.tool_force[0], -state.force.sum(axis=0), atol=1e-9 * size)
        about = np.cross(REST + moved - state.tools[0].position, -state.force).sum(axis=0)
        np.testing.assert_allclose(state.torque[0], about, atol=1e-9 * size * tool.reach)


@pytest.mark.parametrize("friction", FRICTIONS)
@pytest.mark.parametrize("tool", TOOLS)
def test_it_does_not_matter_how_the_world_is_turned(tool: Tool, friction: float) -> None:
    tool = replace(tool, friction=friction)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    straight, turned = (_walk(tool, _way(4e-4, 3e-4), rotation)[-1] for rotation in (None, turn))
    np.testing.assert_array_equal(turned.touching, straight.touching)
    # What is left of the equations, a part in 1e9 of the largest force.
    off = 1e-7 * np.abs(straight.force).max()
    np.testing.assert_allclose(turned.force @ turn, straight.force, atol=off)
    np.testing.assert_allclose(turned.tool_force @ turn, straight.tool_force, atol=10 * off)


def test_what_sticks_goes_where_the_tool_goes() -> None:
    before, after = _walk(Sphere(8e-3, friction=np.inf), _way(4e-4, 3e-4))[-2:]
    both = np.intersect1d(before.sticking, after.sticking)
    assert len(both) > 6
    step = after.tools[0].position - before.tools[0].position
    moved = (after.displacement - before.displacement)[both]
    np.testing.assert_allclose(moved, np.tile(step, (len(both), 1)), atol=1e-12)


def test_what_slides_is_pulled_against_its_way() -> None:
    state = _walk(Sphere(8e-3, friction=0.2), _way(4e-4, 2e-3, 40))[-1]
    assert not state.sticking.size
    force, press = state.tool_force[0], state.tool_force[0, 2]
    # The ball is held back along its way with nearly all of the coefficient times the press; the
    # surface that it raises ahead of it takes the rest.
    back = -force[:2] @ [1.0, 0.3] / np.hypot(1.0, 0.3)
    assert back == pytest.approx(0.2 * press, rel=0.1)


@pytest.mark.parametrize("friction", FRICTIONS)
def test_a_tool_that_left_leaves_nothing(friction: float) -> None:
    down = _way(4e-4, 1e-4)
    back = down[::-1] + np.array([0.0, 0.0, 1e-5])
    state = _walk(Sphere(8e-3, friction=friction), np.vstack([down, back]))[-1]
    assert not state.touching.size
    # Forces of the last node, as it left, are rounding.
    assert np.abs(state.displacement).max() < 1e-18


def test_without_friction_the_way_does_not_matter() -> None:
    once = _walk(Sphere(8e-3), np.array([[2e-4, 0.0, 1e-6], [2e-4, 0.0, -4e-4]]))[-1]
    often = _walk(Sphere(8e-3), _way(4e-4, 0.0) + np.array([2e-4, 0.0, 0.0]))[-1]
    np.testing.assert_array_equal(often.touching, once.touching)
    np.testing.assert_allclose(often.force, once.force, atol=1e-8 * np.abs(once.force).max())


def test_other_tools_begin_anew() -> None:
    state = untouched(len(REST), [PlacedTool(Sphere(8e-3), np.array([0.0, 0.0, 9e-3]))])
    with pytest.raises(InputError, match="others than before"):
        move_tools(REST, COMPLIANCE, [PlacedTool(Sphere(8e-3), np.zeros(3))], state)
