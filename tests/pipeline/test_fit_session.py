"""From a session to its constants: what was put in comes out, with gravity, tips, either method."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from error_columns import columns_of, curvature_of
from scipy.sparse import bsr_array, csr_array, kron
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation
from surfaces import box, sphere

from palpate.bem import CentredSystem, reduced_model
from palpate.bem.compressed import system as compressed
from palpate.checkpoints import Memory
from palpate.errors import InputError
from palpate.estimation import FitResult, FitSettings
from palpate.geometry import SurfacePoints, TriangleMesh, closest_points, write_mesh
from palpate.pipeline import (
    fit_session,
    graded_session,
    make_object_model,
    prepare_body,
    refined_session,
    session_observations,
)
from palpate.pipeline.model import object_model
from palpate.records import (
    EXACT,
    Camera,
    Contact,
    DisplacementField,
    Probing,
    Rig,
    RigCovariance,
    Session,
    Status,
    SurfaceAverage,
    read_session,
    write_rig,
    write_rig_covariance,
)
from palpate.shapes import Points

SHEAR, NU, NOISE = 2e4, 0.3, 2e-5
RADIUS = 0.03
CONSTANTS = ("shear_modulus", "poisson_ratio", "young_modulus")
KINDS = {
    "radius": ("", ""),
    "tool": (
        'radius = 0.006, profile = "smooth"',
        'tool = "sphere", tool_radius = 0.006, friction = "slides"',
    ),
    "springs": ("tolerance = 1e-6 }", "tolerance = 1e-6 }\nstiffness = 1e9"),
}


def _probing(mesh: TriangleMesh, name: str, direction: list[float], force: list[float]) -> Probing:
    """Pressed at a place of the unit sphere; every third vertex is seen."""
    seen = np.flatnonzero(mesh.vertices[:, 2] > -0.2 * RADIUS)
    points = mesh.vertices[seen]
    nothing = np.zeros_like(points)
    contact = closest_points(mesh, RADIUS * np.array([direction])).position[0]
    return Probing(
        name=name,
        contact=Contact(contact, 0.008, "smooth"),
        force=np.array(force),
        force_std=np.full(3, 0.005),
        tip_displacement=np.zeros(3) if name == "b" else None,
        tip_displacement_std=np.full(3, NOISE) if name == "b" else None,
        displacement=DisplacementField(
            points, nothing, np.full_like(nothing, NOISE), seen, closest_points(mesh, points), ""
        ),
        images=None,
    )


def _measured(session: Session, shear: float = SHEAR, noise: float = 0.0) -> Session:
    """The session with what its own model, on the graded mesh, moves by, and noise."""
    rng = np.random.default_rng(3)
    graded = graded_session(refined_session(session))
    observed = session_observations(graded, make_object_model(graded))
    probings = []
    for probing, seen in zip(session.probings, observed, strict=True):
        moved = (seen.response.value(NU) @ np.append(probing.force, 1.0) / shear).reshape(-1, 3)
        moved = moved + noise * rng.normal(size=moved.shape)
        count = len(seen.position)
        probings.append(
            replace(
                probing,
                displacement=replace(probing.displacement, displacement=moved[:count]),
                tip_displacement=None if probing.tip_displacement is None else moved[count],
            )
        )
    return replace(session, probings=tuple(probings))


@pytest.fixture(scope="module")
def still() -> Session:
    """A ball held at its foot, pressed at three places, with weight; nothing has moved yet."""
    unit = sphere(2)
    mesh = TriangleMesh(RADIUS * unit.vertices, unit.triangles)
    held = np.flatnonzero(mesh.vertices[mesh.triangles][:, :, 2].max(axis=1) < -0.4 * RADIUS)
    probings = (
        _probing(mesh, "a", [0, 0, 1], [0.02, 0.0, -0.5]),
        _probing(mesh, "b", [0.7, 0, 0.7], [-0.3, 0.0, -0.35]),
        _probing(mesh, "c", [0, -0.8, 0.6], [0.0, 0.35, -0.25]),
    )
    return Session(
        "ball", Path("ball"), mesh, held, probings, 1000.0, np.array([0.0, 0.0, -9.81]), None, ()
    )


@pytest.fixture(scope="module")
def session(still: Session) -> Session:
    return _measured(still)


@pytest.fixture(scope="module")
def result(session: Session) -> FitResult:
    return fit_session(session)


def test_what_was_put_in_comes_out(result: FitResult) -> None:
    estimate = result.estimate
    # The reduced model stands in on both sides; rounding and the noise floor are left.
    assert estimate.poisson_ratio.value == pytest.approx(NU, abs=1e-7)
    assert estimate.shear_modulus.value == pytest.approx(SHEAR, rel=1e-7)
    assert estimate.young_modulus.value == pytest.approx(2 * SHEAR * (1 + NU), rel=1e-7)
    assert estimate.status is Status.OK
    assert [probe.name for probe in estimate.probes] == ["a", "b", "c"]
    for probe in estimate.probes:
        assert probe.poisson_ratio.value == pytest.approx(NU, abs=1e-6)


def test_gravity_and_the_tip_belong_to_the_model(session: Session, result: FitResult) -> None:
    """Left out, each of them moves the constants: they were used."""
    without = replace(session, gravity=None, density=None)
    free = replace(session.probings[1], tip_displacement=None, tip_displacement_std=None)
    far = replace(session, probings=(session.probings[0], free, session.probings[2]))
    G = result.estimate.shear_modulus.value
    assert abs(fit_session(without).estimate.shear_modulus.value / G - 1) > 1e-4
    # Exact data stay exact without the tip; only the intervals know of it.
    less = fit_session(far).estimate
    assert less.shear_modulus.value == pytest.approx(G, rel=1e-7)


def test_every_force_sensor_has_errors_of_its_own(session: Session) -> None:
    sensors = ("weights", "gauge", "gauge")
    probings = [
        replace(probing, force_sensor=sensor)
        for probing, sensor in zip(session.probings, sensors, strict=True)
    ]
    errors = replace(session.errors, force_gains={"weights": 0.0})
    estimate = fit_session(replace(session, probings=tuple(probings), errors=errors)).estimate
    turns = [f"turn of the force sensor '{{}}' about {axis}" for axis in "xyz"]
    shared = [error.name for error in estimate.errors if "force sensor" in error.name]
    assert shared == ["gain of the force sensor 'gauge'", *(turn.format("gauge") for turn in turns)]
    # What one probing alone has is its own.
    unshared = [error.name for error in estimate.probes[0].errors if "force sensor" in error.name]
    assert unshared == [turn.format("weights") for turn in turns]


@pytest.mark.slow
def test_both_methods_end_at_the_same_minimum(still: Session) -> None:
    noisy = replace(_measured(still, noise=NOISE), gravity=None, density=None, errors=EXACT)
    noisy = replace(noisy, probings=noisy.probings[:2])
    # The weight that was measured is left out of the model, which the data contradict: no interval
    # is printed, but the search has one.
    simplex = FitSettings(method="nelder-mead")
    results = (fit_session(noisy), fit_session(noisy, settings=simplex))
    fast, slow = (result.estimate for result in results)
    assert fast.status == slow.status == Status.MODEL_CONTRADICTED
    assert np.isnan(fast.young_modulus.ci95).all()
    assert (fast.method, fast.settings["method"]) == ("reduced", "reduced")
    assert (slow.method, slow.settings["method"]) == ("nelder-mead", "nelder-mead")
    # The mesh's own error is taken linear about the last linearisation by one method, everywhere by
    # the other: a part of a standard error.
    for name in CONSTANTS:
        first, other = (getattr(result.intervals, name) for result in results)
        assert other.value == pytest.approx(first.value, abs=0.3 * first.std)
        assert other.std == pytest.approx(first.std, rel=0.1)
        assert other.value != first.value
    for quick, other in zip(fast.probes, slow.probes, strict=True):
        assert other.rms_residual == pytest.approx(quick.rms_residual, rel=1e-2)


def test_settings_are_kept_with_the_result(session: Session, result: FitResult) -> None:
    assert result.estimate.settings["poisson_range"] == (0.0, 0.4999)
    assert result.estimate.settings["surface"] == "smooth"
    narrow = fit_session(
        replace(session, notes=("Told by the session.",), smooth=False),
        settings=FitSettings(poisson_range=(0.0, 0.25)),
    ).estimate
    assert narrow.settings["surface"] == "flat"
    assert "Told by the session." in (*narrow.notes, *narrow.details)
    assert narrow.poisson_ratio.ci95[1] == pytest.approx(0.25)


def test_seconds_are_those_of_the_stages(result: FitResult) -> None:
    seconds = result.estimate.seconds
    assert list(seconds) == ["given_mesh", "assembly", "factorisation", "fit", "total"]
    assert all(value > 0 for value in seconds.values())
    parts = sum(value for name, value in seconds.items() if name != "total")
    # Between the stages there are a few assignments: nothing where other work does not interrupt.
    assert 0.8 * seconds["total"] < parts <= seconds["total"]


def test_progress_rises_to_one(session: Session) -> None:
    steps: list[tuple[str, float]] = []
    fit_session(session, progress=lambda text, share: steps.append((text, share)))
    shares = [share for _, share in steps]
    assert shares == sorted(shares)
    assert (shares[0], steps[-1]) == (0.0, ("fit done", 1.0))
    assert dict(steps)["minimisation"] == pytest.approx(0.75)
    assert dict(steps)["validation"] == pytest.approx(0.9875)
    # The models of the given mesh take their time, and are told one by one.
    given = [share for text, share in steps if text.startswith("the given mesh: ")]
    assert len(set(given)) >= 4
    assert 0.2 < max(given) < 0.4


def test_an_error_of_scale_moves_the_moduli(session: Session) -> None:
    estimate = fit_session(replace(session, errors=replace(EXACT, length_scale=0.04))).estimate
    scales = [error.prior_std for error in estimate.errors if error.name.startswith("scale")]
    assert scales == [0.04] * 3
    # A scale along one axis of three moves the moduli by about half of it.
    assert estimate.shear_modulus.std / estimate.shear_modulus.value > 0.3 * 0.04


def _with_rig(session: Session, folder: Path, base_std: float) -> Session:
    """Seen by two parallel cameras whose distance alone is uncertain, relative to it."""
    matrix = np.array([[2000.0, 0.0, 1000.0], [0.0, 2000.0, 240.0], [0.0, 0.0, 1.0]])
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, 2, 3], poses[1, 0, 3] = 0.4, -0.1
    cameras = [
        Camera(name, (2000, 480), matrix, np.zeros(5), pose)
        for name, pose in zip(("left", "right"), poses, strict=True)
    ]
    write_rig(folder / "rig.toml", Rig(tuple(cameras), 0, "pair"))
    known = RigCovariance(
        ("left.fx", "right.tx"), np.array([2000.0, -0.1]), np.diag([0.0, (0.1 * base_std) ** 2]), ""
    )
    write_rig_covariance(folder, known, np.full(2, 0.1))
    return replace(session, rig=folder / "rig.toml")


@pytest.mark.slow
def test_what_the_calibration_leaves_open_is_in_the_interval(
    session: Session, tmp_path: Path
) -> None:
    """Displacements that are all longer by a share mean a modulus that is lower by it."""
    two = replace(session, probings=session.probings[:2], errors=EXACT)
    probings = tuple(
        replace(probing, tip_displacement=None, tip_displacement_std=None)
        for probing in two.probings
    )
    without = fit_session(replace(two, probings=probings)).estimate
    seen = _with_rig(two, tmp_path, 0.02)
    estimate = fit_session(replace(seen, probings=probings)).estimate
    for name in ("shear_modulus", "young_modulus"):
        first, other = getattr(without, name), getattr(estimate, name)
        expected = np.hypot(first.std / first.value, 0.02)
        # The triangulated points are those of second-order differences; the intervals' quantiles.
        assert other.std / other.value == pytest.approx(expected, rel=0.02)
    (error,) = [
        calibration_error
        for calibration_error in estimate.errors
        if "calibration" in calibration_error.name
    ]
    # As large along each of the three axes.
    assert error.prior_std == pytest.approx(0.02 * np.sqrt(3.0), rel=1e-3)
    assert estimate.settings["lengths"]["std"] == pytest.approx([0.02] * 3, rel=1e-3)
    # An arm that measured the tip is another scale, and the fit believes the better one.
    better = fit_session(seen).estimate.shear_modulus
    assert (
        better.std / better.value < 0.85 * estimate.shear_modulus.std / estimate.shear_modulus.value
    )


def test_contacts_have_their_own_standard_deviation(still: Session) -> None:
    errors = replace(EXACT, contact_point=8e-4, contact_points={"a": 4e-4})
    first, second = session_observations(
        (only := replace(still, probings=still.probings[:2], errors=errors)),
        make_object_model(only),
    )
    for seen, std in ((first, 4e-4), (second, 8e-4)):
        assert [parameter.std for parameter in seen.nuisances[-1].parameters[:2]] == [std, std]
    same = replace(only, errors=replace(errors, contact_points={}))
    (usual, _) = session_observations(same, make_object_model(same))
    columns = [
        columns_of(observed.nuisances[-1], observed.response.value(NU), _unit_load(only), NU)[:, :2]
        for observed in (first, usual)
    ]
    # Linear in the shift, but for terms of third order over 0.8 mm.
    slope = (columns[0] * columns[1]).sum() / np.square(columns[1]).sum()
    assert slope == pytest.approx(0.5, rel=0.02)


def _unit_load(session: Session) -> np.ndarray:
    return np.append(session.probings[0].force, 1.0) / SHEAR


def test_columns_of_a_contact_are_differences_of_contacts(still: Session) -> None:
    """Against the response of sessions whose contact lies beside, or is wider."""
    errors = replace(EXACT, contact_point=4e-4, contact_radius=0.05)
    first = replace(still, probings=still.probings[:1], gravity=None, density=None, errors=errors)
    (seen,) = session_observations(first, make_object_model(first))
    contact, load = first.probings[0].contact, _unit_load(first)
    response = seen.response.value(NU)
    columns = columns_of(seen.nuisances[-1], response, load, NU)
    curvature = curvature_of(seen.nuisances[-1], response, load, NU)

    def moved(other: Contact) -> np.ndarray:
        probing = replace(first.probings[0], contact=other)
        there = replace(first, probings=(probing,))
        (observed,) = session_observations(there, make_object_model(there))
        return observed.response.value(NU) @ load

    # Two tangents, the radius, and the mesh about it.
    assert [parameter.unit for parameter in seen.nuisances[-1].parameters] == ["m", "m", "", ""]
    assert all("toward +" in parameter.name for parameter in seen.nuisances[-1].parameters[:2])
    axes = ["xyz".index(parameter.name[-1]) for parameter in seen.nuisances[-1].parameters[:2]]
    for k, axis in enumerate(axes):
        # The root of three deviations to either side.
        step = np.sqrt(3.0)
        shift = step * 4e-4 * np.eye(3)[axis]
        ends = closest_points(first.mesh, contact.point + np.stack([shift, -shift])).position
        on, back = (moved(replace(contact, point=end)) for end in ends)
        expected = 0.5 * (on - back) / step
        # Coarser cells, and a tangent that is not quite the axis.
        np.testing.assert_allclose(columns[:, k], expected, atol=0.06 * np.abs(expected).max())
        expected = (on + back - 2.0 * (response @ load)) / step**2
        np.testing.assert_allclose(curvature[:, k, k], expected, atol=0.06 * np.abs(expected).max())
    expected = moved(replace(contact, radius=1.05 * contact.radius)) - response @ load
    np.testing.assert_allclose(columns[:, 2], expected, atol=0.02 * np.abs(expected).max())


def test_columns_of_a_pose_are_those_of_a_mesh_that_lies_elsewhere(still: Session) -> None:
    """The same pushes on the shifted, turned mesh, seen at the same places of space."""
    errors = replace(EXACT, pose_translation=3e-4, pose_rotation=4e-3)
    # Inside the triangles: at a vertex the slope of one of them stands for all.
    middle = still.mesh.vertices[still.mesh.triangles].mean(axis=1)
    middle = middle[middle[:, 2] > 0.0]
    nothing = np.zeros_like(middle)
    field = DisplacementField(middle, nothing, None, None, closest_points(still.mesh, middle), "")
    probing = replace(still.probings[0], displacement=field)
    first = replace(still, probings=(probing,), gravity=None, density=None, errors=errors)
    model = make_object_model(first)
    (seen,) = session_observations(first, model)
    load, response = _unit_load(first), seen.response.value(NU)
    pose, _ = seen.nuisances
    columns = columns_of(pose, response, load, NU)
    centre = first.mesh.vertices.mean(axis=0)
    far = np.linalg.norm(seen.position - first.probings[0].contact.point, axis=1) > 0.015

    def seen_from(shift: np.ndarray, turn: np.ndarray) -> np.ndarray:
        # Where the points lie in the mesh's own frame.
        inside = (seen.position - centre - shift) @ turn + centre
        field = replace(
            first.probings[0].displacement, points=inside,
            surface=closest_points(first.mesh, inside),
        )  # fmt: skip
        there = replace(first, probings=(replace(first.probings[0], displacement=field),))
        (observed,) = session_observations(there, model)
        return (observed.response.value(NU) @ load).reshape(-1, 3) @ turn.T

    for k in range(6):
        half = 0.5 * (3e-4 if k < 3 else 4e-3) * np.eye(3)[k % 3]
        ends = []
        for vector in (half, -half):
            shift = vector if k < 3 else np.zeros(3)
            turn = np.eye(3) if k < 3 else Rotation.from_rotvec(vector).as_matrix()
            ends.append(seen_from(shift, turn)[far])
        expected = ends[0] - ends[1]
        # Off the contact's dip the field is nearly linear over such a step.
        error = columns[:, k].reshape(-1, 3)[far] - expected
        assert np.abs(error).max() < 0.05 * np.abs(expected).max()


def test_a_force_without_a_claim_has_the_default(still: Session) -> None:
    silent = replace(still.probings[0], force_std=None)
    (seen,) = session_observations(
        replace(still, probings=(silent,)), make_object_model(replace(still, probings=(silent,)))
    )
    # One per cent of the force's length.
    np.testing.assert_allclose(seen.force_std, 0.01 * np.linalg.norm(silent.force), rtol=1e-12)


def _seen_through_windows(session: Session) -> Session:
    """What was measured, as the mean over each point's seven nearest; one in five points alone."""
    probings = []
    for probing in session.probings:
        field = probing.displacement
        count = len(field.points)
        near = cKDTree(field.points).query(field.points, k=7)[1]
        averaged = np.arange(count) % 5 > 0
        rows = np.repeat(np.arange(count)[averaged], 7)
        mean = csr_array(
            (np.full(len(rows), 1 / 7), (rows, near[averaged].ravel())), (count, count)
        )
        average = SurfaceAverage(field.points, bsr_array(kron(mean, np.eye(3)), blocksize=(3, 3)))
        moved = field.displacement.copy()
        moved[averaged] = (mean @ field.displacement)[averaged]
        field = replace(field, displacement=moved, average=average)
        probings.append(replace(probing, displacement=field))
    return replace(session, probings=tuple(probings))


