"""Exports of a body that creeps: the numbers in the files of Abaqus and FEBio, replayed."""

import importlib
import json
import re
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from estimate_relaxation import TRUTH, sample_relaxation
from exported_result import written_result

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
    stiff, own, x, moved = at_once * shares, np.zeros(len(times)), 0.0, []
    rest = at_once * (1.0 - shares.sum())
    decay = 1.0 / (1.0 + step / times)
    for k in range(1, STEPS + 1):
        force = min(k * step / RISE, 1.0)
        # Each element: s' = G_i x' - s / rho_i; they carry the force together.
        change = force - rest * x - (decay * own).sum()
        change /= rest + (decay * stiff).sum()
        own = decay * (own + stiff * change)
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
    read = {each.tag: float(each.text) for each in material if each.tag != "elastic"}
    weights = np.array([read["g1"], read["g2"]])
    at_once = float(material.find("elastic/E").text) * (1.0 + weights.sum())
    found = replayed(at_once, weights / (1.0 + weights.sum()), np.array([read["t1"], read["t2"]]))
    np.testing.assert_allclose(found, wanted(), rtol=2e-3)
    facts = json.loads((tmp_path / "palpate.json").read_text())["relaxation"]
    assert facts["at_once"] == pytest.approx(at_once, rel=1e-8)
    assert facts["long_term"] == pytest.approx(float(material.find("elastic/E").text), rel=1e-8)
    assert [time for _, time in facts["terms"]] == pytest.approx([read["t1"], read["t2"]])
    assert any(re.search("creeps: its modulus was written as at 12 s", note) for note in body.notes)


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
    found = moved @ at_once / float(at_once @ at_once)
    # Strain is not linear over a step, of a ninth of the shortest time.
    np.testing.assert_allclose(found, expected, atol=1e-4)
