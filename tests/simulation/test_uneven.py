"""Objects that are not the same everywhere: pushes, Green's functions and files against finite
elements of another assembly."""

import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import meshio
import numpy as np
import pytest
from exported_result import SIDE, written_result

from palpate.errors import InputError
from palpate.field import nodal_load
from palpate.pipeline import poke_session
from palpate.records import ModulusMap
from palpate.simulation import export_fit, make_green_functions, read_fit
from palpate.simulation.estimated_object import (
    exact_material,
    make_estimated_object,
    make_solid_model,
)
from palpate.simulation.green_functions import hat_load
from palpate.solids import make_solid
from palpate.solids.finite_elements import (
    free_part,
    held_nodes,
    hooke_moduli,
    quadratic_basis,
    solve_free,
    stiffness_matrix,
    surface_values,
)
from palpate.solids.sparse_cholesky import factorise

MODULUS, RATIO, ABOVE = 2e4, 0.3, np.log(3.0)


def is_above(x):
    return x[..., 2] > 0.5 * SIDE


def stiff_above(mesh):
    """Three times as stiff in the upper half, give or take a tenth."""
    solid = make_solid(mesh, edge=0.006)
    above = is_above(solid.nodes[solid.elements[:, :4]].mean(axis=1)).astype(float)
    used, corners = np.unique(solid.elements[:, :4], return_inverse=True)
    return ModulusMap(
        solid.nodes[used], corners.reshape(-1, 4), ABOVE * above, 0.1 * above, above > -1.0,
        0.1 * above[None],
    )  # fmt: skip


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    return read_fit(written_result(tmp_path_factory.mktemp("uneven"), stiff_above))


@pytest.fixture(scope="module")
def truth(source):
    """Displacement of all nodes of other elements per nodal forces."""
    solid = make_solid(source.session.mesh, edge=0.005)
    held, basis = held_nodes(solid, source.session.held_triangles), quadratic_basis(solid)
    x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
    moduli = hooke_moduli(MODULUS, RATIO)[..., None, None] * np.exp(ABOVE * is_above(x))
    factor = factorise(free_part(stiffness_matrix(basis, moduli), held), solid.nodes[~held])
    return solid, lambda load: solve_free(held, factor, load)


@pytest.fixture(scope="module")
def model(source):
    material = exact_material(MODULUS, RATIO)
    body = make_estimated_object(source.session, source.estimate, material, modulus=source.modulus)
    return make_solid_model(body, edge=0.008)


def test_a_push_moves_finite_elements_as_it_says(model):
    held, basis = model.held, quadratic_basis(model.solid)
    x = np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1)
    moduli = hooke_moduli(MODULUS, RATIO)[..., None, None] * np.exp(ABOVE * is_above(x))
    factor = factorise(free_part(stiffness_matrix(basis, moduli), held), model.nodes[~held])
    moved = solve_free(held, factor, model.load.reshape(-1, 1)).reshape(-1, 3)
    force, said = model.body.push.force, model.body.push.displacement
    # Elements that the middle cuts; without the map it would be twice as far.
    assert model.share @ moved[model.node] @ force == pytest.approx(said @ force, rel=0.03)


def test_a_negative_standard_deviation_is_refused(source):
    with pytest.raises(InputError, match=r"std is -0\.1 in an element; must not be negative"):
        replace(source.modulus, std=-source.modulus.std)


def test_points_inside_are_refused(source):
    probing = source.session.probings[0]
    with pytest.raises(InputError, match="leave --interior out"):
        poke_session(
            source.session, probing.force, probing.contact, shear_modulus=MODULUS,
            poisson_ratio=RATIO, modulus=source.modulus, interior=np.full((1, 3), 0.02),
        )  # fmt: skip


def green_of(source, modulus):
    vertices = source.session.mesh.vertices
    nodes = np.flatnonzero((vertices[:, 2] > SIDE - 1e-9) | (vertices[:, 0] > SIDE - 1e-9))
    nodes = nodes[vertices[nodes, 2] > 1e-9][::7]
    material = exact_material(MODULUS, RATIO)
    return make_green_functions(source.session, material, modulus=modulus, nodes=nodes)


@pytest.fixture(scope="module")
def green(source):
    # Symmetric and positive definite, or it would not be made.
    return green_of(source, source.modulus)


