"""From a session's pictures to its vertices, and what happens to bad pictures."""

import gc
import shutil
import sys
from collections.abc import Iterator
from dataclasses import FrozenInstanceError, fields, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from vision.scenes import PITCH, STILL, example, noisy_views, rigid

from palpate.checkpoints import Checkpoints, content_digest
from palpate.errors import CalibrationError, InputError
from palpate.geometry import TriangleMesh, closest_points
from palpate.pipeline import (
    FLOW_METHODS,
    MeasuredMotion,
    MotionNotes,
    fit_session,
    measure_motion,
    measured_motions,
    motion_names,
    with_measured_displacement,
    with_pictures_measured,
)
from palpate.records import DisplacementField, Rig, Session, read_rig, read_session
from palpate.vision import (
    FlowMethod,
    JointFlow,
    Outcome,
    RangeFlow,
    VertexDisplacement,
    is_valid,
    measured_vertices,
)
from palpate.vision.matching.scene import Scene

GIVEN = {"method": JointFlow(step=8), "pose": "given"}
# Less than half the points, where no vertex of a fine mesh needs many about it.
COARSE = GIVEN | {"method": JointFlow(step=12)}
# Two pixels and one, and two more at the edge: within the range of a search by whole pixels.
MOTION = rigid((0.0, 0.0, 0.02), (6e-4, -3e-4, 2e-4))
# The same once more.
FARTHER = rigid((0.0, 0.0, 0.04), (1.2e-3, -6e-4, 4e-4))
NOISE = 1.0


def _part(source: Path, target: Path, steps: int) -> Path:
    """A copy of a rigid sequence with its first steps only."""
    target.mkdir()
    text = (source / "session.toml").read_text()
    head, *tables = text.split("[[step]]")
    (target / "session.toml").write_text("[[step]]".join([head, *tables[:steps]]))
    for name in ("rig.toml", "mesh.ply"):
        shutil.copy(source / name, target / name)
    (target / "images").mkdir()
    for step in range(steps):
        for picture in (source / "images").glob(f"s{step}_*.png"):
            shutil.copy(picture, target / "images" / picture.name)
    return target


