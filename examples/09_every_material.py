"""One factorisation for every Poisson's ratio: the elastic map of many materials.

python examples/09_every_material.py
"""

from pathlib import Path
from time import perf_counter

import numpy as np

from palpate.bem import (
    boundary_system,
    indentation_corrections,
    load_right_hand,
    make_elastic_map,
    make_reduced_model,
    make_surface,
)
from palpate.pipeline import surface_load
from palpate.probe import find_contact_patch
from palpate.records import read_session

HERE = Path(__file__).parent
FORCE = np.array([0.0, 0.0, -0.75])
SHEAR_MODULUS = 20e3


def main() -> float:
    """Dip of the pole for many ratios; gives the largest departure from a full solution [-]."""
    session = read_session(HERE / "half_ball")
    system = boundary_system(make_surface(session.mesh, session.held_triangles))
    contact = session.probings[0].contact
    patch = find_contact_patch(session.mesh, contact, session.held_triangles, name="pole")
    load = surface_load(patch)
    # The local indentation of the elements around the tool.
    corrections = indentation_corrections(system.surface, [load])
    pole = int(np.argmax(session.mesh.vertices[:, 2]))
    row = 3 * int(np.searchsorted(system.unknowns.free_vertices, pole)) + 2

    start = perf_counter()
    model = make_reduced_model(system, load_right_hand(system, [load], corrections))
    made = perf_counter() - start
    print(f"reduced model in {made:.2f} s")
    errors = []
    for nu in (0.0, 0.1, 0.2, 0.3, 0.4, 0.45, 0.49):
        start = perf_counter()
        weights, _ = model.coefficients(nu)
        per_force = sum(
            direction[row] * weight
            for direction, weight in zip(model.directions, weights, strict=True)
        )
        quick = float(per_force @ FORCE) / SHEAR_MODULUS
        middle = perf_counter()
        body = make_elastic_map(system, shear_modulus=SHEAR_MODULUS, poisson_ratio=nu)
        full = float(body.respond([load], FORCE[None])[0].displacement[pole, 2])
        errors.append(abs(quick / full - 1))
        print(
            f"nu {nu:.2f}: pole dips {-1e3 * quick:.4f} mm, {1e3 * (middle - start):.1f} ms"
            f" against {1e3 * (perf_counter() - middle):.0f} ms for a full solution"
        )
    return max(errors)


if __name__ == "__main__":
    main()
