"""An estimated object in the files of simulators: what is in them, and what two of these do."""

import json
import re
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace

import meshio
import numpy as np
import pytest
from exported_result import RADIUS, SIDE, moved_by_calculix, written_result
from tool_tractions import traction_of

from palpate.errors import InputError, RecordError
from palpate.geometry import enclosed_volume, read_mesh, unit_normals
from palpate.records import Constant, Status
from palpate.simulation import FORMATS, export_fit, read_fit, surface_formats
from palpate.simulation.estimated_object import (
    exact_material,
    make_estimated_object,
    make_solid_model,
)
from palpate.simulation.green_functions import read_green_functions
from palpate.solids import make_body, solve_load


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return written_result(tmp_path_factory.mktemp("export"))


@pytest.fixture(scope="module")
def source(result):
    return read_fit(result)


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def model(source, cache):
    material = exact_material(2e4, 0.3)
    body = make_estimated_object(source.session, source.estimate, material, cache=cache)
    return make_solid_model(body, edge=0.01)


@pytest.fixture(scope="module")
def exported(source, cache, tmp_path_factory):
    """Folder of every format."""
    folders = {}
    with pytest.MonkeyPatch.context() as patch:
        # Green's functions of a few vertices are as good as those of all.
        patch.setattr(surface_formats, "_NODES", 12)
        _export_all(folders, source, cache, tmp_path_factory)
    return folders


def _export_all(folders, source, cache, tmp_path_factory):
    for name in FORMATS:
        folders[name] = tmp_path_factory.mktemp(name)
        export_fit(folders[name], source, name, edge=0.01, cache=cache)


def test_the_tetrahedra_fill_the_object_in_both_forms(model):
    corner = model.nodes[model.linear]
    volume = np.linalg.det(corner[:, 1:] - corner[:, :1]) / 6
    assert volume.min() > 0.0
    assert len(model.linear) == 8 * len(model.solid.elements)
    # A cube is met exactly: rounding.
    assert volume.sum() == pytest.approx(SIDE**3)
    assert enclosed_volume(model.boundary_surface) == pytest.approx(SIDE**3)
    np.testing.assert_array_equal(model.held, model.nodes[:, 2] < 1e-9)


def test_the_push_is_the_force_at_its_place_in_both_forms(model):
    push = model.body.push
    assert (push.name, push.held_out) == ("n02", True)
    for load in (model.load, model.linear_load):
        np.testing.assert_allclose(load.sum(axis=0), push.force, atol=1e-12)
        moment = np.cross(model.nodes - push.point, load).sum(axis=0)
        # The points under the contact lie symmetric on the squares of the mesh: to a thousandth
        # of the force times its radius.
        assert np.abs(moment).max() < 1e-3 * np.linalg.norm(push.force) * RADIUS
    np.testing.assert_allclose(model.share @ model.nodes[model.node], push.point, atol=1e-12)


def test_the_push_has_the_outward_traction_of_its_tool(model):
    mesh, push = model.body.session.mesh, model.body.push
    contact = replace(push.patch.contact, traction=traction_of("hertz", 0.2))
    turned = replace(push, patch=replace(push.patch, contact=contact))
    body = replace(model.body, push=turned)
    loaded = make_solid_model(body, edge=0.01)
    normal = unit_normals(mesh)[push.patch.triangle]
    for load in (loaded.load, loaded.linear_load):
        np.testing.assert_allclose(load.sum(axis=0), push.force, atol=1e-12)
        # By the definition of the lever; of the push itself, which may lean, there is none.
        offset = (loaded.nodes - push.point) @ (np.eye(3) - np.outer(normal, normal))
        moment = np.einsum("ni,ni->", offset, load)
        pressed = -push.force @ normal
        # Points a sixth of the radius apart, a difference over a tenth of it.
        assert moment == pytest.approx(0.2 * contact.radius * pressed, rel=0.03)


@pytest.mark.parametrize("outward", [0.0, 0.3])
def test_the_push_moves_finite_elements_as_it_says(source, cache, outward):
    """Boundary elements computed it, and its tool's outward traction counts a tenth."""
    probings = [
        replace(probing, contact=replace(probing.contact, traction=traction_of("hertz", outward)))
        for probing in source.session.probings
    ]
    session = replace(source.session, probings=tuple(probings))
    body = make_estimated_object(session, source.estimate, exact_material(2e4, 0.3), cache=cache)
    model = make_solid_model(body, edge=0.008)
    elements = make_body(model.solid, model.held, shear_modulus=2e4, poisson_ratio=0.3)
    moved = model.share @ solve_load(elements, model.load)[model.node]
    force = body.push.force
    # Triangles of the mesh are as wide as the touched circle.
    assert moved @ force == pytest.approx(body.push.displacement @ force, rel=0.01)


