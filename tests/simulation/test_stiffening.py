"""Exports of a material that stiffens: the numbers of Yeoh's law in the files, and who has none."""

import json
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np
import pytest
from exported_result import moved_by_calculix, written_result

from palpate.records import Constant
from palpate.simulation.estimated_object import make_solid_model
from palpate.simulation.export import export_fit, read_fit
from palpate.solids import SplitNeoHookean, make_body, solve_finite, yeoh

STIFFENING = 3.0


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    source = read_fit(written_result(tmp_path_factory.mktemp("stiffening")))
    stiffening = Constant(STIFFENING, 0.2, (2.6, 3.4))
    return replace(source, estimate=replace(source.estimate, stiffening=stiffening))


def checked(source, first, second, bulk):
    """That these are the constants of the law that was estimated."""
    shear, ratio = source.estimate.shear_modulus.value, source.estimate.poisson_ratio.value
    assert first == pytest.approx(0.5 * shear, rel=1e-8)
    law = yeoh(STIFFENING, SplitNeoHookean)(shear, 2.0 * shear * ratio / (1.0 - 2.0 * ratio))
    assert second == pytest.approx(0.5 * law.mu * law.stiffening, rel=1e-8)
    assert bulk == pytest.approx(law.law.bulk, rel=1e-8)


def test_calculix_and_abaqus_get_the_law(source, tmp_path):
    body = export_fit(tmp_path, source, "calculix")
    text = (tmp_path / "model.inp").read_text()
    numbers = text.split("*HYPERELASTIC, YEOH\n")[1].split("\n")[0].split(",")
    first, second, third, *volume = map(float, numbers)
    checked(source, first, second, 2.0 / volume[0])
    # Neither a third term nor higher ones in the volume, which are divided by.
    assert third == 0.0
    assert all(value > 1e8 * volume[0] for value in volume[1:])
    assert "*ELASTIC" not in text
    assert "*STEP, NLGEOM\n" in text
    assert any("Yeoh's law was written with C2 / C1 = 3" in note for note in body.notes)
    assert json.loads((tmp_path / "palpate.json").read_text())["stiffening"] == STIFFENING


def test_calculix_moves_the_point_as_the_law_does(source, tmp_path):
    """Of an object so soft that the law counts."""
    soft = {"shear_modulus": 5e3, "young_modulus": 1.3e4, "poisson_ratio": 0.3}
    constants = {name: Constant(size, 0.0, (size, size)) for name, size in soft.items()}
    softer = replace(source, estimate=replace(source.estimate, **constants))
    body = export_fit(tmp_path, softer, "calculix", edge=0.01)
    by_calculix, model = moved_by_calculix(tmp_path), make_solid_model(body, edge=0.01)
    elements = make_body(model.solid, model.held, shear_modulus=5e3, poisson_ratio=0.3)

    def moved(stiffening):
        law = yeoh(stiffening, SplitNeoHookean)
        return model.share @ solve_finite(elements, model.load, law=law)[model.node]

    wanted = moved(STIFFENING)
    # The same elements, and nine digits of every number; what stiffens is 100 times as much.
    apart = np.linalg.norm(by_calculix - wanted)
    assert apart < 1e-4 * np.linalg.norm(wanted)
    assert apart < 0.01 * np.linalg.norm(wanted - moved(0.0))


def test_febio_gets_the_law(source, tmp_path):
    export_fit(tmp_path, source, "febio")
    material = ElementTree.parse(tmp_path / "model.feb").getroot().find("Material/material")
    assert material.get("type") == "Yeoh"
    checked(source, *(float(material.find(name).text) for name in ("c1", "c2", "k")))


def test_others_say_that_they_have_none(source, tmp_path):
    body = export_fit(tmp_path, source, "sofa")
    assert any("no such law was written for SOFA" in note for note in body.notes)
