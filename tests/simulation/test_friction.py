"""One node against a tool: Signorini's and Coulomb's laws, and faces that look any way."""

import numpy as np
import pytest

from palpate.simulation.contact import ConvexTool, PlacedTool, tool_arrays
from palpate.simulation.contact_response import OPEN, SLIDES, STICKS
from palpate.simulation.friction import node_force
from palpate.simulation.settle import tool_gap


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
        for placed in (PlacedTool(ConvexTool(each, 0.05), np.zeros(3)) for each in (planes, turned))
    ]
    for point in rng.normal(scale=0.02, size=(50, 3)):
        normals = np.empty((2, 3))
        straight, face = tool_gap(both[0], 0, -1, point, normals[0])
        # Distance from the farthest plane, by hand.
        assert straight == pytest.approx((np.abs(point) - half).max(), abs=1e-15)
        found, at = tool_gap(both[1], 0, -1, turn @ point, normals[1])
        assert (found, at) == (pytest.approx(straight, abs=1e-15), face)
        np.testing.assert_allclose(normals[1], turn @ normals[0], atol=1e-15)
