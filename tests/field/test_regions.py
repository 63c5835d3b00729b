"""Moduli of regions of a body in other elements, what is known of them, and regions that none can
have."""

from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from surfaces import box

from palpate.errors import InputError
from palpate.estimation import ProbeObservations, fit
from palpate.field.field_prior import FieldModes
from palpate.field.field_responses import at_points, push_model
from palpate.field.regions import _prior, check_regions, fit_regions, make_region_model
from palpate.records import (
    RATIO,
    YOUNG,
    Box,
    Contact,
    Insert,
    Layer,
    Probing,
    Region,
    Session,
    Skin,
)
from palpate.records.region import SHEAR
from palpate.solids.tetrahedra import quadratic_solid

SIDE, NU, MODULUS, NOISE = 0.04, 0.3, 2e4, 2e-6
PUSHES = (
    ((0.025, 0.02, 0.04), (0.3, 0.1, -1.0)),
    ((0.01, 0.0, 0.025), (0.0, 2.0, 0.5)),
    ((0.04, 0.025, 0.03), (-1.5, 0.0, 0.3)),
)
LOW, HIGH = np.array([0.015, 0.0, 0.02]), np.array([0.04, 0.02, 0.04])
CORNER, RATIO_OF_CORNER = Box(LOW, HIGH), 3.0
# Planes of the truth's elements along every axis: 5 mm, through all faces of the corner.
CELLS = 8


def session(*regions):
    mesh = box(size=(SIDE, SIDE, SIDE), cells=CELLS)
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1))
    probings = tuple(
        Probing(f"n{k}", Contact(np.array(point), 6e-3, "smooth"), np.array(force), None, None,
                None, None, None)
        for k, (point, force) in enumerate(PUSHES)
    )  # fmt: skip
    return Session("cube", Path(), mesh, held, probings, None, None, None, (), regions=regions)


def layered(mesh):
    """A cube cut along planes, every cell into six."""
    line = np.linspace(0.0, SIDE, CELLS + 1)
    grid = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1)
    number = np.arange(len(line) ** 3).reshape(grid.shape[:3])
    elements = []
    for order in permutations(range(3)):
        steps = np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(order)]], axis=0)
        parts = [tuple(slice(i, CELLS + i) for i in step) for step in steps]
        elements.append(np.stack([number[part].ravel() for part in parts], axis=1))
    return quadratic_solid(grid.reshape(-1, 3), np.concatenate(elements), mesh=mesh)


@pytest.fixture(scope="module")
def true():
    """The cube with a stiffer corner, in elements none of which is cut by it."""

    def corner(body):
        centres = body.means(body.points.reshape(-1, 3))
        stiff = CORNER.contains(centres)[:, None] * 1.0
        shares = body.constant @ stiff
        return FieldModes(shares, np.zeros(0), (), np.zeros(len(shares)))

    given = session()
    return push_model(given, (), layered(given.mesh), corner)


@dataclass(frozen=True, eq=False)
class Solved:
    """The homogeneous body's response by the truth's own elements, quadratic between some Poisson's
    ratios."""

    ratios: np.ndarray
    moved: np.ndarray
    along: np.ndarray

    def value(self, poisson_ratio):
        off = poisson_ratio - self.ratios
        share = [np.prod(np.delete(off, k)) / np.prod(np.delete(off - off[k], k))
                 for k in range(3)]  # fmt: skip
        columns = np.zeros((self.moved.shape[1], 4))
        columns[:, :3] = (share @ self.moved)[:, None] * self.along
        return columns


