"""The response of the touching nodes for as long as contact lasts, and its algebra."""

import numpy as np
import pytest

from palpate.contact import PlacedTool
from palpate.contact.moved_tools import tool_arrays
from palpate.contact.response import (
    REBUILT_AFTER,
    Nodal,
    assign,
    solve,
    updated_response,
)
from palpate.records import Sphere

# Nodes that touch all the time, and those that come in and leave around them.
CORE, RIM = 12, 8


def uneven_compliance(green, nearness):
    """Compliance of a contact whose rim has a node beside each of some of the core: the nearer they
    are, as of narrow triangles, the larger the condition number."""
    count = 3 * (CORE + RIM)
    square = green.compliance.reshape(3 * len(green.nodes), -1)[:count, :count]
    mixed = np.eye(count)
    for k in range(3 * RIM):
        mixed[3 * CORE + k] *= nearness
        mixed[3 * CORE + k, k] = 1.0 - nearness
    compliance = mixed @ square @ mixed.T
    return np.ascontiguousarray(0.5 * (compliance + compliance.T))


def tool(friction):
    """One tool, of which only the friction counts here."""
    tools = [PlacedTool(Sphere(1.0, friction=friction), np.zeros(3))]
    return tool_arrays(tools, tools)


def resting_nodes(count):
    """Nodes that touch nothing."""
    zero, none = np.zeros((count, 3)), np.full(count, -1)
    zeros = np.zeros(count, dtype=np.int64)
    return Nodal(
        zero.copy(), zero.copy(), none.copy(), none.copy(), zeros.copy(), zeros.copy(),
        zero.copy(), zero.copy(), zero.copy(), np.zeros(count),
    )  # fmt: skip


def deviation(response, compliance, touching):
    """Largest difference from the inverse compliance of the touching nodes, relative."""
    rows = (3 * touching[:, None] + np.arange(3)).ravel()
    # Displacement is given of all of them; the sign is that of forces that hold them there.
    fresh = np.linalg.inv(compliance[np.ix_(rows, rows)])
    return np.abs(response - fresh).max() / np.abs(fresh).max()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("nearness", "condition", "tolerance"), [(1.0, 1e2, 5e-14), (0.12, 1e4, 1e-9)]
)
def test_the_updated_response_equals_a_fresh_one_for_as_long_as_contact_lasts(
    green, nearness, condition, tolerance
):
    compliance = uneven_compliance(green, nearness)
    assert np.linalg.cond(compliance) < condition
    nodal, tools = resting_nodes(CORE + RIM), tool(0.3)
    nodal.tool_of[:CORE] = 0
    response, changes = updated_response(np.zeros((0, 0)), 0, compliance, tools, nodal)
    rng, worst = np.random.default_rng(0), 0.0
    for step in range(100_000):
        i = CORE + rng.integers(RIM)
        nodal.tool_of[i] = -1 - nodal.tool_of[i]
        response, changes = updated_response(response, changes, compliance, tools, nodal)
        assert changes <= REBUILT_AFTER
        if step % 199 == 0:
            worst = max(worst, deviation(response, compliance, np.flatnonzero(nodal.given)))
    # Measured: 2e-14 and 3e-10; where it is never built anew, 1e-13 and 3e-9.
    assert worst < tolerance


@pytest.mark.parametrize("size", [0, 1, 2, 7, 40])
def test_a_system_is_solved_as_numpy_solves_it(size):
    rng = np.random.default_rng(size)
    matrix, right = rng.normal(size=(size, size)), rng.normal(size=size)
    # Without pivoting, this would divide by zero.
    np.fill_diagonal(matrix, 0.0 if size > 1 else 2.0)
    expected, solution = np.linalg.solve(matrix, right), right.copy()
    assert solve(matrix.copy(), solution)
    # Rounding, times a condition of a few hundred.
    np.testing.assert_allclose(solution, expected, rtol=1e-10, atol=1e-11)


def test_a_singular_system_is_refused():
    assert not solve(np.array([[1.0, 2.0], [2.0, 4.0]]), np.ones(2))
    assert not solve(np.zeros((3, 3)), np.ones(3))


@pytest.mark.parametrize("values", [np.arange(4), np.linspace(0.0, 1.0, 6).reshape(2, 3)])
def test_all_values_are_assigned(values):
    out = np.zeros_like(values)
    assign(values, out)
    np.testing.assert_array_equal(out, values)
