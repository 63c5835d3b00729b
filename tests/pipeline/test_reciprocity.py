"""Reciprocity holds for any linear elastic body, and for nothing else."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest
from surfaces import box

from benchmarks.bodies import box_mesh
from palpate.geometry import SurfacePoints, TriangleMesh, closest_points
from palpate.pipeline import reciprocity
from palpate.pipeline.patch_motion import _spread
from palpate.records import (
    EXACT,
    FREE,
    Contact,
    DisplacementField,
    PointCorrelation,
    Probing,
    Session,
    Support,
)
from palpate.records.contact import smooth_pressure
from palpate.solids.finite_elements import (
    free_part,
    hooke_moduli,
    pressure_load,
    quadratic_basis,
    stiffness_matrix,
    surface_values,
)
from palpate.solids.sparse_cholesky import factorise
from palpate.solids.tetrahedra import make_solid

RADIUS = 6e-3
# Places [mm] and directions of the pushes on a block of 60 x 45 x 45 mm that stands on z = 0.
PLACES = ((0, 0, 45), (18, 10, 45), (-16, -10, 45), (30, 5, 30), (-30, -4, 28), (4, 22.5, 30),
          (-8, -22.5, 26), (-15, 11, 45))  # fmt: skip
PUSHES = ((0.3, 0, -1), (0, 0.4, -1), (0.2, -0.2, -1), (-1, 0.3, 0), (1, 0, -0.3), (0.4, -1, 0),
          (-0.2, 1, 0.2), (-0.5, -0.2, -1))  # fmt: skip
BESIDE = 2e-3


@pytest.fixture(scope="module")
def block():
    """Mesh, and motions of its vertices per newton of each push, the last one of the first push a
    little beside its place: stiff fibres along one diagonal, the right half four times stiffer."""
    mesh = box_mesh(60, 45, 45)(4.5e-3)
    solid = make_solid(mesh, edge=6e-3, fine=[(1e-3 * np.array(p), RADIUS, 3e-3) for p in PLACES])
    basis = quadratic_basis(solid)
    x = basis.global_coordinates()
    along = np.array([1.0, 1.0, 0.5]) / 1.5
    fibres = np.einsum("i,j,k,l->ijkl", along, along, along, along)
    law = hooke_moduli(2e4, 0.3) + 1.5e5 * fibres
    stiffer = np.where(np.asarray(x)[0] > 0.0, 4.0, 1.0)
    stiffness = stiffness_matrix(basis, law[..., None, None] * stiffer)
    held = solid.nodes[:, 2] < 1e-9
    factor = factorise(free_part(stiffness, held), solid.nodes[~held])
    at_vertices = surface_values(solid, mesh.vertices)

    def motion(point, push):
        load = pressure_load(solid, point, RADIUS, smooth_pressure)[:, None] * unit(push)
        moved = np.zeros((len(solid.nodes), 3))
        moved[~held] = factor.solve(load[~held].reshape(-1, 1)).reshape(-1, 3)
        return at_vertices @ moved

    motions = [motion(1e-3 * np.array(p), f) for p, f in zip(PLACES, PUSHES, strict=True)]
    beside = 1e-3 * np.array(PLACES[0]) + [BESIDE, 0.0, 0.0]
    return mesh, np.stack([*motions, motion(beside, PUSHES[0])])


def unit(vector) -> np.ndarray:
    return np.array(vector) / np.linalg.norm(vector)


def make_session(
    mesh: TriangleMesh, motions, rng, *, noise=0.01, errors=EXACT, force_std=0.005, sizes=None
) -> Session:
    """Pushes of about a newton, each force wrong by its standard deviation, noise as a share of the
    motion."""
    held = np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] < 1e-9).all(axis=1))
    on_support = np.unique(mesh.triangles[held])
    probings = []
    for k, moved in enumerate(motions[: len(PLACES)]):
        point, size = 1e-3 * np.array(PLACES[k]), 1.0 if sizes is None else sizes[k]
        sigma = noise * size * float(np.sqrt((moved**2).mean()))
        seen = size * moved + sigma * rng.normal(size=moved.shape)
        seen[np.linalg.norm(mesh.vertices - point, axis=1) < RADIUS] = np.nan
        seen[on_support] = np.nan
        force = size * (unit(PUSHES[k]) + force_std * rng.normal(size=3))
        probings.append(
            Probing(
                f"n{k}", Contact(point, RADIUS, "smooth"), force, np.full(3, size * force_std),
                None, None, field_of(mesh, seen, np.full_like(seen, sigma)), None,
            )
        )  # fmt: skip
    return Session(
        "block", Path(), mesh, held, tuple(probings), None, None, None, (), errors=errors
    )


def field_of(mesh, displacement, std) -> DisplacementField:
    corner = np.zeros(len(mesh.vertices), dtype=np.int64)
    corner[mesh.triangles.ravel()] = np.arange(mesh.triangles.size)
    triangle, corner_index = np.divmod(corner, 3)
    surface = SurfacePoints(triangle, np.eye(3)[corner_index], mesh.vertices, np.zeros(len(corner)))
    return DisplacementField(mesh.vertices, displacement, std, None, surface, "truth")


def with_gain(session: Session, index: int, gain: float) -> Session:
    probings = list(session.probings)
    probings[index] = replace(probings[index], force=gain * probings[index].force)
    return replace(session, probings=tuple(probings))


def test_an_uneven_fibrous_body_passes(block):
    tested = reciprocity(make_session(*block, np.random.default_rng(1)))
    assert tested.holds
    assert tested.is_tested
    assert tested.odd == ()
    # Every two of the eight pushes that do not overlap see each other.
    assert len(tested.pairs) == 28
    assert tested.degrees == 28
    assert "agree by reciprocity" in tested.text


def test_works_agree_within_the_elements(block):
    # Without noise, what is left is the error of the elements and of averages over coarse vertices.
    tested = reciprocity(make_session(*block, np.random.default_rng(0), noise=1e-6, force_std=0.0))
    works = np.array([[pair.work, pair.other] for pair in tested.pairs])
    off = works[:, 0] - works[:, 1]
    assert np.sqrt((off**2).mean()) < 0.01 * np.sqrt((works**2).mean())


def test_a_force_told_too_large_is_named(block):
    session = with_gain(make_session(*block, np.random.default_rng(2)), 3, 1.05)
    tested = reciprocity(session)
    assert not tested.holds
    assert tested.odd == ("n3",)
    assert not tested.grows
    push = next(excess for excess in tested.pushes if excess.name == "n3")
    assert abs(push.excess - 0.05) < 3.0 * np.hypot(push.std, 0.005)
    assert "It is n3" in tested.text
    assert "more force is stated" in tested.text


def test_a_tool_that_pressed_beside_its_place_does_not_pass(block):
    mesh, motions = block
    session = make_session(mesh, [motions[-1], *motions[1:]], np.random.default_rng(3), noise=0.003)
    tested = reciprocity(session)
    assert not tested.holds
    farthest = max(tested.pairs, key=lambda pair: abs(pair.sigmas))
    assert "n0" in (farthest.first, farthest.second)


def test_a_place_as_uncertain_as_that_is_excused(block):
    mesh, motions = block
    errors = replace(EXACT, contact_points={"n0": BESIDE})
    rng = np.random.default_rng(3)
    session = make_session(mesh, [motions[-1], *motions[1:]], rng, noise=0.003, errors=errors)
    assert reciprocity(session).holds


def test_a_material_that_stiffens_does_not_pass(block):
    # A power law: motion grows as the force to 0.8.
    mesh, motions = block
    sizes = np.array([1.0, 3.0, 2.0, 1.5, 1.0, 2.5, 3.0, 2.0])
    session = make_session(
        mesh, sizes[:, None, None] ** -0.2 * motions[:8], np.random.default_rng(4), sizes=sizes
    )
    tested = reciprocity(session)
    assert not tested.holds
    assert tested.grows
    assert tested.odd == ()
    assert tested.growth.excess > 0.0
    assert "stiffens" in tested.text


def test_one_gain_of_all_forces_is_not_seen(block):
    session = make_session(*block, np.random.default_rng(1))
    for k in range(len(PLACES)):
        session = with_gain(session, k, 1.3)
    assert reciprocity(session).holds


def test_pushes_that_do_not_see_each_other_cannot_be_tested(block):
    session = make_session(*block, np.random.default_rng(1))
    near = []
    for probing in session.probings[:3]:
        away = np.linalg.norm(probing.displacement.points - probing.contact.point, axis=1)
        seen = np.where((away < 0.012)[:, None], probing.displacement.displacement, np.nan)
        field = field_of(session.mesh, seen, probing.displacement.std)
        near.append(replace(probing, displacement=field))
    tested = reciprocity(replace(session, probings=tuple(near)))
    assert not tested.is_tested
    assert tested.holds
    assert "cannot be tested" in tested.text
    assert "see each other's contacts" in tested.text


def test_one_push_cannot_be_tested(block):
    session = make_session(*block, np.random.default_rng(1))
    tested = reciprocity(replace(session, probings=session.probings[:1]))
    assert not tested.is_tested
    assert "two pushes" in tested.text


def moved_along(session: Session, rng) -> Session:
    """The same, measured in frames that move from push to push."""
    probings = []
    for probing in session.probings:
        field = probing.displacement
        shift, turn = 1e-4 * rng.normal(size=3), 2e-3 * rng.normal(size=3)
        rigid = shift + np.cross(turn, field.points)
        moved = field_of(session.mesh, field.displacement + rigid, field.std)
        probings.append(replace(probing, displacement=moved))
    return replace(session, probings=tuple(probings))


def test_a_support_that_moves_freely_costs_degrees_of_freedom(block):
    rng = np.random.default_rng(5)
    session = moved_along(make_session(*block, rng), rng)
    assert not reciprocity(session).holds
    free = replace(session, supports=(Support(session.held_triangles, FREE),))
    tested = reciprocity(free)
    # Antisymmetric in what eight wrenches of six components leave: two dimensions.
    assert tested.is_tested
    assert tested.degrees == 1
    assert tested.holds


def test_weight_that_only_loads_pull_up_costs_a_degree_for_every_push_but_one(block):
    session = make_session(*block, np.random.default_rng(1))
    heavy = replace(session, density=1000.0, gravity=np.array([0.0, 0.0, -9.81]))
    tested = reciprocity(heavy)
    assert tested.degrees == 28 - 7
    assert tested.holds


def test_pushes_at_one_place_without_noise_put_no_work_in_and_none_out(block):
    """The same push thrice: mixtures without force have no work, and rounding is no variance."""
    mesh, motions = block
    (probing, *_) = make_session(mesh, motions, np.random.default_rng(6), force_std=0.0).probings
    probings = [
        replace(
            probing,
            name=f"n{times}",
            force=times * unit(PUSHES[0]),
            displacement=replace(probing.displacement, displacement=times * motions[0], std=None),
        )
        for times in (0.4, 0.8, 1.6)
    ]
    session = make_session(mesh, motions, np.random.default_rng(6))
    tested = reciprocity(replace(session, probings=tuple(probings)))
    assert tested.holds
    assert len(tested.passive) == 3
    # To rounding, far below the finest work that is told.
    assert abs(tested.own_work) < 1e-6 < tested.own_work_std


def test_tips_show_that_pushes_put_work_in(block):
    mesh, motions = block
    session = make_session(mesh, motions, np.random.default_rng(6))
    touched = [
        replace(
            probing,
            tip_displacement=moved[
                np.linalg.norm(mesh.vertices - probing.contact.point, axis=1).argmin()
            ],
            tip_displacement_std=np.full(3, 1e-6),
        )
        for probing, moved in zip(session.probings, motions, strict=False)
    ]
    tested = reciprocity(replace(session, probings=tuple(touched)))
    assert len(tested.passive) == 8
    assert 0.0 < tested.own_work < 1.0
    assert tested.own_work > 5.0 * tested.own_work_std
    backward = [replace(probing, tip_displacement=-probing.tip_displacement) for probing in touched]
    assert reciprocity(replace(session, probings=tuple(backward))).own_work < 0.0


@pytest.mark.slow
def test_chances_are_even(block):
    # Of 60 uniform numbers the test of Kolmogorov and Smirnov condemns one set in a thousand.
    mesh, motions = block
    few = [0, 1, 3, 5]
    chances = []
    for seed in range(60):
        session = make_session(mesh, motions, np.random.default_rng(seed))
        few_of = tuple(session.probings[k] for k in few)
        chances.append(reciprocity(replace(session, probings=few_of)).chance)
    assert kstest(chances, "uniform").pvalue > 1e-3


def test_pairs_that_do_not_fit_together_leave_a_covariance():
    """Three points, two pairs of which share 0.9 and the third nothing: no covariance has that, and
    the mean with weights 1, -1.4, 1 would have a variance of -1.08."""
    mesh = box(size=(1.0, 1.0, 1.0), cells=1)
    points = mesh.vertices[:3]
    field = DisplacementField(
        points=points,
        displacement=np.zeros((3, 3)),
        std=np.ones((3, 3)),
        vertex=None,
        surface=closest_points(mesh, points),
        source="",
        correlation=PointCorrelation(np.array([[0, 1], [1, 2]]), np.array([0.9, 0.9])),
    )
    weights = np.tile([1.0, -1.4, 1.0], (1, 3, 1))
    spread = _spread(field, np.arange(3), weights).reshape(3, 3)
    assert np.linalg.eigvalsh(spread).min() >= 0.0
    # What does fit together stays as it is: alone, a point has its own variance.
    alone = _spread(field, np.arange(3), np.tile([0.0, 1.0, 0.0], (1, 3, 1))).reshape(3, 3)
    np.testing.assert_allclose(alone, np.eye(3), atol=1e-12)
