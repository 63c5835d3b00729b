"""Finite element truth on exactly the given facets (`../shared/data/halfball_facets`)."""

import numpy as np
import pytest
from elastic_bodies import bump_load, held_part

from palpate.bem import make_elastic_map
from palpate.geometry import TriangleMesh

# Relative L2 error in u. The issue asks for 2 % at 573 and 1 % at 1167 vertices; reached: 1.74 % at
# 237, 0.46 to 1.02 % at 573 (worst at nu 0), 0.24 to 0.29 % at 1167; about a quarter more is
# allowed. The truth itself is good to 0.1 to 0.2 %.
LIMITS = {
    "pole_h80_nu020": 0.022,
    "pole_h50_nu020": 0.0075,
    "pole_h50_nu000": 0.0125,
    "pole_h50_nu045": 0.0075,
    "oblique_h50_nu020": 0.0075,
    "pole_h35_nu020": 0.004,
    "oblique_h35_nu020": 0.004,
}


def solved(folder, name):
    """Relative error of the displacement, reaction and force of one case."""
    with np.load(folder / "halfball_facets" / f"{name}.npz") as case:
        data = {key: case[key] for key in case.files}
    mesh = TriangleMesh(data["V"].astype(float), data["F"].astype(np.int64))
    held = (mesh.vertices[mesh.triangles][:, :, 2] <= 1e-6).all(axis=1)
    nu = float(data["nu"])
    elastic_map = make_elastic_map(
        held_part(mesh, held, smooth=False),
        shear_modulus=float(data["E"]) / 2 / (1 + nu),
        poisson_ratio=nu,
    )
    load = bump_load(mesh, data["load_point"].astype(float), float(data["patch_radius"]))
    force = data["direction"] * float(data["force"])
    (state,) = elastic_map.respond([load], force[None])
    error = np.linalg.norm(state.displacement - data["uV"]) / np.linalg.norm(data["uV"])
    return error, state.reaction, force


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] if "h35" in name else []) for name in LIMITS],
)
def test_displacement_on_the_same_facets(shared_data, name):
    error, reaction, force = solved(shared_data, name)
    assert error < LIMITS[name]
    # Finite elements' reaction is the load to 1e-7; ours is an equation of the system.
    np.testing.assert_allclose(reaction, -force, atol=1e-8)


def test_error_falls_with_the_size_of_the_facets(shared_data):
    coarse, fine = (solved(shared_data, name)[0] for name in ("pole_h80_nu020", "pole_h50_nu020"))
    # From 8 mm to 5 mm; edges of facets are real edges here, so the order is that of their singular
    # stresses, near 2.
    assert np.log(coarse / fine) / np.log(8 / 5) > 1.8