def test_green_functions_are_those_of_the_uneven_body(source, green, truth):
    solid, solve = truth
    mesh = source.session.mesh
    at = surface_values(solid, mesh.vertices)
    for j in (0, len(green.nodes) // 2):
        hat = hat_load(mesh, int(green.nodes[j]))
        load = nodal_load(mesh, hat.triangles, hat.density, np.array([0.0, 1.0, 0.0]), solid)
        moved = at @ solve(load[:, None]).reshape(-1, 3)
        far = np.linalg.norm(mesh.vertices - mesh.vertices[green.nodes[j]], axis=1) > 0.012
        off = (green.surface[j, 1] - moved)[far]
        # Triangles of 7 mm, elements of 5 to 6 mm, some of which the middle cuts.
        assert np.linalg.norm(off) < 0.04 * np.linalg.norm(moved[far])


def test_stiffer_somewhere_yields_less(source, green):
    size = 3 * len(green.nodes)
    even = green_of(source, None).compliance.reshape(size, size)
    lowest = np.linalg.eigvalsh(even - green.compliance.reshape(size, size)).min()
    # Loewner's order, to the asymmetry of what is symmetrised.
    assert lowest > -0.02 * np.linalg.norm(even, 2)


def test_their_uncertainty_is_that_of_the_map(source, green):
    step = 0.05
    stiffer = replace(
        source.modulus, log_modulus=source.modulus.log_modulus + step * source.modulus.directions[0]
    )
    difference = (green_of(source, stiffer).compliance - green.compliance) / step
    # To first order in half a per cent of a modulus.
    assert np.abs(difference - green.changes[0]).max() < 0.01 * np.abs(difference).max()
    force = np.random.default_rng(0).normal(size=(len(green.nodes), 3))
    expected = np.abs(np.tensordot(difference, force, axes=2))
    assert np.allclose(
        green.displacement_std(force), expected, rtol=0.05, atol=1e-2 * expected.max()
    )


@pytest.mark.parametrize("to", ["calculix", "febio", "vtu", "sofa", "openusd", "mujoco"])
def test_files_have_the_modulus_of_every_element(source, to, tmp_path):
    export_fit(tmp_path, source, to, edge=0.011)
    young = source.estimate.young_modulus.value
    if to == "vtu":
        mesh = meshio.read(tmp_path / "model.vtu")
        moduli = mesh.cell_data["young_modulus"][0].ravel()
        above = is_above(mesh.points[mesh.cells[0].data[:, :4]].mean(axis=1))
    elif to in ("sofa", "openusd"):
        name, separator = ("model.scn", " ") if to == "sofa" else ("model.usda", ", ")
        pattern = 'youngModulus="(.*?)"' if to == "sofa" else r"primvars:youngsModulus = \[(.*?)\]"
        text = re.search(pattern, (tmp_path / name).read_text())[1]
        moduli, above = np.array(text.split(separator), dtype=float), None
    elif to == "febio":
        root = ET.parse(tmp_path / "model.feb").getroot()
        moduli = np.array([float(element.text) for element in root.findall("Material/material/E")])
        counts = [len(group.findall("elem")) for group in root.findall("Mesh/Elements")]
        assert len(counts) == len(moduli) == len(root.findall("MeshDomains/SolidDomain"))
        above = None
    elif to == "mujoco":
        moduli = re.findall(r'elasticity young="(.*?)"', (tmp_path / "model.xml").read_text())
        moduli, above = np.array(moduli, dtype=float), None
    else:
        text = (tmp_path / "model.inp").read_text()
        moduli = np.array(re.findall(r"\*ELASTIC\n(.*?),", text), dtype=float)
        assert text.count("ELSET=BODY1\n") == 1
        above = None
    # Materials differ by steps of two per cent.
    assert moduli.min() == pytest.approx(young, rel=0.011)
    assert moduli.max() == pytest.approx(3.0 * young, rel=0.011)
    if above is not None:
        # Middles near that of the cube may lie in an element of the map on the other side.
        assert ((moduli > 2.0 * young) == above).mean() > 0.85


@pytest.mark.slow
def test_mujoco_moves_the_point_as_the_model_does(source, tmp_path):
    """One flex for each modulus, joined at the nodes they share."""
    pytest.importorskip("mujoco")
    export_fit(tmp_path, source, "mujoco", edge=0.01)
    done = subprocess.run(
        [sys.executable, "replay.py"], cwd=tmp_path, check=True, capture_output=True, text=True,
        timeout=100,
    )  # fmt: skip
    # Linear tetrahedra are stiff, and one modulus would be 2 times off.
    assert float(done.stdout.split()[-1]) < 0.06


def test_a_simulator_of_one_modulus_says_so(source, tmp_path):
    body = export_fit(tmp_path, source, "obj")
    assert any("OBJ takes one modulus" in note for note in body.notes)
