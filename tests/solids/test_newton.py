"""Newton's method where whole steps go too far, and loads that are put on in parts."""

import numpy as np
import pytest

from palpate.solids.finite_strain import find_equilibrium, find_in_increments


class Hollow:
    """sqrt(1 + x^2): whole steps end at -x^3, farther off from wherever |x| > 1."""

    def value(self, at: np.ndarray) -> float:
        return float(np.hypot(1.0, at[0]))

    def forces(self, at: np.ndarray) -> np.ndarray:
        return -at / np.hypot(1.0, at)

    def step(self, at: np.ndarray, forces: np.ndarray) -> np.ndarray | None:
        return forces * np.hypot(1.0, at) ** 3 if abs(at[0]) < 50.0 else None


def test_steps_are_shortened_until_it_rests() -> None:
    found = find_equilibrium(Hollow(), np.array([5.0]), tolerance=1e-9)
    assert found is not None
    assert abs(found[0]) < 1e-9


def test_an_unstable_place_is_said() -> None:
    assert find_equilibrium(Hollow(), np.array([60.0]), tolerance=1e-9) is None


@pytest.mark.parametrize(("bears", "done"), [(1.0, 1.0), (0.6, 0.6)])
def test_a_load_is_put_on_in_parts(bears: float, done: float) -> None:
    """As a body that takes three tenths at once, and so much in all."""

    def find(share: float, at: np.ndarray) -> np.ndarray | None:
        return np.array([share]) if share <= min(at[0] + 0.3, bears) else None

    found, reached = find_in_increments(find, np.zeros(1))
    # The last part tried is the smallest, a thousandth.
    assert reached == pytest.approx(done, abs=2e-3)
    assert found[0] == reached
