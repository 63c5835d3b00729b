"""The page has the table of the data, and virtual fields are right about a uniform strain."""

import csv

import numpy as np
import pytest

from benchmarks import comparison
from benchmarks.bodies import BODIES
from benchmarks.body_truth import SHEAR_MODULUS, Contact
from benchmarks.comparison import TABLE, lines, virtual_fields
from benchmarks.coverage_of_bodies import Measured, session
from benchmarks.machine import ROOT
from palpate.records import EXACT


def test_the_page_has_the_table_of_the_data():
    with TABLE.open(newline="", encoding="utf-8") as file:
        table = lines(list(csv.DictReader(file)))
    page = (ROOT / "docs" / "comparison.md").read_text(encoding="utf-8")
    assert "\n".join(table) in page


def test_virtual_fields_of_a_uniform_strain_are_exact(monkeypatch):
    monkeypatch.setattr(comparison, "NOISE", 0.0)
    shape = BODIES["block"]
    mesh, top = shape.make(shape.edge), np.array([0.0, 0.0, 45e-3])
    # The box is stretched along z, its sides kept from moving, then sheared along x and along y.
    axial = SHEAR_MODULUS * (2 + 2 * shape.poisson_ratio / (1 - 2 * shape.poisson_ratio))
    area, height = 60e-3 * 45e-3, mesh.vertices[:, 2:]
    along, moduli = np.eye(3)[[2, 0, 1]], (axial, SHEAR_MODULUS, SHEAR_MODULUS)
    moved = np.stack([height * a / (m * area) for a, m in zip(along, moduli, strict=True)])
    body = Measured(
        "block", mesh, shape, mesh.vertices, tuple(Contact(top, a) for a in along), moved, 0.0, 0.0
    )
    young, ratio = virtual_fields(session(body, EXACT, 0.0, 0), body)
    # Rounding only: a plane surface and a linear displacement are exact on any mesh.
    assert young[0] == pytest.approx(body.truth["young_modulus"], rel=1e-9)
    assert ratio[0] == pytest.approx(shape.poisson_ratio, rel=1e-9)