@pytest.fixture(scope="module")
def observed(true):
    """Exact observations of the corner's body, with the homogeneous response."""
    given = session()
    points = given.mesh.vertices[given.mesh.vertices[:, 2] > 1e-9]
    at, ratios = at_points(true.body.solid, points), np.array([0.25, 0.3, 0.35])
    homogeneous = np.stack([at @ true.moved(np.zeros(1), ratio) for ratio in ratios])
    moved = at @ true.moved(np.log([RATIO_OF_CORNER]), NU) / MODULUS
    probes = []
    for k, (point, force) in enumerate(PUSHES):
        away = np.linalg.norm(points - point, axis=1) > 9e-3
        rows, along = np.repeat(away, 3), np.array(force) / np.dot(force, force)
        displacement, std = moved[rows, k].reshape(-1, 3), np.full((away.sum(), 3), NOISE)
        response = Solved(ratios, homogeneous[:, rows, k], along)
        probes.append(ProbeObservations(f"n{k}", points[away], displacement, std, np.array(force),
                                       np.zeros(3), None, None, response))  # fmt: skip
    return probes


@pytest.mark.slow
def test_the_modulus_of_a_region_is_that_of_the_truth(observed):
    regions = fit_regions(session(Region("corner", CORNER)), observed)
    (corner,) = regions.estimates(fit(regions.observations).minimum)
    # Elements of 5 mm here and there, those here cut by the corner.
    assert corner.ratio.value == pytest.approx(RATIO_OF_CORNER, rel=0.05)
    assert corner.identifiable
    assert corner.is_seen
    assert corner.note == ""


@pytest.mark.slow
@pytest.mark.parametrize("kind", [SHEAR, YOUNG])
def test_a_known_modulus_tells_that_of_the_rest(observed, kind):
    shear = RATIO_OF_CORNER * MODULUS
    value = shear if kind == SHEAR else 2.0 * (1.0 + NU) * shear
    region = Region("corner", CORNER, kind, value, 1e-3 * value)
    regions = fit_regions(session(region), observed)
    minimum = fit(regions.observations).minimum
    (corner,) = regions.estimates(minimum)
    known = corner.shear_modulus if kind == SHEAR else corner.young_modulus
    assert known.value == pytest.approx(value, rel=3e-3)
    assert minimum.shear_modulus == pytest.approx(MODULUS, rel=0.02)


@pytest.mark.slow
def test_beside_its_modulus_the_error_of_a_response_is_of_second_order(true, observed):
    """A known modulus stays what it is where that of the rest changes."""
    known = RATIO_OF_CORNER * MODULUS
    given = session(Region("corner", CORNER, SHEAR, known, 0.01 * known))
    regions = fit_regions(given, observed)
    model, prior = regions.expansion.model, regions.prior
    probe, errors = regions.observations[0], []
    at = model.points[0].from_corners
    corners = np.repeat(3 * model.corners, 3).reshape(-1, 3) + np.arange(3)
    homogeneous = model.observations[0].response.value(prior.poisson_ratio)[:, :3] @ probe.force
    missed = homogeneous - model.points[0].from_nodes @ regions.expansion.homogeneous[:, 0]
    for change in (0.08, 0.04):
        modulus = prior.shear_modulus * np.exp(change)
        terms = probe.response_terms(prior.poisson_ratio)
        moved = terms[:, 0, :3] @ probe.force / modulus + terms[:, 1, :3] @ probe.force

        def solved(log_ratio, under_load):
            every = model.moved(np.array([log_ratio]), prior.poisson_ratio)[:, 0]
            return at @ every[corners.ravel()] + np.exp(-log_ratio * under_load) * missed

        about = float(regions.expansion.coefficients[0])
        near = model.under_loads[0, 0]
        expected = solved(prior.mean[0] - change, near) - solved(about, 0.0)
        still = (
            replace(
                regions.expansion,
                derivative=0.0 * regions.expansion.derivative,
                under_loads=0.0 * regions.expansion.under_loads,
            )
            .observations(prior)[0]
            .response_terms(prior.poisson_ratio)
        )
        errors.append(np.linalg.norm(modulus * moved - still[:, 0, :3] @ probe.force - expected))
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.25)