def test_facts_and_readme_say_what_was_written(source, exported):
    for name, folder in exported.items():
        facts = json.loads((folder / "palpate.json").read_text())
        young = source.estimate.young_modulus
        assert facts["constants"]["young_modulus"]["ci95"] == list(young.ci95)
        assert facts["written"]["young_modulus"] == pytest.approx(young.value)
        assert facts["push"]["probing"] == "n02"
        readme = (folder / "README.txt").read_text()
        assert FORMATS[name].run in readme
        assert "no density: 1000 kg/m^3 was written" in readme


def written_nodes(name, folder):
    """Nodes and number of tetrahedra of the formats that have them."""
    if name == "vtu":
        mesh = meshio.read(folder / "model.vtu")
        assert mesh.point_data["held"].sum() > 0
        return mesh.points, len(mesh.cells_dict["tetra10"])
    if name == "calculix":
        lines = (folder / "model.inp").read_text().splitlines()
        start, end = (
            lines.index("*NODE, NSET=ALL"),
            lines.index("*ELEMENT, TYPE=C3D10, ELSET=BODY1"),
        )
        nodes = np.array([line.split(",")[1:] for line in lines[start + 1 : end]], dtype=float)
        return nodes, lines.index("*NSET, NSET=HELD") - end - 1
    if name == "febio":
        root = ET.parse(folder / "model.feb").getroot()
        nodes = [list(map(float, n.text.split(","))) for n in root.iter("node") if "id" in n.attrib]
        return np.array(nodes), len(root.findall("Mesh/Elements/elem"))
    if name == "openusd":
        text = (folder / "model.usda").read_text()
        pieces = dict(line.strip().split(" = ", 1) for line in text.splitlines() if " = [" in line)
        nodes = eval(pieces["point3f[] points"])
        return np.array(nodes), len(eval(pieces["int4[] tetVertexIndices"]))
    if name == "mujoco":
        root = ET.parse(folder / "model.xml").getroot()
        (flex,) = root.iter("flex")
        places = {body.attrib["name"]: body.attrib["pos"].split() for body in root.iter("body")}
        offsets = np.array(flex.attrib["vertex"].split(), dtype=float).reshape(-1, 3)
        bodies = flex.attrib["body"].split()
        nodes = offsets + np.array([places.get(body, [0, 0, 0]) for body in bodies], dtype=float)
        return nodes, len(flex.attrib["element"].split()) // 4
    topology = next(ET.parse(folder / "model.scn").getroot().iter("MeshTopology"))
    keys = ("position", "tetrahedra")
    nodes, cells = (np.array(topology.attrib[key].split(), dtype=float) for key in keys)
    return nodes.reshape(-1, 3), cells.size // 4


@pytest.mark.parametrize("name", ["mujoco", "calculix", "febio", "sofa", "vtu", "openusd"])
def test_solids_are_written_with_all_their_nodes(exported, name):
    facts = json.loads((exported[name] / "palpate.json").read_text())["tetrahedra"]
    nodes, cells = written_nodes(name, exported[name])
    assert len(nodes) == facts["nodes"]
    assert cells == facts["linear" if name in ("mujoco", "sofa", "openusd") else "quadratic"]
    # Nine digits.
    np.testing.assert_allclose(np.ptp(nodes, axis=0), SIDE, rtol=1e-8)


def test_febio_has_every_nodal_force_once(exported):
    root = ET.parse(exported["febio"] / "model.feb").getroot()
    rows = [list(map(float, n.text.split(","))) for n in root.findall("MeshData/NodeData/node")]
    loaded = root.find("Mesh/NodeSet[@name='loaded']").text.split(",")
    assert len(rows) == len(loaded)
    np.testing.assert_allclose(np.sum(rows, axis=0), [0.0, 0.0, -1.2], atol=1e-8)


