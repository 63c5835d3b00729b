"""Constructors of the records: what they make of good values and refuse of bad ones."""

import dataclasses
import pickle
from pathlib import Path

import numpy as np
import pytest
from scipy.sparse import bsr_array
from surfaces import box

from palpate.errors import InputError
from palpate.geometry import closest_points
from palpate.records import (
    Constant,
    Contact,
    DisplacementField,
    Estimate,
    Images,
    PointCorrelation,
    Probing,
    Session,
    Status,
    SurfaceAverage,
)
from palpate.records.session import Step, require_probings

CUBE = box(cells=2)


def _field(**changes):
    points = np.array([[0.5, 0.5, 1.0], [0.25, 0.5, 1.0]])
    values = {
        "points": points,
        "displacement": np.zeros((2, 3)),
        "std": None,
        "vertex": None,
        "surface": closest_points(CUBE, points),
        "source": "memory",
    }
    return DisplacementField(**(values | changes))


def _average(blocks=((1.0, 0.0, 0.0), (0.25, 0.75, 0.0))):
    """Three points of the surface, and displacements that are sums of theirs."""
    points = np.array([[0.5, 0.5, 1.0], [0.25, 0.5, 1.0], [0.75, 0.5, 1.0]])
    weights = bsr_array(np.kron(np.array(blocks), np.eye(3)), blocksize=(3, 3))
    return SurfaceAverage(points, weights)


def _probing(**changes):
    values = {
        "name": "a",
        "contact": Contact(np.array([0.5, 0.5, 1.0]), 0.1, "hertz"),
        "force": np.array([0.0, 0.0, -1.0]),
        "force_std": None,
        "tip_displacement": None,
        "tip_displacement_std": None,
        "displacement": _field(),
        "images": None,
    }
    return Probing(**(values | changes))


def _session(**changes):
    values = {
        "name": "s",
        "path": Path("session.toml"),
        "mesh": CUBE,
        "held_triangles": np.array([3, 1, 3]),
        "probings": (_probing(),),
        "density": None,
        "gravity": None,
        "rig": None,
        "notes": (),
    }
    return Session(**(values | changes))


def _of_steps(**changes):
    values = {
        "held_triangles": np.zeros(0, dtype=np.int64),
        "probings": (),
        "rig": Path("rig.toml"),
        "steps": (Step("s0", "s0_{camera}.png"), Step("s1", "s1_{camera}.png")),
    }
    return _session(**(values | changes))


def _with_images(**changes):
    images = Images("r_{camera}.png", ("a_{camera}.png",))
    return _probing(**({"images": images, "displacement": None} | changes))


def test_a_session_has_probings_or_steps():
    require_probings(_session())
    assert _session().steps == ()
    assert [step.name for step in _of_steps().steps] == ["s0", "s1"]
    assert _of_steps(held_triangles=np.array([3, 1])).held_triangles.tolist() == [1, 3]
    with pytest.raises(InputError, match=r"rigid-motion sequence .*, so nothing about stiffness"):
        require_probings(_of_steps())


def test_pictures_need_a_rig_where_nothing_else_tells_the_displacement():
    assert _session(probings=(_with_images(displacement=_field()),)).rig is None
    assert _session(probings=(_with_images(),), rig=Path("rig.toml")).probings[0].images
    assert _session(probings=(_probing(displacement=None),)).rig is None


def test_a_partly_measured_row_is_not_measured():
    moved = np.array([[0.0, np.nan, 1.0], [0.0, 0.0, 1.0]])
    assert np.isnan(_field(displacement=moved).displacement).tolist() == [[True] * 3, [False] * 3]


def test_standard_deviation_may_be_missing_where_nothing_was_measured():
    moved = np.array([[np.nan, 0, 0], [0.0, 0.0, 1.0]])
    std = np.array([[np.nan] * 3, [1.0] * 3])
    assert _field(displacement=moved, std=std).std is not None
    with pytest.raises(InputError, match="std of 1 measured points is not positive"):
        _field(std=std)


def test_correlations_follow_their_points():
    known = PointCorrelation(np.array([[0, 3], [1, 2], [2, 3]]), np.array([0.5, -0.1, 0.2]))
    some = known.subset(np.array([3, 2, 0]), 5)
    np.testing.assert_array_equal(some.pair, [[0, 2], [0, 1]])
    np.testing.assert_array_equal(some.value, [0.5, 0.2])


@pytest.mark.parametrize(
    ("pair", "value", "message"),
    [([[1, 0]], [0.5], "lower number first"), ([[0, 1]], [1.5], "1.5 is more than 1"),
     ([[2, 2]], [0.5], "lower number first")],
)  # fmt: skip
def test_correlations_are_checked(pair, value, message):
    pairs, values = np.array(pair), np.array(value)
    with pytest.raises(InputError, match=message):
        PointCorrelation(pairs, values)


def test_held_triangles_are_sorted_and_distinct():
    assert _session().held_triangles.tolist() == [1, 3]


def test_records_cannot_be_changed():
    with pytest.raises(dataclasses.FrozenInstanceError):
        _probing().name = "b"
    with pytest.raises(ValueError, match="read-only"):
        _probing().force[0] = 1.0


