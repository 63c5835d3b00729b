"""Poke a fitted object: how it moves under a push that was never measured.

python examples/02_poke_the_model.py
"""

from pathlib import Path

import numpy as np

from palpate.bem import boundary_system, make_elastic_map, make_surface
from palpate.pipeline import surface_load
from palpate.probe import find_contact_patch
from palpate.records import Contact, read_session

HERE = Path(__file__).parent
FORCE = np.array([0.3, 0.0, -0.8])


def main() -> float:
    """Push the half ball at its pole; gives the largest displacement [m]."""
    session = read_session(HERE / "half_ball")
    system = boundary_system(make_surface(session.mesh, session.held_triangles))
    body = make_elastic_map(system, shear_modulus=60e3 / 2.6, poisson_ratio=0.30)

    pole = session.mesh.vertices[np.argmax(session.mesh.vertices[:, 2])]
    contact = Contact(pole, 0.006, "smooth")
    patch = find_contact_patch(session.mesh, contact, session.held_triangles, name="pole")
    (state,) = body.respond([surface_load(patch)], FORCE[None])

    length = np.linalg.norm(state.displacement, axis=1)
    print(f"pushed by {FORCE} N at {1e3 * pole} mm")
    print(f"largest displacement {1e3 * length.max():.3f} mm")
    print(f"the support answers with {np.round(state.reaction, 4)} N")
    return float(length.max())


if __name__ == "__main__":
    main()
