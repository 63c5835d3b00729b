"""The error budget as a table and a picture."""

import numpy as np
import pytest

from palpate.paper.budget import ErrorSource
from palpate.paper.budget_page import budget_picture, budget_table, sizes_table

# nu, G and E: two probings, one draw; and one probing, two draws.
NONE = ErrorSource("none", "", np.array([[0.01, 0.0, 0.03], [-0.01, 0.0, 0.04]]),
                   np.array([[0.002, 0.0, -0.01]]))  # fmt: skip
FORCE = ErrorSource("force noise", "1 N", np.array([[0.02, 0.0, -0.06]]),
                    np.array([[0.003, 0.0, 0.03], [-0.004, 0.0, 0.04]]))  # fmt: skip


def _row(table, number):
    return dict(zip(table.columns, table.rows[number], strict=True))


def test_means_and_root_mean_squares_of_single_and_joint_errors():
    table = budget_table([NONE, FORCE])
    none, force = _row(table, 0), _row(table, 1)
    assert (none["source"], force["source"]) == ("none", "force noise")
    assert sizes_table([NONE, FORCE]).rows[1] == ("force noise", "1 N")
    assert (none["draws"], force["draws"]) == (1, 2)
    assert none["E mean (%)"] == pytest.approx(3.5)
    assert none["E rms (%)"] == pytest.approx(100 * np.sqrt((0.03**2 + 0.04**2) / 2))
    assert none["nu mean"] == pytest.approx(0.0)
    assert none["nu rms"] == pytest.approx(0.01)
    assert none["all: E rms (%)"] == pytest.approx(1.0)
    assert force["E mean (%)"] == pytest.approx(-6.0)
    assert force["all: E rms (%)"] == pytest.approx(100 * np.sqrt((0.03**2 + 0.04**2) / 2))
    assert force["all: nu rms"] == pytest.approx(np.sqrt((0.003**2 + 0.004**2) / 2))


def test_a_larger_error_has_a_longer_bar():
    def inked(factor):
        longer = ErrorSource("a", "", factor * FORCE.single, FORCE.joint)
        widest = ErrorSource("b", "", 4.0 * FORCE.single, FORCE.joint)
        picture = budget_picture([NONE, longer, widest]).astype(int)
        # The bars' pale blue.
        return int((np.abs(picture[..., :3] - [0xC9, 0xE2, 0xF2]).max(axis=2) < 3).sum())

    # None's bars and the widest one's stay: twice the middle one's is its own length more.
    first, second, third = inked(1.0), inked(2.0), inked(3.0)
    assert second - first == pytest.approx(third - second, rel=0.05)
    assert second - first > 1000
