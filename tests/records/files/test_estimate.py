"""estimate.json: the format of a session's result, and its round trip."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from palpate.errors import RecordError
from palpate.records import Constant, Estimate, ProbeEstimate, Status, read_estimate, write_estimate

NAN, INF = math.nan, math.inf
G = Constant(2.1e4, 150.0, (2.07e4, 2.13e4))
NU = Constant(0.21, 0.006, (0.198, 0.222))
E = Constant(5.1e4, 300.0, (5.04e4, 5.16e4))
LOST = Constant(NAN, INF, (-INF, INF))


def _estimate(**changes):
    probe = ProbeEstimate("n01", G, NU, E, 412, 40, 9, 2.1e-5, 3e-5)
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
    }
    return Estimate(**(values | changes))


def test_round_trip_is_exact(tmp_path):
    estimate = _estimate()
    write_estimate(tmp_path / "estimate.json", estimate)
    assert read_estimate(tmp_path / "estimate.json") == estimate


FINITE = st.floats(allow_nan=False, allow_infinity=False)
CONSTANTS = st.builds(
    lambda value, std, ends: Constant(value, std, (min(ends), max(ends))),
    FINITE,
    FINITE,
    st.tuples(FINITE, FINITE),
)
COUNTS = st.integers(0, 10**9)
PROBES = st.builds(
    ProbeEstimate,
    st.text(),
    CONSTANTS,
    CONSTANTS,
    CONSTANTS,
    COUNTS,
    COUNTS,
    COUNTS,
    FINITE,
    st.none() | FINITE,
)


@settings(max_examples=40, deadline=None)
@given(
    constants=st.tuples(CONSTANTS, CONSTANTS, CONSTANTS),
    probes=st.lists(PROBES, max_size=3),
    status=st.sampled_from(Status),
    seconds=st.dictionaries(st.text(), FINITE, max_size=3),
    notes=st.lists(st.text(), max_size=3),
)
def test_whatever_is_written_is_read_back(
    tmp_path_factory, constants, probes, status, seconds, notes
):
    path = tmp_path_factory.mktemp("law") / "estimate.json"
    names = ("shear_modulus", "poisson_ratio", "young_modulus")
    estimate = _estimate(
        **dict(zip(names, constants, strict=True)),
        probes=tuple(probes),
        status=status,
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
    settings = {"seed": np.int64(3), "range": np.array([0.0, np.nan]), "on": np.bool_(True)}
    write_estimate(
        tmp_path / "estimate.json",
        _estimate(poisson_ratio=LOST, probes=(probe,), settings=settings),
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


def test_bad_files_are_refused(tmp_path):
    path = tmp_path / "estimate.json"
    with pytest.raises(RecordError, match="cannot be read"):
        read_estimate(path)
    path.write_text("{")
    with pytest.raises(RecordError, match="not valid JSON"):
        read_estimate(path)
    path.write_text('{"format": "other/1"}')
    with pytest.raises(RecordError, match="format is 'other/1'; this version reads"):
        read_estimate(path)
    path.write_text('{"format": "palpate-estimate/1", "status": "ok"}')
    with pytest.raises(RecordError, match="is not a whole estimate"):
        read_estimate(path)
    with pytest.raises(RecordError, match="cannot be written"):
        write_estimate(tmp_path / "none" / "estimate.json", _estimate())
