"""Finite strain adds what is of second order in the load; an estimate that corrects it is right."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.errors import InputError
from palpate.geometry import closest_points
from palpate.pipeline import fit_session
from palpate.pipeline.model import large_strain
from palpate.pipeline.model.finite_body import make_finite_body
from palpate.pipeline.model.large_strain import strain_corrections
from palpate.pipeline.model.stiffening import MaterialConstants, damped, is_stiffening
from palpate.records import (
    BIASED,
    EXACT,
    FREE,
    STICKS,
    Constant,
    Contact,
    DisplacementField,
    Estimate,
    FlatFace,
    Probing,
    Session,
    Sphere,
    Support,
    Tool,
)
from palpate.records.contact import PRESSURES
from palpate.solids import (
    LawOf,
    SplitNeoHookean,
    held_nodes,
    make_body,
    make_solid,
    pressure_load,
    solve_finite,
    solve_load,
    surface_values,
    yeoh,
)

SHEAR, NU, RADIUS = 2e4, 0.3, 12e-3
PLACE = np.array([0.021, 0.019, 0.04])


def _session(push: float) -> Session:
    """A glued cube of 4 cm, pressed from above, seen on its free faces."""
    mesh = box((0.04, 0.04, 0.04), 4)
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = mesh.vertices[mesh.vertices[:, 2] > 1e-6]
    field = DisplacementField(
        points, np.zeros_like(points), None, None, closest_points(mesh, points), ""
    )
    force = np.array([0.0, 0.0, -push])
    contact = Contact(PLACE, RADIUS, "smooth")
    probing = Probing("n", contact, force, np.full(3, 1e-3), None, None, field, None)
    return Session("cube", Path("cube"), mesh, held, (probing,), None, None, None, (), errors=EXACT)


def _correction(push: float) -> np.ndarray:
    # The order is that of any elements.
    body = make_finite_body(_session(push), coarser=2.0)
    (correction,) = strain_corrections(body, MaterialConstants(SHEAR, NU))
    return correction.value


def test_it_is_of_second_order_in_the_load() -> None:
    small, large = (_correction(push) for push in (0.05, 0.1))
    # A third order of some tenths of the second is left at 0.1 N, 2 % strain.
    assert np.linalg.norm(large) / np.linalg.norm(small) == pytest.approx(4.0, rel=0.05)


@pytest.fixture(scope="module")
def column() -> Session:
    """A slender column that stands on the ground, pushed sideways at its top."""
    height, side = 0.1, 0.012
    mesh = box((side, side, height), (2, 2, 16))
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = np.array([[side, 0.5 * side, height - 2e-3]])
    field = DisplacementField(points, 0 * points, None, None, closest_points(mesh, points), "")
    contact, force = Contact(points[0], 2e-3, "smooth"), np.array([-1e-6, 0.0, 0.0])
    probing = Probing("n", contact, force, np.full(3, 1e-9), None, None, field, None)
    return Session(
        "column", Path("column"), mesh, held, (probing,), 50.0, None, None, (), errors=EXACT
    )


def test_weight_at_rest_makes_a_column_that_stands_softer_and_one_that_hangs_stiffer(
    column: Session,
) -> None:
    """By 3/8 of the weight per length, as of a beam that bends as under a load at its tip
    (Rayleigh): the work of the axial force, which falls from the weight to 0, in the tilt."""
    changes = []
    for gravity in (-9.81, 9.81):
        down = np.array([0.0, 0.0, gravity])
        weighed = replace(column, gravity=down, gravity_at_rest=True)
        body = make_finite_body(weighed, coarser=1.2)
        (correction,) = strain_corrections(body, MaterialConstants(SHEAR, NU))
        elastic = make_body(body.solid, body.held, shear_modulus=SHEAR, poisson_ratio=NU)
        linear = (body.observed[0] @ solve_load(elastic, body.loads[0]))[0, 0]
        changes.append(correction.value[0, 0] / linear)
        # It is counted from where the column rests; by its weight it has sunk ten times as far.
        assert abs(correction.value[0, 2]) < 0.2 * abs(linear)
    stands, hangs = changes
    stiffness = 1e-6 / abs(linear)
    expected = 3 / 8 * 50.0 * 9.81 * 0.012**2 / stiffness
    assert stands > 0.1
    assert hangs < 0.0
    # The second order cancels; the column is eight times as high as wide, and bends in shear, too.
    assert 0.5 * (stands - hangs) == pytest.approx(expected, rel=0.06)


def test_weight_under_the_push_alone_moves_what_is_seen() -> None:
    """The sag is part of what a push moves, and of what the linear model says of it."""
    session = replace(_session(0.5), density=1000.0, gravity=np.array([0.0, 5.0, -9.81]))
    rests, alone = (
        make_finite_body(replace(session, gravity_at_rest=rests), coarser=2.0)
        for rests in (True, False)
    )
    at = MaterialConstants(SHEAR, NU)
    before, both = (strain_corrections(body, at)[0].value for body in (rests, alone))
    elastic = make_body(alone.solid, alone.held, shear_modulus=SHEAR, poisson_ratio=NU)
    sag, linear = solve_finite(elastic, alone.weight), solve_load(elastic, alone.weight)
    weight = 1000.0 * 0.04**3 * session.gravity
    np.testing.assert_allclose(alone.weight.sum(axis=0), weight, atol=1e-12)
    expected = before + alone.observed[0] @ (sag - linear)
    # Newton leaves 1e-9 of loads that move the top by a millimetre.
    np.testing.assert_allclose(both, expected, rtol=0.0, atol=1e-10)


def test_a_tool_on_an_object_that_sags() -> None:
    """Where it sags little the correction is that of the push without weight: the sag itself, which
    is a tenth of it, is no part."""
    session = _session(0.5)
    (probing,) = session.probings
    touched = replace(probing, contact=Contact.under(Sphere(RADIUS), PLACE))
    light = replace(session, probings=(touched,))
    heavy = replace(light, density=1000.0, gravity=np.array([0.0, 0.1, -0.1]), gravity_at_rest=True)
    without, sagging = (
        strain_corrections(make_finite_body(given, coarser=2.0), MaterialConstants(SHEAR, NU))[0]
        for given in (light, heavy)
    )
    # The weight strains it by a ten thousandth, and turns the skin by twice as much.
    change = np.abs(sagging.value - without.value).max()
    assert 0.0 < change < 3e-3 * np.abs(without.value).max()
    for slope, other in zip(sagging.slope, without.slope, strict=True):
        assert np.linalg.norm(slope - other) < 5e-3 * np.linalg.norm(other)


def test_what_presses_alike_is_solved_once(monkeypatch: pytest.MonkeyPatch) -> None:
    session, solved = _session(1.0), []
    (probing,) = session.probings
    stronger = replace(probing, name="s", force=1.5 * probing.force)
    again = replace(probing, name="a")
    body = make_finite_body(replace(session, probings=(probing, stronger, again)), coarser=2.0)
    assert body.same == (0, 1, 0)

    def counted(*args: object, **options: object) -> np.ndarray:
        solved.append(args)
        return solve_finite(*args, **options)

    monkeypatch.setattr(large_strain, "solve_finite", counted)
    first, other, second = strain_corrections(body, MaterialConstants(SHEAR, NU))
    assert len(solved) == 2
    assert np.array_equal(first.value, second.value)
    assert not np.array_equal(first.value, other.value)


def test_slopes_are_those_of_the_corrections() -> None:
    body = make_finite_body(_session(1.0), coarser=2.0)
    at = MaterialConstants(SHEAR, NU, 2.0)
    (correction,) = strain_corrections(body, at)
    steps = {"shear_modulus": 20.0, "poisson_ratio": 1e-3, "stiffening": 1e-2}
    for slope, (name, step) in zip(correction.slope, steps.items(), strict=True):
        ahead, behind = (
            strain_corrections(body, replace(at, **{name: getattr(at, name) + s * step}))[0]
            for s in (1, -1)
        )
        per = step / SHEAR if name == "shear_modulus" else step
        expected = (ahead.value - behind.value) / (2 * per)
        # Central differences of relative steps of a thousandth.
        assert np.linalg.norm(slope - expected) < 1e-4 * np.linalg.norm(expected), name
        # The same, from the other side.
        near = correction.at(replace(at, **{name: getattr(at, name) + step}))
        assert np.abs(near - ahead.value).max() < 0.01 * np.abs(near - correction.value).max()


@pytest.mark.slow
def test_stiffening_comes_out_of_several_depths() -> None:
    """Of other elements, whose neo-Hookean part keeps shape and volume apart."""
    session = _session(1.0)
    (probing,) = session.probings
    solid = make_solid(session.mesh, edge=9e-3, fine=[(PLACE, 12e-3, 4e-3)])
    held = held_nodes(solid, session.held_triangles)
    body = make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=NU)
    load = pressure_load(solid, PLACE, RADIUS, PRESSURES["smooth"])[:, None] * probing.force
    seen = surface_values(solid, probing.displacement.points)

    def pressed(law: LawOf | None) -> Session:
        probings = []
        for times in (0.6, 1.2, 2.4):
            nodal = solve_load(body, times * load)
            if law is not None:
                nodal = solve_finite(body, times * load, law=law)
            field = replace(probing.displacement, displacement=seen @ nodal)
            changes = {"name": f"n{times}", "force": times * probing.force}
            probings.append(replace(probing, displacement=field, **changes))
        return replace(session, probings=tuple(probings))

    linear = pressed(None)
    truth = fit_session(replace(linear, probings=linear.probings[:1])).estimate
    result = fit_session(pressed(yeoh(3.0, SplitNeoHookean)), finite_strain=True)
    estimate = result.estimate
    assert estimate.stiffening is not None
    assert estimate.stiffening.value == pytest.approx(3.0, rel=0.15)
    assert "times as stiff as at small strain" in estimate.notes[0]
    # As where nothing stiffens.
    assert estimate.shear_modulus.value == pytest.approx(truth.shear_modulus.value, rel=0.01)
    assert estimate.poisson_ratio.value == pytest.approx(truth.poisson_ratio.value, abs=0.004)
    # What was taken off is in the prediction again.
    left = result.probes[2].residual
    expected = pressed(yeoh(3.0, SplitNeoHookean)).probings[2].displacement.displacement
    np.testing.assert_allclose(result.probes[2].predicted + left, expected, atol=1e-9)
    # Pushes of an object that is not linear need not agree with each other.
    assert estimate.reciprocity is None


@pytest.mark.slow
def test_an_object_pressed_far_gives_its_constants() -> None:
    """Those that a linear object of the same elements, others than the fit's, would give."""
    session = _session(1.5)
    (probing,) = session.probings
    solid = make_solid(session.mesh, edge=9e-3, fine=[(PLACE, 12e-3, 4e-3)])
    held = held_nodes(solid, session.held_triangles)
    body = make_body(solid, held, shear_modulus=SHEAR, poisson_ratio=NU)
    load = pressure_load(solid, PLACE, RADIUS, PRESSURES["smooth"])[:, None] * probing.force
    seen = surface_values(solid, probing.displacement.points)

    def estimate(nodal: np.ndarray, finite_strain: bool) -> Estimate:
        field = replace(probing.displacement, displacement=seen @ nodal)
        notes = (f"Of the session: {BIASED}.",)
        disturbed = replace(session, probings=(replace(probing, displacement=field),), notes=notes)
        return fit_session(disturbed, finite_strain=finite_strain).estimate

    # Not the law that the correction assumes.
    nodal = solve_finite(body, load, law=SplitNeoHookean)
    truth = estimate(solve_load(body, load), False)
    linear, finite = (estimate(nodal, is_finite) for is_finite in (False, True))
    young = truth.young_modulus.value
    ratio = truth.poisson_ratio.value
    assert abs(linear.poisson_ratio.value - ratio) > 0.01
    # The patch's middle is at no vertex of the given mesh, but of the graded one.
    depth = float(np.abs(solve_load(body, load)[:, 2]).max()) / RADIUS
    noted = re.match(r"In n the tool went in by (\d+) % of the radius", linear.notes[0])
    assert noted is not None
    assert float(noted[1]) == pytest.approx(100 * depth, rel=0.1)
    # Only where it is corrected for is it no bias.
    assert [sum(BIASED in note for note in result.notes) for result in (linear, finite)] == [1, 0]
    # The correction has its own elements, constants settle at 0.1 % and 0.0005, and the parameter
    # of the law takes up some of what the mesh of 4 x 4 squares leaves (0.003 of nu).
    assert finite.young_modulus.value == pytest.approx(young, rel=0.005)
    assert finite.poisson_ratio.value == pytest.approx(ratio, abs=0.004)
    # Beside the linear one, the law that it is: the correction's own is none of its steps away.
    errors = {error.name: error for error in finite.probes[0].errors}
    law = errors["finite strain (in steps from one neo-Hookean law to another)"]
    assert abs(law.value) < 2.5
    assert law.prior_std == 1.0
    mesh = errors["finite strain of n (in steps from coarser to extrapolated elements)"]
    assert abs(mesh.value) < 2.0
    assert "the linear model alone is" in finite.notes[-2]
    # The law of these data does not stiffen.
    assert finite.stiffening is None
    assert "stiffen" in finite.notes[-1]