def test_openusd_names_the_constants_for_newton_and_for_physx(source, exported):
    """As `get_tetmesh` of Newton 1.8 reads them from a material of the proposal, without others."""
    text = (exported["openusd"] / "model.usda").read_text()
    assert '"PhysicsVolumeDeformableMaterialAPI"' in text
    young = source.estimate.young_modulus.value
    for space in ("physics", "omniphysics"):
        modulus = float(text.split(f"float {space}:youngsModulus = ")[1].split()[0])
        # Nine digits, of a modulus that is made of G and nu again.
        assert modulus == pytest.approx(young, rel=1e-8)
        assert f"float {space}:poissonsRatio = 0.3\n" in text
        assert f"float {space}:density = " in text


def test_surfaces_and_programs_are_written(source, exported):
    for name in ("obj", "genesis", "isaaclab"):
        mesh = read_mesh(exported[name] / "surface.obj")
        # OBJ holds eight digits or more.
        assert enclosed_volume(mesh) == pytest.approx(SIDE**3, rel=1e-6)
    for name, file in (("genesis", "scene.py"), ("isaaclab", "body.py"), ("mujoco", "replay.py")):
        compile((exported[name] / file).read_text(), file, "exec")
    green = read_green_functions(exported["npz"] / "green.npz")
    assert green.material.shear_modulus == source.estimate.shear_modulus.value


def test_genesis_gets_support_and_push_on_the_vertices_of_its_surface(source, exported):
    folder = exported["genesis"]
    vertices = read_mesh(folder / "surface.obj").vertices
    held = json.loads((folder / "held.json").read_text())["vertices"]
    # Held at the bottom, all of it.
    assert sorted(held) == list(np.flatnonzero(vertices[:, 2] < 1e-9))
    push = json.loads((folder / "replay.json").read_text())
    np.testing.assert_allclose(np.sum(push["nodal_forces"], axis=0), push["force"], atol=1e-12)
    # Pressed from above, within the contact and a tetrahedron around it.
    (contact,) = (
        probing.contact for probing in source.session.probings if probing.name == push["probing"]
    )
    loaded = vertices[push["loaded_nodes"]]
    assert np.linalg.norm(loaded - contact.point, axis=1).max() < 1.5 * RADIUS
    point = push["point_shares"] @ vertices[push["point_nodes"]]
    np.testing.assert_allclose(point, contact.point, atol=1e-8)


def test_every_format_has_one_writer():
    for form in FORMATS.values():
        assert (form.of_solid is None) != (form.of_surface is None)


def test_calculix_moves_the_point_as_the_model_does(exported):
    folder = exported["calculix"]
    moved = moved_by_calculix(folder)
    wanted = json.loads((folder / "replay.json").read_text())["displacement"]
    # Tetrahedra of 6 mm under a contact of 14 mm, triangles of 7 mm.
    assert np.linalg.norm(moved - wanted) < 0.02 * np.linalg.norm(wanted)


@pytest.mark.slow
def test_mujoco_moves_the_point_as_the_model_does(exported):
    pytest.importorskip("mujoco")
    done = subprocess.run(
        [sys.executable, "replay.py"], cwd=exported["mujoco"], check=True, capture_output=True,
        text=True, timeout=100,
    )  # fmt: skip
    # Linear tetrahedra are stiff: 3 mm under a contact of 14 mm.
    assert float(done.stdout.split()[-1]) < 0.05


def test_few_nodes_are_moved_by_the_push_as_many_are(source, cache, tmp_path):
    body = export_fit(tmp_path, source, "mujoco", nodes=300, cache=cache)
    facts = json.loads((tmp_path / "palpate.json").read_text())
    assert facts["tetrahedra"]["nodes"] <= 300
    # Linear tetrahedra are too stiff; so few by a tenth at least.
    young, written = (facts[facts_of]["young_modulus"] for facts_of in ("constants", "written"))
    assert written < 0.9 * young["value"]
    assert written == pytest.approx(body.material.young_modulus)
    assert "nodes are few" in body.notes[-1]
    pytest.importorskip("mujoco")
    done = subprocess.run(
        [sys.executable, "replay.py"], cwd=tmp_path, check=True, capture_output=True, text=True
    )
    # What is sideways is not matched, and 60 steps leave some of the way.
    assert float(done.stdout.split()[-1]) < 0.03


