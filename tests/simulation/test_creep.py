"""Exports of a body that creeps: the numbers in the files of Abaqus, FEBio and SOFA, replayed."""

import importlib
import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from estimate_relaxation import TRUTH, constant, sample_relaxation
from exported_result import written_result

from palpate.records import RelaxationTerm
from palpate.simulation.export import export_fit, read_fit

RISE, END, STEPS = 2.0, 100.0, 20000


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    source = read_fit(written_result(tmp_path_factory.mktemp("creep")))
    modulus = source.estimate.shear_modulus.value
    relaxation = sample_relaxation(1.5 * modulus)
    return replace(source, estimate=replace(source.estimate, relaxation=relaxation))


def replayed(at_once, shares, times):
    """Displacement over force / at_once of a bar of Maxwell elements in parallel under a force that
    rises and is held, by small implicit steps of the elements' own equations."""
    step = END / STEPS
    stiff, stress, x, moved = at_once * shares, np.zeros(len(times)), 0.0, []
    rest = at_once * (1.0 - shares.sum())
    decay = 1.0 / (1.0 + step / times)
    for k in range(1, STEPS + 1):
        force = min(k * step / RISE, 1.0)
        # Each element: s' = G_i x' - s / rho_i; they carry the force together.
        change = force - rest * x - (decay * stress).sum()
        change /= rest + (decay * stiff).sum()
        stress = decay * (stress + stiff * change)
        x += change
        moved.append(x)
    return at_once * np.array(moved)


def wanted():
    time = np.linspace(0.0, END, STEPS + 1)
    return TRUTH.response(time, np.minimum(time / RISE, 1.0))[1:]


def test_abaqus_gets_the_series_that_creeps_as_measured(source, tmp_path):
    export_fit(tmp_path, source, "calculix")
    text = (tmp_path / "viscoelastic.inp").read_text()
    young, ratio = map(float, text.split("MODULI=INSTANTANEOUS\n")[1].split("\n")[0].split(","))
    shear = source.estimate.shear_modulus.value
    assert ratio == pytest.approx(source.estimate.poisson_ratio.value, rel=1e-8)
    assert young == pytest.approx(1.5 * shear * 2.0 * (1.0 + ratio), rel=1e-8)
    rows = text.split("TIME=PRONY\n")[1].split("\n*")[0].splitlines()
    g, k, times = np.array([row.split(",") for row in rows], dtype=float).T
    # Poisson's ratio is constant.
    np.testing.assert_array_equal(g, k)
    # The implicit step is of first order: 5 ms over the shortest time of 2.3 s.
    np.testing.assert_allclose(replayed(young, g, times), wanted(), rtol=2e-3)
    # CalculiX knows no such material, and does not read that file.
    assert "VISCO" not in (tmp_path / "model.inp").read_text()


def test_febio_gets_the_same_with_the_modulus_of_the_long_term(source, tmp_path):
    body = export_fit(tmp_path, source, "febio")
    material = ElementTree.parse(tmp_path / "viscoelastic.xml").getroot().find("material")
    read = {element.tag: float(element.text) for element in material if element.tag != "elastic"}
    weights = np.array([read["g1"], read["g2"]])
    at_once = float(material.find("elastic/E").text) * (1.0 + weights.sum())
    moved = replayed(at_once, weights / (1.0 + weights.sum()), np.array([read["t1"], read["t2"]]))
    np.testing.assert_allclose(moved, wanted(), rtol=2e-3)
    facts = json.loads((tmp_path / "palpate.json").read_text())["relaxation"]
    assert facts["at_once"] == pytest.approx(at_once, rel=1e-8)
    assert facts["long_term"] == pytest.approx(float(material.find("elastic/E").text), rel=1e-8)
    assert [time for _, time in facts["terms"]] == pytest.approx([read["t1"], read["t2"]])
    assert any(re.search("creeps: its modulus was written as at 12 s", note) for note in body.notes)


def moved_by_sofa(scene, force, count):
    """Strain (count, 3, 3) of one element under a given stress at every step of a scene, as the
    solver and branches of SOFA move it at small strain: a branch takes an implicit step whenever
    its force is asked for, once a step, and counts as its spring in the stiffness."""
    spring = scene.find(".//TetrahedronFEMForceField").attrib
    young, ratio = float(spring["youngModulus"]), float(spring["poissonRatio"])
    mu, lame = young / (2 * (1 + ratio)), young * ratio / ((1 + ratio) * (1 - 2 * ratio))
    branches = scene.findall(".//TetrahedronViscoelasticityFEMForceField")
    rows = [[float(x) for x in branch.attrib["ParameterSet"].split()] for branch in branches]
    assert all(branch.attrib["materialName"] == "MaxwellFirstOrder" for branch in branches)
    assert scene.find(".//EulerImplicitSolver").attrib["firstOrder"] == "true"
    step, identity, strain, moved = float(scene.attrib["dt"]), np.eye(3), np.zeros((3, 3)), []
    slid = [np.zeros((3, 3)) for _ in rows]
    stiff, bulk = mu + sum(row[0] for row in rows), lame + sum(row[2] for row in rows)
    for k in range(1, count + 1):
        stress = 2 * mu * strain + lame * np.trace(strain) * identity
        for i, (shear, time, bulk_share) in enumerate(rows):
            slid[i] = (time / step * slid[i] + strain) / (1 + time / step)
            stress = (
                stress + 2 * shear * (strain - slid[i]) + bulk_share * np.trace(strain) * identity
            )
        rest = force(k * step) - stress
        pressure = np.trace(rest) / (2 * stiff + 3 * bulk)
        strain = strain + (rest - bulk * pressure * identity) / (2 * stiff)
        moved.append(strain)
    return step * np.arange(1, count + 1), np.array(moved)


