"""End friction: the finite element figures of docs/howto/compression.md."""

import importlib.util
from pathlib import Path

import pytest


@pytest.fixture(scope="module")
def end_friction():
    """The script beside the page."""
    path = Path(__file__).resolve().parents[2] / "docs" / "howto" / "end_friction.py"
    spec = importlib.util.spec_from_file_location("end_friction", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("poisson_ratio", "factor"), [(0.3, 1.097), (0.49, 1.376)])
def test_sticking_ends_of_the_page(end_friction, poisson_ratio, factor):
    found = end_friction.apparent_modulus(5 / 3, 1.0, poisson_ratio, cells=16)
    # The page rounds to 0.0005; 16 cells against 48 differ by less than 0.001.
    assert found == pytest.approx(factor, abs=0.0015)


def test_without_sideways_strain_sticking_ends_change_nothing(end_friction):
    # nu = 0: the cylinder does not want to widen, so E is E, to rounding.
    assert end_friction.apparent_modulus(1.0, 1.0, 0.0, cells=6) == pytest.approx(1.0, abs=1e-9)