def test_a_ball_pushes_the_flex_of_mujoco_aside(source, cache, tmp_path, monkeypatch):
    mujoco = pytest.importorskip("mujoco")
    # MuJoCo writes its warnings where it runs.
    monkeypatch.chdir(tmp_path)
    export_fit(tmp_path, source, "mujoco", nodes=300, cache=cache)
    push = json.loads((tmp_path / "palpate.json").read_text())["push"]
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "model.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    outward = data.mocap_pos[0] - push["point"]
    outward /= np.linalg.norm(outward)
    for depth in np.linspace(0.0, 1e-3, 50):
        data.mocap_pos[0] = push["point"] + (model.geom_size[0][0] - depth) * outward
        mujoco.mj_step(model, data)
    # A fifth of the depth is what the soft contact may swallow, and rigid triangles bridge over.
    assert 0.8e-3 < np.abs(data.qpos).max() < 1.2e-3


@pytest.mark.parametrize(
    ("name", "sizes", "words"),
    [
        ("calculix", {"nodes": 500}, r"linear tetrahedra \(mujoco, sofa, openusd\), not for"),
        ("mujoco", {"nodes": 500, "edge": 0.01}, "give one"),
        ("mujoco", {"nodes": 20}, "must be 100 to"),
    ],
)
def test_numbers_of_nodes_that_mean_nothing(source, tmp_path, name, sizes, words):
    with pytest.raises(InputError, match=words):
        export_fit(tmp_path, source, name, **sizes)


def with_ratio(source, ratio):
    """The same shear modulus with another Poisson's ratio."""
    young = 2 * source.estimate.shear_modulus.value * (1 + ratio)
    constants = {
        name: Constant(value, 0.01 * abs(value), (value - 0.02 * abs(value), value + abs(value)))
        for name, value in (("poisson_ratio", ratio), ("young_modulus", young))
    }
    return replace(source, estimate=replace(source.estimate, **constants))


@pytest.mark.slow
def test_a_material_outside_a_simulators_range_is_refused_or_said(source, tmp_path):
    with pytest.raises(InputError, match=r"ratio is -0\.2; MuJoCo takes 0 to 0\.495: choose"):
        export_fit(tmp_path, with_ratio(source, -0.2), "mujoco")
    body = export_fit(tmp_path, with_ratio(source, 0.4999), "genesis")
    assert body.notes[0].startswith("Poisson's ratio 0.4999 was written as 0.495")
    assert body.material.poisson_ratio == 0.495
    assert body.material.shear_modulus == source.estimate.shear_modulus.value


def test_what_the_data_do_not_determine_is_written_as_assumed(source, tmp_path):
    known = {"shear_modulus": False, "poisson_ratio": False, "young_modulus": True}
    status = Status.from_identifiable(known)
    undetermined = replace(
        source, estimate=replace(source.estimate, identifiable=known, status=status)
    )
    body = export_fit(tmp_path, undetermined, "obj")
    assert body.notes[0] == status.advice
    facts = json.loads((tmp_path / "palpate.json").read_text())
    determined = {name: constant["determined"] for name, constant in facts["constants"].items()}
    assert determined == known
    readme = (tmp_path / "README.txt").read_text()
    assert re.search(r"poisson_ratio +not determined +\(", readme)
    assert re.search(r"Written: young_modulus \S+ Pa, poisson_ratio \S+ \(assumed\), den", readme)


def test_results_of_other_versions_half_copied_or_without_session_are_refused(tmp_path):
    result = written_result(tmp_path)
    contents = result / "contents.txt"
    whole = contents.read_text()
    contents.write_text(whole.replace("palpate-result/1", "palpate-result/9"))
    with pytest.raises(RecordError, match="is no result of this version"):
        read_fit(result)
    contents.write_text(whole)
    estimate = (result / "estimate.json").read_bytes()
    (result / "estimate.json").write_bytes(estimate[:100])
    with pytest.raises(RecordError, match=r"not as it was written \(estimate\.json: changed\)"):
        read_fit(result)
    (result / "estimate.json").unlink()
    with pytest.raises(RecordError, match=r"estimate\.json: missing"):
        read_fit(result)
    (result / "estimate.json").write_bytes(estimate)
    (tmp_path / "cube").rename(tmp_path / "elsewhere")
    with pytest.raises(RecordError, match=r"not where it was; say where it is now with --session"):
        read_fit(result)
    assert read_fit(result, tmp_path / "elsewhere").session.name == "a [bold] cube"
    with pytest.raises(RecordError, match="is no result of this version"):
        read_fit(result / "estimate.json")