@pytest.mark.slow
def test_no_push_sees_a_speck(observed):
    speck = Region("speck", Box(np.array([0.019, 0.019, 0.0]), np.array([0.021, 0.021, 0.002])))
    homogeneous, rng = [], np.random.default_rng(1)
    for probe in observed:
        moved = probe.response.value(NU)[:, :3] @ probe.force / MODULUS
        moved += 10.0 * NOISE * rng.normal(size=moved.shape)
        homogeneous.append(replace(probe, displacement=moved.reshape(-1, 3), std=10.0 * probe.std))
    regions = fit_regions(session(speck), homogeneous)
    (estimate,) = regions.estimates(fit(regions.observations).minimum)
    assert not estimate.is_seen
    assert not estimate.identifiable
    assert "No push sees region 'speck'" in estimate.note


def test_elements_have_the_shares_of_their_regions():
    surface = box(size=(0.012, 0.01, 0.01), origin=(0.01, 0.01, 0.02))
    skin = session().mesh
    upper = np.flatnonzero((skin.vertices[skin.triangles][:, :, 2] > SIDE - 1e-9).all(axis=1))
    regions = (
        Region("insert", Insert(surface)),
        Region("top", Skin(type(skin)(skin.vertices, skin.triangles[upper]), 4e-3)),
        Region("foot", Layer(np.zeros(3), np.array([0.0, 0.0, 1.0]), 0.006)),
    )
    model = make_region_model(session(*regions))
    shares = model.modes.modes
    volume = model.body.weight.ravel() @ shares
    # Elements that are cut are looked into at 27 points.
    assert volume == pytest.approx([1.2e-6, 4e-3 * SIDE**2, 6e-3 * SIDE**2], rel=0.02)
    assert shares.sum(axis=1).max() <= 1.0 + 1e-12


@pytest.mark.parametrize(
    ("regions", "message"),
    [
        ((Region("a", Box(np.full(3, 0.05), np.full(3, 0.06))),), "'a' is outside the object"),
        (
            (Region("a", CORNER), Region("b", Box(LOW, HIGH))),
            "100 % of region 'b' lie in region 'a'",
        ),
        ((Region("a", Box(np.full(3, -1.0), np.full(3, 1.0))),), "fill the whole object"),
    ],
)
def test_regions_that_are_no_parts_are_refused(regions, message):
    with pytest.raises(InputError, match=message):
        check_regions(session(*regions))


def test_a_region_thinner_than_elements_can_be_says_what_it_takes():
    film = Region("film", Layer(np.array([0.0, 0.0, 0.03]), np.array([0.0, 0.0, 1.0]), 1e-4))
    with pytest.raises(InputError, match=r"'film' is 0\.1 mm thick, which takes [0-9]+ elements"):
        make_region_model(session(film))


@pytest.mark.parametrize(
    ("known", "value", "std", "message"),
    [
        ("stiffness", 1.0, 0.0, "known is 'stiffness'"),
        (SHEAR, 0.0, 0.0, "shear_modulus is 0"),
        (RATIO, 5.0, 5.0, "ratio_std is 5"),
    ],
)
def test_what_cannot_be_known_is_refused(known, value, std, message):
    with pytest.raises(InputError, match=message):
        Region("a", CORNER, known, value, std)


@pytest.mark.parametrize("kind", [YOUNG, SHEAR, RATIO])
def test_what_is_known_of_a_region_changes_with_the_rest_as_it_says(kind):
    region = [Region("corner", CORNER, kind, 3e4, 300.0)]
    ratio, modulus, step = 0.3, 2e4, 1e-5
    prior = _prior(region, ratio, modulus)
    above, below = (_prior(region, ratio + h, modulus).mean for h in (step, -step))
    # Central differences of logarithms, to the third order.
    assert (above - below) / (2 * step) == pytest.approx(prior.by_ratio, abs=1e-8)
    above, below = (_prior(region, ratio, modulus * np.exp(h)).mean for h in (step, -step))
    assert (above - below) / (2 * step) == pytest.approx(prior.by_log_modulus, abs=1e-8)
    known = {YOUNG: 3e4 / (2 * modulus * 1.3), SHEAR: 3e4 / modulus, RATIO: 3e4}
    assert prior.mean == pytest.approx([np.log(known[kind])])