@pytest.fixture(scope="module")
def sequence(shared_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three instants of the translating object: 2.5 mm a step along x."""
    folder = tmp_path_factory.mktemp("motion") / "part"
    return _part(shared_data / "rigid_translation_x", folder, 3)


@pytest.fixture(scope="module")
def half_ball(shared_data: Path) -> Session:
    return read_session(shared_data / "halfball_images", probes=["n01"])


class _Killed(BaseException):
    """The process ends."""


def _alive(kind: type) -> int:
    """Number of objects of a class that something holds."""
    gc.collect()
    return sum(isinstance(item, kind) for item in gc.get_objects())


def test_an_interrupted_measurement_goes_on_to_the_same_bytes(
    sequence: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    session, parts = read_session(sequence), tmp_path / "parts"
    method = JointFlow(step=24)
    whole = measure_motion(session, method=method, pose="given")

    def killed_after_the_first(stage: str, _: float) -> None:
        if stage.startswith("s1"):
            raise _Killed

    def killed(*_: object) -> None:
        raise _Killed

    options = {"method": method, "pose": "given", "parts": parts}
    with pytest.raises(_Killed):
        measure_motion(session, **options, progress=killed_after_the_first)
    asked, follow = [], JointFlow.follow
    monkeypatch.setattr(JointFlow, "follow", lambda *given: (asked.append(1), follow(*given))[1])
    again = measure_motion(session, **options)
    assert len(asked) == 1
    for before, after in zip(whole.motions, again.motions, strict=True):
        assert content_digest(before) == content_digest(after)
    # Now all is there; but other settings find nothing of it, nor do other pictures.
    monkeypatch.setattr(JointFlow, "follow", killed)
    measure_motion(session, **options)
    with pytest.raises(_Killed):
        measure_motion(session, **options | {"method": JointFlow(step=25)})
    changed = tmp_path / "changed"
    shutil.copytree(sequence, changed)
    shutil.copy(changed / "images" / "s1_c0.png", changed / "images" / "s2_c0.png")
    with pytest.raises(_Killed):
        measure_motion(read_session(changed), **options)


@pytest.mark.slow
def test_a_motion_is_let_go_before_the_next_one_is_measured(
    shared_data: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The method goes on from the last flow; earlier ones are gone."""
    session = read_session(_part(shared_data / "rigid_translation_x", tmp_path / "long", 6))
    alive, follow = [], JointFlow.follow

    def counted(*given: Any) -> Any:
        alive.append(_alive(RangeFlow))
        return follow(*given)

    monkeypatch.setattr(JointFlow, "follow", counted)
    motions = measured_motions(session, method=JointFlow(step=24), pose="given")
    names = [motion.name for _, motion, _ in motions]
    assert names == motion_names(session) == ["s1", "s2", "s3", "s4", "s5"]
    assert [count - alive[0] for count in alive] == [0, 1, 1, 1, 1]


@pytest.mark.slow
def test_first_pictures_are_let_go_after_their_last_probing(
    half_ball: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every probing may have pictures at rest of its own; those of two are processed once."""
    probing = half_ball.probings[0]
    assert probing.images is not None
    probings = tuple(
        replace(probing, name=f"p{k}", images=replace(probing.images, rest=f"images/{rest}.png"))
        for k, rest in enumerate(["n01_{camera}", "rest_{camera}", "n01_{camera}", "n02_{camera}"])
    )
    alive, start = [], JointFlow.start

    def counted(*given: Any) -> Any:
        alive.append(_alive(Scene))
        return start(*given)

    monkeypatch.setattr(JointFlow, "start", counted)
    motions = measured_motions(replace(half_ball, probings=probings), **COARSE)
    names = [motion.name for _, motion, _ in motions]
    assert names == ["p0", "p1", "p2", "p3"]
    assert [count - alive[0] for count in alive] == [0, 1, 1]


def test_a_translation_is_measured_to_hundredths_of_a_millimetre(sequence: Path) -> None:
    flow = measure_motion(read_session(sequence), **GIVEN)
    assert [motion.name for motion in flow.motions] == ["s1", "s2"]
    for number, motion in enumerate(flow.motions, start=1):
        assert motion.vertices is not None
        moved = motion.vertices.displacement
        ok = np.isfinite(moved).all(axis=1)
        error = moved[ok] - [0.0025 * number, 0.0, 0.0]
        assert ok.sum() > 100
        # The issue asks for 0.06 mm; half of it leaves room for the coarser grid of this test.
        assert np.sqrt((error**2).sum(axis=1).mean()) < 6e-5
        square = np.einsum(
            "ni,nij,nj->n", error, np.linalg.inv(motion.vertices.covariance[ok]), error
        )
        assert 0.6 < np.sqrt(square.mean() / 3.0) < 1.7


def test_a_truncated_picture_fails_its_step_and_keeps_the_others(
    sequence: Path, tmp_path: Path
) -> None:
    folder = _part(sequence, tmp_path / "cut", 3)
    picture = folder / "images" / "s1_c1.png"
    picture.write_bytes(picture.read_bytes()[:40_000])
    flow = measure_motion(read_session(folder), **GIVEN)
    failed, intact = flow.motions
    assert failed.flow is None
    assert failed.failure is not None
    assert "s1" in failed.failure
    assert "s1_c1.png" in failed.failure
    assert intact.vertices is not None
    assert np.isfinite(intact.vertices.displacement[:, 0]).sum() > 100


def test_pictures_without_texture_say_where_and_how_much_is_needed(
    sequence: Path, tmp_path: Path
) -> None:
    """A part of the object is painted grey in every picture."""
    folder = _part(sequence, tmp_path / "bare", 2)
    rng = np.random.default_rng(0)
    for path in sorted((folder / "images").glob("*.png")):
        grey = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE).astype(float)
        grey[160:, :] = np.where(grey[160:] > 20.0, 100.0, grey[160:])
        grey[160:] += rng.normal(0.0, 1.5, grey[160:].shape)
        cv2.imwrite(str(path), np.clip(np.round(grey), 0, 255).astype(np.uint8))
    measured = measure_motion(read_session(folder), **COARSE)
    flow = measured.motions[0].flow
    assert flow is not None
    assert (flow.outcome == Outcome.TEXTURE).mean() > 0.1
    assert any("too little texture" in note and "column" in note for note in measured.notes)


def test_swapped_cameras_are_named(sequence: Path, tmp_path: Path) -> None:
    folder = _part(sequence, tmp_path / "swapped", 2)
    images = folder / "images"
    for step in ("s0", "s1"):
        (images / f"{step}_c1.png").rename(images / "kept.png")
        (images / f"{step}_c2.png").rename(images / f"{step}_c1.png")
        (images / "kept.png").rename(images / f"{step}_c2.png")
    with pytest.raises(CalibrationError, match="look swapped"):
        measure_motion(read_session(folder), **GIVEN)


def test_load_steps_in_the_wrong_order_are_remarked(shared_data: Path) -> None:
    """n05 is loaded in five steps; the last one must be the largest."""
    session = read_session(shared_data / "halfball_images", probes=["n05"])
    probing = session.probings[0]
    assert probing.images is not None
    wrong = (probing.images.loaded[4], probing.images.loaded[1])
    turned = replace(probing, images=replace(probing.images, loaded=wrong))
    flow = measure_motion(replace(session, probings=(turned,)), **COARSE)
    assert any("is their order right" in note for note in flow.notes)


def test_images_alone_give_the_constants(half_ball: Session) -> None:
    """One probing, force known to 1 %: nu within 0.03 of 0.21, E within 5 % of 52 kPa."""
    flow = measure_motion(half_ball, **COARSE)
    session = with_measured_displacement(half_ball, flow)
    estimate = fit_session(session).estimate
    assert estimate.poisson_ratio.value == pytest.approx(0.21, abs=0.03)
    assert estimate.young_modulus.value == pytest.approx(52e3, rel=0.05)


def test_only_what_has_no_displacement_is_measured(
    half_ball: Session, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A probing with a file of displacements keeps it; notes of the pictures come last."""
    (seen,) = half_ball.probings
    nothing = np.zeros_like(half_ball.mesh.vertices)
    field = DisplacementField(
        half_ball.mesh.vertices, nothing, None, None,
        closest_points(half_ball.mesh, half_ball.mesh.vertices), "file",
    )  # fmt: skip
    known = replace(seen, name="known", displacement=field)
    session = replace(half_ball, probings=(known, seen), notes=("first",))
    asked = []

    def measure(session: Session, **given: Any) -> Iterator[tuple[Rig, MeasuredMotion, Any]]:
        asked.append(([probing.name for probing in session.probings], given["pose"]))
        vertices = VertexDisplacement(
            nothing, np.tile(1e-12 * np.eye(3), (len(nothing), 1, 1)), np.full(len(nothing), 9)
        )
        motion = MeasuredMotion("n01", "n01", True, np.zeros((1, 1)), None, vertices, None)
        yield read_rig(session.rig), replace(motion, notes=MotionNotes(pictures=("second",))), ()

    module = sys.modules[with_pictures_measured.__module__]
    monkeypatch.setattr(module, "measured_motions", measure)
    measured = with_pictures_measured(session, pose="given")
    assert asked == [(["n01"], "given")]
    assert measured.probings[0].displacement is field
    assert measured.notes == ("first", "second")
    read = replace(session, probings=(known,))
    assert with_pictures_measured(read) is read
    assert len(asked) == 1


def test_a_session_without_images_says_so(half_ball: Session) -> None:
    bare = replace(half_ball.probings[0], images=None)
    with pytest.raises(InputError, match="none of its probings has images"):
        measure_motion(replace(half_ball, probings=(bare,)))


def test_a_session_without_a_rig_says_so(half_ball: Session) -> None:
    with pytest.raises(InputError, match="rig"):
        measure_motion(replace(half_ball, rig=None))


@pytest.fixture(scope="module")
def series():
    """Pictures at rest, after the motion, and after the farther one."""
    motions = (STILL, MOTION, FARTHER)
    return [noisy_views(example().views(motion), NOISE, k) for k, motion in enumerate(motions)]


@pytest.fixture(scope="module")
def mesh():
    return TriangleMesh(*example().mesh(2e-3, 0.034))


@pytest.fixture(scope="module", params=FLOW_METHODS)
def begun(request, series, mesh):
    """A method and its state at the first instant."""
    method = FLOW_METHODS[request.param]()
    return method, method.start(example().rig, series[0], mesh)


@pytest.fixture(scope="module")
def steps(begun, series):
    """State and range flow after the motion, and after the farther one."""
    method, state = begun
    first = method.follow(state, series[1])
    return first, method.follow(first[0], series[2])


def _same(first: RangeFlow, other: RangeFlow) -> bool:
    return all(
        np.array_equal(getattr(first, field.name), getattr(other, field.name), equal_nan=True)
        for field in fields(RangeFlow)
    )


def _ratio(error, covariance):
    """Root mean square of error over claim, per component."""
    square = np.einsum("ni,nij,nj->n", error, np.linalg.inv(covariance), error)
    return np.sqrt(square.mean() / 3.0)


def test_a_method_is_a_frozen_set_of_options(begun):
    method, _ = begun
    assert isinstance(method, FlowMethod)
    with pytest.raises(FrozenInstanceError):
        method.subset = 3


def test_no_motion_gives_no_displacement(begun, series):
    method, state = begun
    _, flow = method.follow(state, series[0])
    good = is_valid(flow)
    assert good[flow.outcome != Outcome.HIDDEN].mean() > 0.8
    # The same pictures: a thousandth of a pixel is where iterations end, three in depth.
    assert np.abs(flow.displacement[good]).max() < 3e-3 * PITCH


def test_averages_move_with_a_rigid_motion(begun, steps, mesh):
    method, rig = begun[0], example().rig
    displacement = method.vertices(steps[0][1], rig, mesh)
    same = method.averaged(displacement, steps[0][1], rig, mesh)
    np.testing.assert_array_equal(same.displacement, displacement.displacement)
    average = same.average
    if average is not None:
        moved = (average.weights @ MOTION(average.points).ravel()).reshape(-1, 3)
        expected = MOTION(mesh.vertices)
        # At the corners quadratics are extrapolated by some 3 um, which the turn moves by 0.06 um.
        np.testing.assert_allclose(
            moved[average.has_weights], expected[average.has_weights], atol=1e-7
        )
        assert average.has_weights[measured_vertices(displacement)].mean() > 0.9


def test_a_rigid_motion_is_recovered_as_well_as_claimed(steps):
    for motion, (_, flow) in zip((MOTION, FARTHER), steps, strict=True):
        good = is_valid(flow)
        assert good.mean() > 0.6
        error = flow.displacement[good] - motion(flow.point[good])
        # Always from the first instant. A claim may be a third too small, or twice too large where
        # a bias is claimed that analytic pictures do not have.
        assert 0.4 < _ratio(error, flow.covariance[good]) < 1.5
        assert np.sqrt((error[:, :2] ** 2).mean()) < PITCH


def test_vertices_move_with_the_points_around_them(begun, steps, mesh):
    method, _ = begun
    _, flow = steps[0]
    displacement = method.vertices(flow, example().rig, mesh)
    rows = measured_vertices(displacement)
    assert rows.sum() > 200
    error = displacement.displacement[rows] - MOTION(mesh.vertices[rows])
    assert np.sqrt((error**2).mean()) < 0.5 * PITCH
    assert _ratio(error, displacement.covariance[rows]) < 2.0
    assert (displacement.count[rows] > 0).all()
    assert np.isnan(displacement.covariance[~rows]).all()


def test_the_same_pictures_give_the_same_flow_and_leave_the_state_as_it_was(begun, series, steps):
    method, state = begun
    given = [view.copy() for view in series[1]]
    # After two steps from this state.
    _, again = method.follow(state, given)
    assert _same(steps[0][1], again)
    for before, after in zip(series[1], given, strict=True):
        np.testing.assert_array_equal(before, after)


def test_a_state_that_was_kept_is_the_same(begun, series, steps, tmp_path):
    _, state = begun
    # What is there in any run, as the measurement of a session has it.
    known = {field.name: getattr(state, field.name) for field in fields(state)}
    known |= {f"picture {c}": picture for c, picture in enumerate(series[1])}
    after, _ = steps[0]
    store = Checkpoints(tmp_path, "key")
    store.load_or_make("state", lambda: after, known)
    read = store.load_or_make("state", lambda: pytest.fail("was not kept"), known)
    assert read is not after
    assert content_digest(read) == content_digest(after)