def test_displacements_that_are_averages_have_the_constants_of_their_points(
    session: Session, result: FitResult
) -> None:
    through = _seen_through_windows(session)
    estimate = fit_session(through).estimate
    # Weights have the digits of single precision.
    for name in CONSTANTS:
        expected = getattr(result.estimate, name)
        assert abs(getattr(estimate, name).value / expected.value - 1.0) < 1e-5
    alone = tuple(
        replace(probing, displacement=replace(probing.displacement, average=None))
        for probing in through.probings
    )
    # Taken for the points' own: 0.008 away.
    other = fit_session(replace(through, probings=alone)).estimate
    assert abs(other.poisson_ratio.value - result.estimate.poisson_ratio.value) > 0.004


def test_where_averages_are_sampled_is_kept_for_further_pushes(
    session: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    through, memory, asked = _seen_through_windows(session), Memory(), list[int]()

    def counted(mesh: TriangleMesh, points: Points) -> SurfacePoints:
        asked.append(len(points))
        return closest_points(mesh, points)

    monkeypatch.setattr(object_model, "closest_points", counted)
    anew = fit_session(through).estimate
    every = len(asked)
    fit_session(through, cache=memory)
    # All probings have the same sampling points: once for each of the meshes.
    assert every > len(asked) - every > 0
    asked.clear()
    estimate = fit_session(through, cache=memory).estimate
    assert asked == []
    assert [getattr(estimate, name) for name in CONSTANTS] == [
        getattr(anew, name) for name in CONSTANTS
    ]


def test_a_probing_without_displacement_is_refused(session: Session) -> None:
    blind = replace(session.probings[1], displacement=None)
    partly = replace(session, probings=(session.probings[0], blind))
    with pytest.raises(InputError, match="probing 'b' has no measured displacement and no images"):
        fit_session(partly)
    model = make_object_model(session)
    with pytest.raises(InputError, match="probing 'b' has no measured displacement"):
        session_observations(partly, model)


def test_one_contact_is_one_patch(still: Session) -> None:
    first, second, third = still.probings
    again = replace(third, contact=first.contact)
    model = make_object_model(replace(still, probings=(first, second, again)))
    assert model.loads.patch_of.tolist() == [0, 1, 0]
    assert len(model.loads.patches) == 2
    # Three columns a contact, two of gravity; of every probing's contact five other places, another
    # radius and another mesh about it.
    assert model.right.terms.shape[2] == 3 * 2 + 2 + 7 * 3


def test_integrals_are_kept(session: Session, result: FitResult, tmp_path: Path) -> None:
    first = fit_session(session, cache=tmp_path).estimate
    assert list(tmp_path.iterdir())
    again = fit_session(session, cache=tmp_path).estimate
    assert again.shear_modulus == first.shear_modulus == result.estimate.shear_modulus


def test_a_turned_session_has_the_same_constants(still: Session) -> None:
    """Everything turned and moved: mesh, gravity, contacts, forces, what is seen."""
    turn = Rotation.from_euler("xyz", [40, 70, -20], degrees=True).as_matrix()
    noisy = replace(_measured(still, noise=NOISE), errors=EXACT)
    mesh = TriangleMesh(
        noisy.mesh.vertices @ turn.T + np.array([1.0, 2.0, 3.0]), noisy.mesh.triangles
    )
    probings = []
    for probing in noisy.probings:
        points = probing.displacement.points @ turn.T + [1.0, 2.0, 3.0]
        tip = probing.tip_displacement
        field = replace(
            probing.displacement,
            points=points,
            displacement=probing.displacement.displacement @ turn.T,
            surface=closest_points(mesh, points),
        )
        probings.append(
            replace(
                probing,
                contact=replace(
                    probing.contact, point=turn @ probing.contact.point + [1.0, 2.0, 3.0]
                ),
                force=turn @ probing.force,
                displacement=field,
                tip_displacement=None if tip is None else turn @ tip,
            )
        )
    turned = replace(noisy, mesh=mesh, probings=tuple(probings), gravity=turn @ still.gravity)
    first, other = fit_session(noisy).estimate, fit_session(turned).estimate
    # Rules of integration are chosen for blocks of points along the axes: other rules in another
    # frame, which agree to 1.4e-4 on so coarse a mesh; its step to the graded one is a difference,
    # and so is the size of the mesh's error that follows from it.
    for name in CONSTANTS:
        assert getattr(other, name).value == pytest.approx(getattr(first, name).value, rel=2e-3)


@pytest.mark.slow
def test_where_poisson_s_ratio_is_open_the_search_ends_all_the_same() -> None:
    """Bent, a beam says nothing about it: the misfit hardly changes over all of its range."""
    beam = read_session(Path(__file__).parents[2] / "examples" / "beam")
    estimate = fit_session(beam).estimate
    assert estimate.status is Status.from_identifiable(
        {"young_modulus": True, "shear_modulus": False, "poisson_ratio": False}
    )


@pytest.fixture
def coarse_session(cube_session: Path, request: pytest.FixtureRequest) -> Session:
    """A coarse cube with the contact, and on the support, of this kind."""
    write_mesh(cube_session / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=4))
    file = cube_session / "session.toml"
    file.write_text(file.read_text().replace(*KINDS[request.param]))
    points = read_session(cube_session).mesh.vertices
    rows = points[points[:, 2] > 0.0]
    # Under the tool it goes down, and the more so, the higher above the support.
    near = np.exp(-(((rows - [0.02, 0.02, 0.04]) / 0.02) ** 2).sum(axis=1))
    moved = np.outer(-4e-4 * rows[:, 2] / 0.04 - 1e-3 * near, [0.0, 0.0, 1.0])
    table = np.hstack([rows, moved, np.full((len(rows), 1), 1e-4)])
    np.savetxt(
        cube_session / "n01.csv", table, delimiter=",", header="x,y,z,ux,uy,uz,sigma", comments=""
    )
    return read_session(cube_session)