def test_supports_that_move_are_refused() -> None:
    session = _session(0.1)
    support = Support(session.held_triangles, FREE)
    with pytest.raises(InputError, match="support 1 moves"):
        fit_session(replace(session, supports=(support,)), finite_strain=True)


@pytest.mark.parametrize("tool", [None, FlatFace(RADIUS, friction=STICKS)])
def test_a_pressure_without_bound_is_refused(tool: Tool | None) -> None:
    session = _session(0.1)
    (probing,) = session.probings
    probing = replace(probing, contact=replace(probing.contact, profile="flat", tool=tool))
    with pytest.raises(InputError, match=r"'n' has the pressure of a flat face.*name the tool"):
        fit_session(replace(session, probings=(probing,)), finite_strain=True)


def test_stiffening_is_shown_by_more_than_noise() -> None:
    """A false alarm in 400: 3.02 standard deviations."""
    assert is_stiffening(Constant(0.4, 0.13, (0.15, 0.65)))
    assert not is_stiffening(Constant(0.4, 0.15, (0.11, 0.69)))


@pytest.mark.parametrize("slope", [0.5, -0.5, -1.2, -2.5])
def test_stiffening_that_jumps_back_and_forth_settles(slope: float) -> None:
    """A correction with c gives 4 + slope (c - 4); undamped it would not settle below -1."""
    at, last = MaterialConstants(SHEAR, NU, 6.0), (0.0, 0.0)
    for _ in range(8):
        value = 4.0 + slope * (at.stiffening - 4.0)
        last, at = (at.stiffening, value), damped(at, replace(at, stiffening=value), last)
    assert at.stiffening == pytest.approx(4.0, abs=0.02)