@pytest.mark.parametrize(
    ("make", "changes", "message"),
    [
        (_probing, {"force": np.zeros(3)}, "force is zero"),
        (_probing, {"force": np.array([0.0, np.inf, 0.0])}, "not finite"),
        (_probing, {"force_std": np.array([0.0, -1.0, 0.0])}, "force_std is .* must not be neg"),
        (
            _probing,
            {"tip_displacement": np.ones(3), "tip_displacement_std": np.zeros(3)},
            "tip_displacement_std is .*; must be positive",
        ),
        (_session, {"held_triangles": np.zeros(0, dtype=np.int64)}, "support is empty"),
        (_session, {"held_triangles": np.array([48])}, "names triangles 48 to 48, but the mesh"),
        (_session, {"held_triangles": np.arange(48)}, "the whole surface"),
        (_session, {"probings": ()}, "no probings"),
        (_session, {"probings": (_probing(), _probing())}, "there are files named 'a' already"),
        (_session, {"probings": (_with_images(),)}, "probing 'a' has images, but no rig is given"),
        (_of_steps, {"rig": None}, "the steps have images, but no rig is given"),
        (_of_steps, {"steps": ()}, "has no probings .*; at least one is needed"),
        (_of_steps, {"steps": (Step("s0", "a"),)}, "has one step, 's0', alone; motion needs"),
        (
            _of_steps,
            {"steps": (Step("b", "x"), Step("b", "y"))},
            "step 'b': there are files named 'b' already",
        ),
        (
            _of_steps,
            {"probings": (_probing(),)},
            "has 1 probings and 2 steps .*; it must have one kind",
        ),
        (_of_steps, {"held_triangles": np.array([48])}, "names triangles 48 to 48"),
        (Step, {"name": " ", "images": "a"}, "name of a step is blank"),
        (Step, {"name": "a", "images": ""}, "images of a step is blank"),
        (_session, {"density": -1.0}, "density is -1.0"),
        (_session, {"gravity": np.array([0.0, 0.0, -9.81])}, "gravity is given without a density"),
    ],
)
def test_bad_values_are_refused(make, changes, message):
    with pytest.raises(InputError, match=message):
        make(**changes)


def test_status_names_exactly_what_is_not_identifiable():
    names = ("shear_modulus", "poisson_ratio", "young_modulus")
    seen = set()
    for bits in range(8):
        known = {name: bool(bits >> i & 1) for i, name in enumerate(names)}
        status = Status.from_identifiable(known)
        seen.add(status)
        if 0 < bits < 7:
            assert [name in status.value for name in names] == [not known[name] for name in names]
    others = {Status.HETEROGENEOUS, Status.NOT_CONVERGED, Status.MODEL_CONTRADICTED}
    assert seen == set(Status) - others
    assert Status.from_identifiable(dict.fromkeys(names, True)) is Status.OK
    with pytest.raises(InputError, match="identifiable has the keys"):
        Status.from_identifiable({"nu": True})


def test_every_status_has_its_cure():
    assert all(len(status.advice) > 20 for status in Status)


def test_constants_and_estimates_are_checked():
    with pytest.raises(InputError, match="ci95 is"):
        Constant(1.0, 0.1, (2.0, 1.0))
    constant = Constant(1.0, 0.1, (0.8, 1.2))
    with pytest.raises(InputError, match="identifiable has the keys"):
        Estimate(Status.OK, constant, constant, constant, {}, (), {}, "reduced", {}, ())


def test_an_average_is_a_sum_over_points_or_the_point_itself():
    average = _average(((0.5, 0.5, 0.0), (0.0, 0.0, 0.0)))
    assert average.has_weights.tolist() == [True, False]
    alone, around = [[1.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [0.5, 0.5], [0.0, 1.0]]
    averaged = average.averaging_matrix() @ np.kron(np.vstack([alone, around]), np.eye(3))
    np.testing.assert_array_equal(averaged, np.kron([[0.75, 0.25], [0.0, 1.0]], np.eye(3)))


def test_weights_of_points_that_are_not_there_are_refused():
    # A product with them would end the process.
    good = _average().weights
    for parts in (
        (good.data, good.indices + 10**6, good.indptr),
        (good.data, good.indices, good.indptr[::-1].copy()),
    ):
        bad = bsr_array(good.shape, blocksize=(3, 3))
        bad.data, bad.indices, bad.indptr = parts
        with pytest.raises(InputError, match="weights are no matrix"):
            SurfaceAverage(np.zeros((3, 3)), bad)


def test_a_field_has_an_average_for_each_of_its_points():
    assert _field(average=_average()).average is not None
    with pytest.raises(InputError, match="average has 3 rows; must be 6"):
        _field(average=_average(((1.0, 0.0, 0.0),)))


def test_an_average_is_pickled_whole():
    average = _average()
    copied = pickle.loads(pickle.dumps(average))
    np.testing.assert_array_equal(copied.points, average.points)
    for part in ("data", "indices", "indptr"):
        np.testing.assert_array_equal(getattr(copied.weights, part), getattr(average.weights, part))


def test_some_of_the_averages_and_averages_among_others():
    average = _average()
    (second,) = average.subset(np.array([1])).weights.toarray().reshape(1, 3, 9)
    np.testing.assert_array_equal(second, np.kron([[0.25, 0.75, 0.0]], np.eye(3)))
    embedded = average.embedded(np.array([1, 3]), 5)
    assert embedded.has_weights.tolist() == [False, True, False, True, False]
    np.testing.assert_array_equal(
        embedded.subset(np.array([1, 3])).weights.toarray(), average.weights.toarray()
    )


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        (lambda: _average(((0.5, 0.6, 0.0),)), "displacement 0 add up to"),
        (lambda: _average(((1.0, 0.0),)), "weights are 3 x 6; must have three columns for each"),
        (lambda: _field(average=_average(((1.0, 0.0, 0.0),))), "average has 3 rows; must be 6"),
        (
            lambda: _field(correlation=PointCorrelation(np.array([[0, 2]]), np.array([0.5]))),
            "correlation names point 2; must be 0 to 1",
        ),
    ],
)
def test_averages_that_are_none_are_refused(wrong, text):
    with pytest.raises(InputError, match=text):
        wrong()
