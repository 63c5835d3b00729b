"""estimate.json: the format of a session's result, and its round trip."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from palpate.errors import RecordError
from palpate.records import (
    BudgetEntry,
    Constant,
    Estimate,
    FieldEstimate,
    LoadDependence,
    ProbeEstimate,
    RegionEstimate,
    Status,
    StiffPart,
    SupportEstimate,
    interval_text,
    read_estimate,
    verdict_text,
    write_estimate,
)

NAN, INF = math.nan, math.inf
G = Constant(2.1e4, 150.0, (2.07e4, 2.13e4))
NU = Constant(0.21, 0.006, (0.198, 0.222))
E = Constant(5.1e4, 300.0, (5.04e4, 5.16e4))
LOST = Constant(NAN, INF, (-INF, INF))


def _estimate(**changes):
    support = SupportEstimate(2, (1e-4, 0.0, -2e-5), (1e-6,) * 3, (0.0, 1e-3, 0.0), (1e-5,) * 3)
    probe = ProbeEstimate("n01", G, NU, E, 412, 40, 9, 2.1e-5, 3e-5, (support,))
    values = {
        "status": Status.OK,
        "shear_modulus": G,
        "poisson_ratio": NU,
        "young_modulus": E,
        "identifiable": {"shear_modulus": True, "poisson_ratio": True, "young_modulus": True},
        "probes": (probe,),
        "seconds": {"assembly": 0.4, "total": 1.1},
        "method": "reduced",
        "settings": {"poisson_range": [0.0, 0.4999], "seed": 1},
        "notes": ("A sentence.",),
        "budget": (BudgetEntry("gain of the force sensor", 0.01, 2e-5, 0.01),),
    }
    return Estimate(**(values | changes))


@pytest.mark.parametrize("stiffening", [None, Constant(3.0, 0.2, (2.6, 3.4))])
def test_round_trip_is_exact(tmp_path, stiffening):
    load = stiffening and LoadDependence(stiffening, (0.5, 2.0), (0.9, 1.1))
    estimate = _estimate(stiffening=stiffening, load=load)
    write_estimate(tmp_path / "estimate.json", estimate)
    assert read_estimate(tmp_path / "estimate.json") == estimate


def test_a_field_of_moduli_comes_back(tmp_path):
    part = StiffPart((0.01, -0.004, 0.044), 0.016, 5.0, 3.1, 6.4)
    field = FieldEstimate(0.4, 0.011, 174.2, 0.8, (part, replace(part, place_std=1e-3)))
    estimate = _estimate(status=Status.HETEROGENEOUS, field=field)
    write_estimate(tmp_path / "estimate.json", estimate)
    assert read_estimate(tmp_path / "estimate.json") == estimate
    assert field.sentences[1] == (
        "a part about 16 mm across near (10, -4, 44) mm is at least 3.1 times as stiff as the rest"
    )
    assert field.sentences[2] == (
        "a round part near (10, -4, 44) mm (+- 1.0) is 3.1 to 6.4 times as stiff as the rest; at 5"
        " times it is about 16 mm across, and larger if it differs less"
    )
    assert "round parts of another modulus" in field.sentences[0]


def test_regions_come_back(tmp_path):
    known = Constant(6e4, 1.5e3, (57e3, 63e3))
    seen = RegionEstimate("insert", Constant(3.0, 0.1, (2.8, 3.2)), known, known, "", True, True)
    bare = replace(seen, identifiable=False, is_seen=False).without_interval
    estimate = _estimate(regions=(seen, bare))
    write_estimate(tmp_path / "estimate.json", estimate)
    again = read_estimate(tmp_path / "estimate.json").regions
    assert again[0] == seen
    assert str(again[1]) == str(bare)
    assert (seen.note, again[1].note[:28]) == ("", "No push sees region 'insert'")


_NOWHERE = {"centre": [0, None, 0], "size": 0.01, "ratio": 2.0, "low": 1.0, "high": 3.0, "depth": 0}


@pytest.mark.parametrize(
    "change",
    [
        {"std": 0.0},
        {"length": -1.0},
        {"known": 1.2},
        {"parts": [{"size": 0.01}]},
        {"parts": [_NOWHERE]},
    ],
)
def test_an_impossible_field_is_refused(tmp_path, change):
    field = FieldEstimate(0.4, 0.011, 174.2, 0.8)
    write_estimate(tmp_path / "estimate.json", _estimate(field=field))
    content = json.loads((tmp_path / "estimate.json").read_text())
    content["field"] |= change
    (tmp_path / "estimate.json").write_text(json.dumps(content))
    with pytest.raises(RecordError, match="field"):
        read_estimate(tmp_path / "estimate.json")


def test_a_budget_knows_what_is_not_determined(tmp_path):
    file = tmp_path / "estimate.json"
    write_estimate(file, _estimate(budget=(BudgetEntry("mesh", 0.002, NAN, 0.003),)))
    (entry,) = read_estimate(file).budget
    assert (entry.source, entry.shear_modulus, entry.young_modulus) == ("mesh", 0.002, 0.003)
    assert math.isnan(entry.poisson_ratio)
    root = json.loads(file.read_text())
    root["budget"][0]["young_modulus"] = -1.0
    file.write_text(json.dumps(root))
    with pytest.raises(RecordError, match="std of young_modulus is -1; must not be negative"):
        read_estimate(file)
    # Results of earlier versions have none.
    del root["budget"]
    file.write_text(json.dumps(root))
    assert read_estimate(file).budget == ()


FINITE = st.floats(allow_nan=False, allow_infinity=False)
STDS = st.floats(0.0, allow_nan=False, allow_infinity=False)
# Three numbers in any order, and a standard deviation.
CONSTANTS = st.tuples(FINITE, FINITE, FINITE, STDS)
# Poisson's ratio, shear modulus, and the relative standard deviations of G and of 1 + nu.
MATERIALS = st.tuples(st.floats(-0.99, 0.5), st.floats(1e-3, 1e12), *[st.floats(0.0, 1e3)] * 2)
COUNTS = st.integers(0, 10**9)
NAMES = st.text(min_size=1).filter(str.strip)
PROBES = st.tuples(
    NAMES, CONSTANTS, CONSTANTS, CONSTANTS, COUNTS, COUNTS, COUNTS, STDS, st.none() | STDS
)


def _constant(first, second, third, std):
    low, value, high = sorted((first, second, third))
    return Constant(value, std, (low, high))


def _material(ratio, shear, of_shear, of_ratio):
    """G, nu and E of one material with intervals about them."""
    values = (shear, ratio, 2.0 * shear * (1.0 + ratio))
    stds = (of_shear * shear, of_ratio * (1.0 + ratio), (of_shear + of_ratio) * values[2])
    return [Constant(v, s, (v - 2.0 * s, v + 2.0 * s)) for v, s in zip(values, stds, strict=True)]


@settings(max_examples=40, deadline=None)
@given(
    material=MATERIALS,
    probes=st.lists(PROBES, max_size=3, unique_by=lambda probe: probe[0]),
    status=st.sampled_from([None, Status.NOT_CONVERGED]),
    told=st.tuples(*[st.booleans()] * 3),
    seconds=st.dictionaries(st.text(), STDS, max_size=3),
    notes=st.lists(st.text(), max_size=3),
)
def test_whatever_is_written_is_read_back(
    tmp_path_factory, material, probes, status, told, seconds, notes
):
    path = tmp_path_factory.mktemp("law") / "estimate.json"
    names = ("shear_modulus", "poisson_ratio", "young_modulus")
    identifiable = dict(zip(names, told, strict=True))
    estimate = _estimate(
        **dict(zip(names, _material(*material), strict=True)),
        identifiable=identifiable,
        probes=tuple(
            ProbeEstimate(name, *(_constant(*values) for values in three), *rest)
            for name, *three, rest in ((*probe[:4], probe[4:]) for probe in probes)
        ),
        status=status or Status.from_identifiable(identifiable),
        seconds=seconds,
        notes=tuple(notes),
    )
    write_estimate(path, estimate)
    assert read_estimate(path) == estimate


def test_every_key_of_the_format_is_there(tmp_path):
    write_estimate(tmp_path / "estimate.json", _estimate())
    content = json.loads((tmp_path / "estimate.json").read_text())
    assert content["format"] == "palpate-estimate/1"
    assert content["status"] == "ok"
    assert content["shear_modulus"] == {"value": 2.1e4, "std": 150.0, "ci95": [2.07e4, 2.13e4]}
    assert set(content["identifiable"]) == {"shear_modulus", "poisson_ratio", "young_modulus"}
    keys = {"name", "shear_modulus", "poisson_ratio", "young_modulus", "observed", "rejected"}
    assert keys | {"rms_residual"} <= set(content["probes"][0])
    assert content["seconds"]["total"] == 1.1


def test_unknown_numbers_become_null_and_come_back(tmp_path):
    probe = ProbeEstimate("n01", LOST, LOST, LOST, 3, 0, 0, NAN, None)
    determined = {"shear_modulus": True, "poisson_ratio": False, "young_modulus": True}
    settings = {"seed": np.int64(3), "range": np.array([0.0, np.nan]), "on": np.bool_(True)}
    write_estimate(
        tmp_path / "estimate.json",
        _estimate(
            poisson_ratio=LOST,
            probes=(probe,),
            settings=settings,
            identifiable=determined,
            status=Status.from_identifiable(determined),
        ),
    )
    text = (tmp_path / "estimate.json").read_text()
    assert "NaN" not in text
    assert "Infinity" not in text
    again = read_estimate(tmp_path / "estimate.json")
    assert math.isnan(again.poisson_ratio.value)
    assert again.poisson_ratio.ci95 == (-INF, INF)
    assert math.isnan(again.probes[0].rms_residual)
    assert again.probes[0].prediction_error is None
    assert again.settings == {"seed": 3, "range": [0.0, None], "on": True}


def test_the_best_fit_of_a_model_that_does_not_fit_has_no_interval(tmp_path):
    alone = {
        name: replace(getattr(_estimate(), name), std=NAN, ci95=(NAN, NAN))
        for name in ("shear_modulus", "poisson_ratio", "young_modulus")
    }
    given = replace(_estimate(), status=Status.MODEL_CONTRADICTED, details=("More.",), **alone)
    write_estimate(tmp_path / "estimate.json", given)
    again = read_estimate(tmp_path / "estimate.json")
    assert again.young_modulus.value == given.young_modulus.value
    assert all(map(math.isnan, again.young_modulus.ci95))
    assert again.details == ("More.",)
    assert interval_text(again.young_modulus) == "none"
    assert "best fit of a model that does not fit" in verdict_text(again)


def _set(*keys, to):
    """Damage: another value at a place of the document."""

    def damage(content):
        for key in keys[:-1]:
            content = content[key]
        content[keys[-1]] = to

    return damage


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_set("identifiable", "poisson_ratio", to=False), "`identifiable` asks for 'poisson_"),
        (
            _set("identifiable", "poisson_ratio", to="yes"),
            r"\[identifiable\] poisson_ratio: is 'yes'",
        ),
        (_set("status", to="nothing_identifiable"), "`identifiable` asks for 'ok'"),
        (_set("status", to="fine"), "status: is 'fine'"),
        (_set("status", to=["ok"]), r"status: is \['ok'\]"),
        (_set("shear_modulus", "std", to=-1.0), r"\[shear_modulus\]: std is -1"),
        (_set("shear_modulus", "value", to=None), "shear_modulus is identifiable .* has no value"),
        (_set("shear_modulus", "value", to=True), r"\[shear_modulus\] value: is True"),
        (_set("shear_modulus", "value", to=10**400), r"\[shear_modulus\] value: is 1000"),
        (_set("shear_modulus", "value", to=math.nan), r"\[shear_modulus\] value: is nan"),
        (_set("shear_modulus", "value", to=3e4), "the value 30000 lies outside its ci95"),
        (_set("shear_modulus", "ci95", to=[2.2e4, 2.0e4]), "lower end must not exceed"),
        (_set("shear_modulus", "ci95", to=[1.0]), "ci95: is .* two numbers"),
        (_set("shear_modulus", "ci95", to={"0": 1, "1": 2}), "ci95: is .* two numbers"),
        (_set("shear_modulus", to=3), r"shear_modulus: is 3; must be a table"),
        (
            _set("poisson_ratio", to={"value": 3.0, "std": 0.1, "ci95": [2, 4]}),
            "poisson_ratio is 3",
        ),
        (_set("young_modulus", to={"value": 5.61e4, "std": 3e2, "ci95": [5e4, 6e4]}), "2 G"),
        (_set("young_modulus", to={"value": -5.1e4, "std": 3e2, "ci95": [-6e4, 6e4]}), "positive"),
        (_set("probes", to=3), "probes: is 3"),
        (_set("probes", 0, "observed", to=-1), r"\[\[probes\]\] number 1 observed: is -1"),
        (_set("probes", 0, "observed", to=4.5), "observed: is 4.5"),
        (_set("probes", 0, "name", to=None), "name: is None"),
        (_set("seconds", "total", to="long"), r"\[seconds\] total: is 'long'"),
        (_set("notes", to="one"), "notes: is 'one'; must be a list"),
        (_set("settings", to=[]), r"settings: is \[\]; must be a table"),
    ],
)
def test_what_contradicts_itself_is_refused(tmp_path, damage, message):
    path = tmp_path / "estimate.json"
    write_estimate(path, _estimate())
    content = json.loads(path.read_text())
    damage(content)
    path.write_text(json.dumps(content))
    with pytest.raises(RecordError, match=message):
        read_estimate(path)


def test_numbers_that_a_person_rounded_are_not_refused():
    # 2 G (1 + nu) is 50820 Pa; two digits of it are 51 kPa.
    rounded = Constant(5.1e4, 300.0, (5.0e4, 5.2e4))
    assert _estimate(young_modulus=rounded).young_modulus.value == 5.1e4
