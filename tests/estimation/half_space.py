"""Closed-form responses for the tests: a half space under point forces, and a thin cantilever."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation import ProbeObservations


@dataclass(frozen=True, slots=True, eq=False)
class HalfSpace:
    """Surface of the half space z < 0 under a point force at `contact`.

    Source
    ------
    Johnson, Contact Mechanics, eqs. 3.18 (normal) and 3.73 to 3.75 (tangential), at z = 0.
    Coordinates turned so that z points out of the solid.
    """

    offset: Float[np.ndarray, "n 3"]  # observed point minus contact point

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "r 4"]:
        nu = poisson_ratio
        x, y = self.offset[:, 0], self.offset[:, 1]
        r = np.hypot(x, y)
        table = np.zeros((len(x), 3, 4))
        table[:, 0, 0] = (1 - nu + nu * (x / r) ** 2) / r
        table[:, 1, 1] = (1 - nu + nu * (y / r) ** 2) / r
        table[:, 0, 1] = table[:, 1, 0] = nu * x * y / r**3
        half = 0.5 * (1 - 2 * nu)
        # A force into the solid draws the surface towards it: u_r < 0 for a push along -z.
        table[:, 0, 2], table[:, 1, 2] = half * x / r**2, half * y / r**2
        table[:, 2, 0], table[:, 2, 1] = -half * x / r**2, -half * y / r**2
        table[:, 2, 2] = (1 - nu) / r
        return (table / (2 * np.pi)).reshape(-1, 4)


@dataclass(frozen=True, slots=True, eq=False)
class Cantilever:
    """A thin beam along x, clamped at 0, loaded at its end: tells Young's modulus only."""

    position: Float[np.ndarray, "n 3"]
    length: float = 0.1
    side: float = 0.01

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "r 4"]:
        return self._shape() / (2 * (1 + poisson_ratio))

    def _shape(self) -> np.ndarray:
        x = self.position[:, 0]
        second_moment = self.side**4 / 12
        bend = x**2 * (3 * self.length - x) / (6 * second_moment)
        table = np.zeros((len(x), 3, 4))
        table[:, 0, 0] = x / self.side**2
        table[:, 1, 1] = table[:, 2, 2] = bend
        return table.reshape(-1, 4)


def surface_grid(count: int, half_width: float) -> Float[np.ndarray, "n 3"]:
    """A square grid of points on the plane z = 0."""
    line = np.linspace(-half_width, half_width, count)
    x, y = np.meshgrid(line, line)
    return np.column_stack([x.ravel(), y.ravel(), np.zeros(count**2)])


def half_space_probes(
    rng: np.random.Generator,
    *,
    count: int = 6,
    grid: int = 12,
    shear_modulus: float = 2.0e4,
    poisson_ratio: float = 0.3,
    noise: float = 0.0,
    force_noise: float = 0.0,
    claimed: bool = True,
    tip: bool = False,
) -> list[ProbeObservations]:
    """Probings of a half space with Gaussian noise on displacement [m] and force (relative)."""
    points = surface_grid(grid, 0.03)
    probes = []
    for k in range(count):
        contact = np.append(rng.uniform(-0.01, 0.01, 2), 0.0)
        offset = points - contact
        near = np.hypot(offset[:, 0], offset[:, 1]) > 0.003
        position = points[near]
        tip_offset = np.array([[0.003, 0.0, 0.0]])
        rows = np.vstack([offset[near], tip_offset]) if tip else offset[near]
        response = HalfSpace(rows)
        force = np.array([*rng.normal(0, 0.2, 2), -rng.uniform(0.4, 0.9)])
        value = response.value(poisson_ratio)
        moved = ((value[:, :3] @ force + value[:, 3]) / shear_modulus).reshape(-1, 3)
        moved = moved + noise * rng.normal(size=moved.shape)
        force_std = np.full(3, force_noise * np.linalg.norm(force))
        n = len(position)
        probes.append(
            ProbeObservations(
                name=f"n{k + 1:02d}",
                position=position,
                displacement=moved[:n],
                std=np.full((n, 3), noise) if claimed and noise else None,
                force=force + force_std * rng.normal(size=3),
                force_std=force_std,
                tip_displacement=moved[n] if tip else None,
                tip_displacement_std=np.full(3, noise) if tip and claimed and noise else None,
                response=response,
            )
        )
    return probes