@pytest.fixture
def factorised(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the systems that are factorised."""
    sizes: list[int] = []

    def seen(self, compute=CentredSystem._compute):
        sizes.append(self.system.size)
        return compute(self)

    monkeypatch.setattr(CentredSystem, "_compute", seen)
    return sizes


@pytest.mark.slow
@pytest.mark.parametrize("coarse_session", ["radius"], indirect=True)
def test_reduced_models_are_found_as_well(coarse_session, tmp_path, monkeypatch):
    def computed(*_):
        raise AssertionError("computed again")

    prepare_body(coarse_session, cache=tmp_path / "cache")
    monkeypatch.setattr(reduced_model, "_krylov_model", computed)
    assert fit_session(coarse_session, cache=tmp_path / "cache").estimate.shear_modulus.value > 0.0


# The graded mesh alone is left where its loads are not known before the fit.
@pytest.mark.parametrize(
    ("coarse_session", "left"),
    [
        ("radius", 0),
        pytest.param("tool", 1, marks=pytest.mark.slow),
        pytest.param("springs", 0, marks=pytest.mark.slow),
    ],
    indirect=["coarse_session"],
)
def test_a_fit_finds_all_that_does_not_depend_on_what_was_measured(
    coarse_session, left, factorised, tmp_path
):
    plain = fit_session(coarse_session).estimate
    expected = list(factorised)
    factorised.clear()
    prepare_body(coarse_session, cache=tmp_path / "cache")
    assert factorised == expected[: len(expected) - left]
    factorised.clear()
    estimate = fit_session(coarse_session, cache=tmp_path / "cache").estimate
    assert factorised == expected[len(expected) - left :]
    assert estimate.shear_modulus == plain.shear_modulus
    assert estimate.poisson_ratio == plain.poisson_ratio


@pytest.mark.slow
@pytest.mark.parametrize("coarse_session", ["radius"], indirect=True)
def test_nothing_is_kept_of_a_body_that_is_solved_compressed(coarse_session, tmp_path, monkeypatch):
    def solved(*_, **__):
        raise AssertionError("solved in vain")

    monkeypatch.setattr(compressed, "LARGEST_DENSE", 0)
    monkeypatch.setattr(reduced_model, "reduced_basis", solved)
    prepare_body(coarse_session, cache=tmp_path / "cache")
    assert not (tmp_path / "cache").exists()
