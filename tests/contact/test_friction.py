"""One node against a tool: Signorini's and Coulomb's laws, and the distance of tools."""

import numpy as np
import pytest

from palpate.contact import PlacedTool, gaps
from palpate.contact.friction import at_rest, node_force
from palpate.contact.moved_tools import tool_arrays
from palpate.contact.response import OPEN, SLIDES, STICKS, set_frame
from palpate.contact.settle import out_of_reach, tool_gap
from palpate.records import Cone, ConvexMesh, FlatFace, Sphere, Tool


def _compliance(rng: np.random.Generator) -> np.ndarray:
    """Of a node: positive definite, as coupled as that of a surface is."""
    part = 0.15 * rng.normal(size=(3, 3))
    return np.diag([1.0, 0.9, 1.1]) + part @ part.T


@pytest.mark.parametrize("friction", [0.1, 0.4, 1.2])
def test_a_node_s_force_obeys_the_laws_of_contact_and_friction(friction: float) -> None:
    rng = np.random.default_rng(round(10 * friction))
    seen = set()
    for _ in range(200):
        w, force = _compliance(rng), np.zeros(3)
        q = rng.normal(size=3) * np.array([1.0, 2.0 * friction, 2.0 * friction])
        state = node_force(w, np.linalg.inv(w), q, friction, SLIDES, force, np.empty(3))
        seen.add(state)
        left, pull = q + w @ force, np.linalg.norm(force[1:])
        if state == OPEN:
            assert not force.any()
            assert left[0] >= -1e-12
            continue
        assert force[0] > 0.0
        assert pull <= friction * force[0] * (1.0 + 1e-9)
        if state == STICKS:
            np.testing.assert_allclose(left, 0.0, atol=1e-12)
            continue
        # Twelve steps, of which each leaves a fifth at most.
        assert abs(left[0]) < 1e-4
        assert pull == pytest.approx(friction * force[0], rel=1e-4)
        slide = left[1:]
        assert slide @ force[1:] == pytest.approx(-np.linalg.norm(slide) * pull, rel=1e-3)
    assert seen == {OPEN, SLIDES, STICKS}


def test_a_tool_that_is_turned_is_as_far_from_a_point_that_is_turned() -> None:
    half = np.array([0.01, 0.02, 0.03])
    planes = np.column_stack([np.vstack([np.eye(3), -np.eye(3)]), np.tile(half, 2)])
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turned = np.column_stack([planes[:, :3] @ turn.T, planes[:, 3]])
    both = [
        tool_arrays([placed], [placed])
        for placed in (
            PlacedTool(ConvexMesh(0.01, faces, 0.05), np.zeros(3)) for faces in (planes, turned)
        )
    ]
    for point in rng.normal(scale=0.02, size=(50, 3)):
        normals = np.empty((2, 3))
        straight, face = tool_gap(both[0], 0, -1, point, normals[0])
        # Distance from the farthest plane, by hand.
        assert straight == pytest.approx((np.abs(point) - half).max(), abs=1e-15)
        gap, at = tool_gap(both[1], 0, -1, turn @ point, normals[1])
        assert (gap, at) == (pytest.approx(straight, abs=1e-15), face)
        np.testing.assert_allclose(normals[1], turn @ normals[0], atol=1e-15)


def test_a_point_is_out_of_reach_of_a_ball_beyond_its_radius_and_the_margin() -> None:
    ball = [PlacedTool(Sphere(0.01), np.array([0.02, 0.0, 0.0]))]
    tools, margin = tool_arrays(ball, ball), 0.002
    for share in (0.5, 0.999, 1.001, 2.0):
        point = np.array([0.02, 0.0, 0.0]) + share * 0.012 * np.array([0.6, 0.0, 0.8])
        assert out_of_reach(tools, 0, point, margin) == (share > 1.0)


@pytest.mark.parametrize("friction", [0.0, 0.3, 1.0])
def test_a_node_that_slides_is_at_rest_under_all_of_its_friction_alone(friction: float) -> None:
    frame = np.empty((1, 3, 3))
    set_frame(np.array([0.0, 0.0, 1.0]), frame[0])
    way, residual = np.array([[1.0, 0.0, 0.0]]), np.array([[1e-4, 0.0, 0.0]])
    for pull in (0.0, 0.5, 0.99, 1.0):
        force = np.array([[-pull * friction * 2.0, 0.0, 2.0]])
        settled = at_rest(
            frame, np.array([friction]), residual, force, np.array([SLIDES]), way.copy(), 1e-3
        )
        # Without friction there is none to lack.
        assert settled == (pull == 1.0 or friction == 0.0)


def test_a_node_that_is_off_the_tool_and_bears_nothing_is_at_rest() -> None:
    frame, none = np.empty((1, 3, 3)), np.zeros((1, 3))
    set_frame(np.array([0.0, 0.0, 1.0]), frame[0])
    for gap in (1e-4, -1e-4):
        residual = np.array([[0.0, 0.0, gap]])
        settled = at_rest(
            frame, np.array([0.3]), residual, none.copy(), np.array([OPEN]), none.copy(), 1e-3
        )
        assert settled == (gap > 0.0)


@pytest.mark.parametrize(
    ("tool", "outline"),
    [
        (FlatFace(0.01), np.array([[0.0, 0.0], [0.01, 0.0], [0.01, 0.04], [0.0, 0.04]])),
        (
            Cone(0.01, np.pi / 6),
            np.array([[0.0, 0.0], [0.01, 0.01 * np.sqrt(3.0)], [0.01, 0.04], [0.0, 0.04]]),
        ),
    ],
)
def test_a_round_tool_is_what_its_outline_sweeps(tool: Tool, outline: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    position = rng.normal(size=3)
    points = rng.uniform([-0.015, -0.015, -0.01], [0.015, 0.015, 0.05], size=(400, 3))
    gap, normal = gaps(PlacedTool(tool, position, turn), position + points @ turn.T)
    section = np.column_stack([np.hypot(points[:, 0], points[:, 1]), points[:, 2]])
    along = np.diff(outline, axis=0)
    across = np.column_stack([along[:, 1], -along[:, 0]])
    across /= np.linalg.norm(across, axis=1)[:, None]
    sides = ((section[:, None] - outline[:-1]) * across).sum(axis=2)
    # Rounding of the place.
    np.testing.assert_allclose(gap, sides.max(axis=1), atol=1e-14)
    # Along its normal the nearest face goes away as fast as the point goes.
    farther = gaps(PlacedTool(tool, position, turn), position + points @ turn.T + 1e-9 * normal)[0]
    np.testing.assert_allclose(farther - gap, 1e-9, rtol=1e-3)


def test_a_node_s_frame_is_orthonormal_and_starts_with_its_normal() -> None:
    for normal in np.vstack([np.eye(3), -np.eye(3), np.random.default_rng(5).normal(size=(20, 3))]):
        normal = normal / np.linalg.norm(normal)
        frame = np.empty((3, 3))
        set_frame(normal, frame)
        np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-15)
        np.testing.assert_array_equal(frame[0], normal)
