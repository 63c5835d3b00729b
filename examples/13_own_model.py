"""Full control: estimate with a model of your own, here a half space in closed form.

python examples/13_own_model.py
"""

from dataclasses import dataclass

import numpy as np

from palpate.estimation import ProbeObservations, fit

YOUNG_MODULUS, POISSON_RATIO = 30e3, 0.40  # truth
SIGMA = 2e-6  # of each component of a displacement [m]


@dataclass(frozen=True)
class HalfSpace:
    """Surface of the half space z < 0 under a point force along z (Boussinesq).

    A response model says how far each observed component moves for a unit force along x, y and z,
    and under the body force, times the shear modulus.
    """

    offset: np.ndarray  # observed points minus contact point (n, 3) [m]

    def value(self, poisson_ratio: float) -> np.ndarray:
        """Displacement times shear modulus (3 n, 4) [m Pa / N]; no force but along z here."""
        r = np.linalg.norm(self.offset, axis=1)
        table = np.zeros((len(r), 3, 4))
        table[:, 2, 2] = (1 - poisson_ratio) / (2 * np.pi * r)
        inward = -(1 - 2 * poisson_ratio) / (4 * np.pi * r**2)
        table[:, :2, 2] = -inward[:, None] * self.offset[:, :2]
        return table.reshape(-1, 4)


def main() -> float:
    """Make noisy observations of one push and fit them; gives Poisson's ratio."""
    rng = np.random.default_rng(4)
    angle, radius = rng.uniform(0, 2 * np.pi, 300), rng.uniform(0.004, 0.02, 300)
    position = np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * radius])
    model = HalfSpace(position)
    force = np.array([0.0, 0.0, -0.5])
    shear = 0.5 * YOUNG_MODULUS / (1 + POISSON_RATIO)
    moved = (model.value(POISSON_RATIO)[:, :3] @ force / shear).reshape(-1, 3)
    observed = ProbeObservations(
        name="push",
        position=position,
        displacement=moved + SIGMA * rng.standard_normal(moved.shape),
        std=np.full(moved.shape, SIGMA),
        force=force,
        force_std=np.array([0.0, 0.0, 0.002]),
        tip_displacement=None,
        tip_displacement_std=None,
        response=model,
    )
    estimate = fit([observed]).estimate
    for name in ("poisson_ratio", "shear_modulus", "young_modulus"):
        constant = getattr(estimate, name)
        print(f"{name} {constant.value:.5g} +- {constant.std:.2g}")
    return estimate.poisson_ratio.value


if __name__ == "__main__":
    main()