@pytest.mark.parametrize("terms", [1, 2, 3])
def test_sofa_creeps_as_measured(source, tmp_path, terms):
    """Of one to three terms, under shear."""
    shares, times = np.array([0.25, 0.2, 0.15])[:terms], np.array([2.0, 20.0, 60.0])[:terms]
    relaxation = source.estimate.relaxation
    terms_here = tuple(RelaxationTerm(constant(t), g) for t, g in zip(times, shares, strict=True))
    relaxation = replace(relaxation, terms=terms_here)
    export_fit(
        tmp_path, replace(source, estimate=replace(source.estimate, relaxation=relaxation)), "sofa"
    )
    root = ElementTree.parse(tmp_path / "viscoelastic.scn").getroot()
    shear = np.zeros((3, 3))
    shear[0, 1] = shear[1, 0] = 2.0 * relaxation.unrelaxed
    time, moved = moved_by_sofa(root, lambda t: min(t / RISE, 1.0) * shear, 3000)
    exact = replayed(1.0, shares, times)
    moved_there = np.interp(np.linspace(0.0, END, STEPS + 1)[1:], time, moved[:, 0, 1])
    seen = slice(STEPS // 50, round(time[-1] / END * STEPS))
    # The plugin's step is of first order, and of a hundredth of the shortest time.
    np.testing.assert_allclose(moved_there[seen], exact[seen], rtol=0.02)


def test_the_body_of_sofa_is_the_written_one_at_its_age(source, tmp_path):
    """Poisson's ratio, once the shear modulus is the written one; its ends are in the notes."""
    body = export_fit(tmp_path, source, "sofa")
    root = ElementTree.parse(tmp_path / "viscoelastic.scn").getroot()
    material, relaxation = body.material, source.estimate.relaxation
    spring = root.find(".//TetrahedronFEMForceField").attrib
    young, ratio = float(spring["youngModulus"]), float(spring["poissonRatio"])
    lame = young * ratio / ((1 + ratio) * (1 - 2 * ratio))
    written = material.poisson_ratio
    assert 0.5 * lame / (lame + material.shear_modulus) == pytest.approx(written, rel=1e-7)
    long_term = relaxation.unrelaxed * (1.0 - sum(term.share for term in relaxation.terms))
    assert 0.5 * young / (1 + ratio) == pytest.approx(long_term, rel=1e-7)
    at_once = 0.5 * lame / (lame + relaxation.unrelaxed)
    said = f"Poisson's ratio is {at_once:.3f} at once and {ratio:.3f} in the long term"
    assert any(said in note for note in body.notes)


def test_few_nodes_of_sofa_make_all_of_it_softer(source, tmp_path):
    body = export_fit(tmp_path, source, "sofa", nodes=300)
    root = ElementTree.parse(tmp_path / "viscoelastic.scn").getroot()
    rows = [
        field.attrib["ParameterSet"].split()
        for field in root.iter("TetrahedronViscoelasticityFEMForceField")
    ]
    relaxation = source.estimate.relaxation
    softer = body.material.shear_modulus / source.estimate.shear_modulus.value
    assert softer < 1.0
    for (shear, time, bulk), term in zip(rows, relaxation.terms, strict=True):
        assert float(shear) == pytest.approx(softer * term.share * relaxation.unrelaxed, rel=1e-7)
        assert (float(time), float(bulk)) == (pytest.approx(term.time.value), 0.0)


def test_an_elastic_body_has_no_such_files(source, tmp_path):
    relaxation = replace(source.estimate.relaxation, terms=())
    elastic = replace(source, estimate=replace(source.estimate, relaxation=relaxation))
    body = export_fit(tmp_path, elastic, "calculix")
    assert not (tmp_path / "viscoelastic.inp").exists()
    assert json.loads((tmp_path / "palpate.json").read_text())["relaxation"] is None
    assert not any("creeps" in note for note in body.notes)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # Of its own code.
def test_sfepy_creeps_as_measured(source, tmp_path):
    """Another program's elements and memory, with the numbers of the files."""
    pytest.importorskip("sfepy")
    moved_by_sfepy = importlib.import_module("creep_in_sfepy").moved_by_sfepy
    export_fit(tmp_path, source, "calculix", edge=0.01)
    step, count = 0.25, 160
    moved, at_once = moved_by_sfepy(tmp_path, rise=RISE, step=step, count=count)
    time = step * np.arange(count + 1)
    expected = TRUTH.response(time, np.minimum(time / RISE, 1.0))
    share = moved @ at_once / float(at_once @ at_once)
    # Strain is not linear over a step, of a ninth of the shortest time.
    np.testing.assert_allclose(share, expected, atol=1e-4)
