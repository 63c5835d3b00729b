"""Stress under a tool, inside the object, where no camera sees it.

python examples/08_stress_inside.py
"""

from pathlib import Path

import numpy as np

from palpate.bem import boundary_system, interior_state, make_elastic_map, make_surface
from palpate.pipeline import surface_load
from palpate.probe import find_contact_patch
from palpate.records import read_session

HERE = Path(__file__).parent
FORCE = np.array([0.0, 0.0, -0.75])
DEPTHS = np.array([0.002, 0.004, 0.008, 0.016])  # below the pole [m]


def von_mises(stress: np.ndarray) -> np.ndarray:
    """The stress that tells how near a ductile body is to yielding, (n, 3, 3) to (n,) [Pa]."""
    pressure = np.trace(stress, axis1=1, axis2=2) / 3
    deviator = stress - pressure[:, None, None] * np.eye(3)
    return np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))


def main() -> float:
    """Press the half ball at its pole; gives the largest stress of von Mises on the axis [Pa]."""
    session = read_session(HERE / "half_ball")
    system = boundary_system(make_surface(session.mesh, session.held_triangles))
    body = make_elastic_map(system, shear_modulus=60e3 / 2.6, poisson_ratio=0.30)
    contact = session.probings[0].contact
    patch = find_contact_patch(session.mesh, contact, session.held_triangles, name="pole")
    points = contact.point - np.outer(DEPTHS, [0.0, 0.0, 1.0])

    inside = interior_state(body, surface_load(patch), FORCE, points)
    equivalent = von_mises(inside.stress)
    print("depth      u_z        s_zz        s_xx   von Mises")
    for depth, moved, stress, strength in zip(
        DEPTHS, inside.displacement, inside.stress, equivalent, strict=True
    ):
        print(
            f"{1e3 * depth:3.0f} mm {1e3 * moved[2]:7.3f} mm {1e-3 * stress[2, 2]:7.2f} kPa"
            f" {1e-3 * stress[0, 0]:7.2f} kPa {1e-3 * strength:7.2f} kPa"
        )
    return float(equivalent.max())


if __name__ == "__main__":
    main()
