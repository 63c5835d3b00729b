"""Table 3: the virtual compression test against a closed form, and the truth beside a session."""

import numpy as np
import pytest
from lab.planned_sessions import planned_session

from palpate.lab import Material
from palpate.paper.constants import compression_test, true_material
from palpate.records import read_session


def test_without_lateral_expansion_the_compression_test_is_exact():
    """At nu = 0 the lower end's sticking does nothing: F l = E A dl."""
    test = compression_test(Material(5e4, 0.0))
    # The circle is a polygon of 94 sides, and the faces of the elements leave a little more out.
    assert test.young_modulus == pytest.approx(5e4, rel=4e-3)
    area = np.pi * test.radius**2
    assert test.force == pytest.approx(5e4 * area * test.shortening / test.height, rel=4e-3)


def test_an_end_that_sticks_says_a_little_too_much():
    ratios = [compression_test(Material(5e4, nu)).young_modulus / 5e4 for nu in (0.1, 0.3)]
    # One sticking end of a cylinder as high as wide: percents, more with nu.
    assert 1.0 < ratios[0] < ratios[1] < 1.06


def test_the_modulus_is_in_proportion():
    one, other = (compression_test(Material(young, 0.2)) for young in (1e4, 3e4))
    assert other.young_modulus == pytest.approx(3.0 * one.young_modulus, rel=1e-9)


def test_the_truth_stands_beside_the_session(tmp_path):
    session = read_session(planned_session(tmp_path))
    (tmp_path / "truth.toml").write_text("young_modulus = 52000.0\npoisson_ratio = 0.21\n")
    assert true_material(session) == Material(52e3, 0.21)
