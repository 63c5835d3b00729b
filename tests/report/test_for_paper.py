"""What a paper needs of a result: every number is that of the result."""

import csv
from dataclasses import replace

import pytest
from cube_session import cube_session as cube_session
from estimate_samples import SHEAR, YOUNG, constants, sample_result

from palpate.api import Result
from palpate.app.cli import main
from palpate.records import Status, read_session


def _written(result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result.save(tmp_path / "kept")
    assert main(["report", "kept", "--for", "paper"]) == 0
    return tmp_path / "kept-paper"


def _table(path):
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.fixture
def result(cube_session):
    session = read_session(cube_session)
    made = sample_result(session)
    errors = {
        "force_gain": 0.01, "contact_point": 5e-4, "pose_translation": 2e-4,
        "pose_rotation": 0.0035, "length_scale": 0.002,
    }  # fmt: skip
    settings = {"versions": {"palpate": "0.1.0"}, "errors": errors, "noise": "student-t"}
    return Result(session, replace(made, estimate=replace(made.estimate, settings=settings)))


def test_methods_and_tables_hold_the_numbers_of_the_result(result, tmp_path, monkeypatch):
    folder = _written(result, tmp_path, monkeypatch)
    text = (folder / "methods.txt").read_text()
    for words in (
        "from 1 probing with forces of 1.2 to 1.2 N",
        "surface of 218 vertices, 17 % of which was held",
        "gain of the force sensor 1 %, contact points 0.5 mm, pose 0.2 mm, 0.2 degrees",
        "homogeneous, isotropic and linearly elastic, at small strain",
        "E = 60.0 kPa (57.6 to 62.4)",
    ):
        assert words in text
    rows = _table(folder / "constants.csv")
    assert [float(row["value"]) for row in rows] == pytest.approx([SHEAR, 0.3, YOUNG])
    assert [row["unit"] for row in rows] == ["Pa", "1", "Pa"]
    assert r"$E$ & 60.0 $\pm$ 1.2 & 57.6--62.4 & kPa \\" in (folder / "constants.tex").read_text()
    (row,) = _table(folder / "probings.csv")
    assert float(row["force_N"]) == pytest.approx(1.2)
    assert row["prediction_error_m"] == ""


def test_what_is_not_determined_has_no_value(result, tmp_path, monkeypatch):
    known = dict.fromkeys(("shear_modulus", "poisson_ratio"), False) | {"young_modulus": True}
    estimate = replace(
        result.estimate, status=Status.from_identifiable(known), identifiable=known,
        **constants() | {"poisson_ratio": constants(known=False)["poisson_ratio"]},
    )  # fmt: skip
    bent = replace(result, fitted=replace(result.fitted, estimate=estimate))
    folder = _written(bent, tmp_path, monkeypatch)
    rows = {row["constant"]: row for row in _table(folder / "constants.csv")}
    assert (rows["poisson_ratio"]["value"], rows["poisson_ratio"]["determined"]) == ("", "False")
    assert float(rows["young_modulus"]["value"]) == pytest.approx(YOUNG)
    assert "not determined" in (folder / "constants.tex").read_text()
    (row,) = _table(folder / "probings.csv")
    assert row["shear_modulus"] == ""
