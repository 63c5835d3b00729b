"""A rig refined by points of an object: nearer the truth, by as much as it says, or untouched."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.boards import SIZE, true_bundle
from palpate.calibration.refinement import KnownSurface, Refined, Ties, refined_rig
from palpate.errors import CalibrationError
from palpate.geometry import TriangleMesh
from palpate.records import Camera, Rig, RigCovariance, camera_matrix
from palpate.vision import calibration_numbers, moved_rig, project

_TERMS = ("rx", "ry", "rz", "tx", "ty", "tz")
# Of a calibration some days old: 0.2 degrees, 0.3 mm, 3 px of focal length.
_SIGMA = (*[np.deg2rad(0.2)] * 3, *[3e-4] * 3)


def _rig(rng: np.random.Generator, cameras: int = 3) -> Rig:
    truth = true_bundle(rng, cameras=cameras, views=1)
    made = [
        Camera(f"c{c}", SIZE, camera_matrix(intrinsics[:4]), intrinsics[4:], pose)
        for c, (intrinsics, pose) in enumerate(zip(truth.intrinsics, truth.camera, strict=True))
    ]
    return Rig(tuple(made), 0, "test")


def _known(rig: Rig) -> RigCovariance:
    names, sigma = ["c0.fx"], [3.0]
    for camera in rig.cameras[1:]:
        names += [f"{camera.name}.{term}" for term in ("fx", *_TERMS)]
        sigma += [3.0, *_SIGMA]
    value = calibration_numbers(rig.cameras, names)
    return RigCovariance(tuple(names), value, np.diag(np.square(sigma)), "test")


def _bumpy(across: np.ndarray) -> np.ndarray:
    """Places of the surface."""
    depth = 0.36 - 0.012 * np.cos(100.0 * across).prod(axis=1)
    return np.column_stack([across + np.array([0.02, 0.0]), depth])


def _ties(rig: Rig, rng: np.random.Generator, *, noise: float, points: int = 160) -> Ties:
    """Points of a bumpy surface 0.36 m away, as the cameras of a rig see them."""
    points_seen = _bumpy(rng.uniform(-0.02, 0.02, (points, 2)))
    pixels = np.stack([project(camera, points_seen) for camera in rig.cameras])
    pixels += noise * rng.normal(size=pixels.shape)
    return Ties(pixels, np.broadcast_to(0.03**2 * np.eye(2), (*pixels.shape, 2)).copy())


def _drawn(seed: int, *, noise: float = 0.03) -> tuple[Refined, Rig, Rig]:
    """A refinement, the true rig, and the one that it began with."""
    rng = np.random.default_rng(seed)
    truth = _rig(rng)
    known = _known(truth)
    off = rng.multivariate_normal(np.zeros(len(known.names)), known.covariance)
    given = moved_rig(truth, known.names, off)
    stated = RigCovariance(
        known.names, calibration_numbers(given.cameras, known.names), known.covariance, "test"
    )
    return refined_rig(given, stated, _ties(truth, rng, noise=noise)), truth, given


def _errors(rig: Rig, truth: Rig, names: tuple[str, ...]) -> np.ndarray:
    """Of every number; a turn as the covariance counts it, after that of the pose."""
    errors = calibration_numbers(rig.cameras, names) - calibration_numbers(truth.cameras, names)
    for camera, true in zip(rig.cameras[1:], truth.cameras[1:], strict=True):
        turn = camera.T_camera_object[:3, :3] @ true.T_camera_object[:3, :3].T
        first = names.index(f"{camera.name}.rx")
        errors[first : first + 3] = Rotation.from_matrix(turn).as_rotvec()
    return errors


def test_errors_shrink_to_what_the_covariance_says() -> None:
    inside, gain = [], []
    for seed in range(2):
        made, truth, given = _drawn(seed)
        assert made.better
        error = _errors(made.rig, truth, made.known.names)
        inside.append(error @ np.linalg.solve(made.known.covariance, error) / len(error))
        before = _errors(given, truth, made.known.names)
        turns = [name.rpartition(".")[2] in ("rx", "rz") for name in made.known.names]
        gain.append(np.abs(error[turns]).mean() / np.abs(before[turns]).mean())
    # 2 x 15 degrees of freedom: a standard deviation of 0.26.
    assert 0.5 < np.mean(inside) < 1.5
    # Turns across the epipolar lines are what such points show best.
    assert np.mean(gain) < 0.3


def test_what_points_do_not_show_stays() -> None:
    """The length of all baselines together is not in the pictures: neither better nor worse."""
    made, _, given = _drawn(7)
    length = [
        np.linalg.norm([np.linalg.norm(c.T_camera_object[:3, 3]) for c in rig.cameras])
        for rig in (made.rig, given)
    ]
    sigma = 3e-4
    assert abs(length[0] - length[1]) < sigma


def test_a_rig_that_cannot_be_made_better_is_left() -> None:
    """Known better than the points tell; and matches that are worse than the rig."""
    rng = np.random.default_rng(3)
    truth = _rig(rng)
    known = _known(truth)
    tight = RigCovariance(known.names, known.value, 1e-12 * known.covariance, "test")
    made = refined_rig(truth, tight, _ties(truth, rng, noise=0.5, points=80))
    assert made.after == pytest.approx(made.before, rel=1e-4)
    worse = [
        refined_rig(truth, known, _ties(truth, np.random.default_rng(seed), noise=3.0, points=70))
        for seed in range(3)
    ]
    left = [refined for refined in worse if not refined.better]
    assert left
    for refined in left:
        assert refined.rig is truth
        assert refined.known is known


def test_unusable_points_are_counted_where_the_rig_is_left_too() -> None:
    """Five points that the reference alone sees."""
    rng = np.random.default_rng(3)
    truth = _rig(rng)
    known = _known(truth)
    tight = RigCovariance(known.names, known.value, 1e-12 * known.covariance, "test")
    ties = _ties(truth, rng, noise=0.5, points=80)
    ties.pixels[1:, :5] = np.nan
    made = refined_rig(truth, tight, ties)
    assert not made.better
    assert (made.points, made.rejected) == (75, 5)


def test_gross_matches_have_no_say() -> None:
    rng = np.random.default_rng(9)
    truth = _rig(rng)
    known = _known(truth)
    given = moved_rig(truth, known.names, 1.5 * np.sqrt(np.diag(known.covariance)))
    ties = _ties(truth, rng, noise=0.03)
    wrong = rng.random(160) < 0.1
    ties.pixels[1:, wrong] += rng.uniform(10.0, 30.0, (2, int(wrong.sum()), 2))
    made = refined_rig(given, RigCovariance(
        known.names, calibration_numbers(given.cameras, known.names), known.covariance, "test"
    ), ties)  # fmt: skip
    assert made.better
    assert made.rejected == pytest.approx(wrong.sum(), abs=3)
    # Noise of 0.03 px; what the gross ones left would be pixels.
    assert made.after < 0.05


def test_too_few_points_are_refused() -> None:
    rng = np.random.default_rng(1)
    truth = _rig(rng)
    with pytest.raises(CalibrationError, match="20 points of the object are seen"):
        refined_rig(truth, None, _ties(truth, rng, noise=0.03, points=20))


def test_the_surface_tells_how_far_the_cameras_turn_toward_each_other() -> None:
    """Rays alone take a turn toward each other for depth; the shape of the object does not."""
    line = np.linspace(-0.021, 0.021, 41)
    # Chords of a millimetre: 16 um inside the crests, where depth is known to 40 um.
    corners = _bumpy(np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2))
    first = (41 * np.arange(40)[:, None] + np.arange(40)).ravel()
    quads = first[:, None] + np.array([0, 1, 42, 41])
    mesh = TriangleMesh(corners, np.concatenate([quads[:, [0, 2, 1]], quads[:, [0, 3, 2]]]))
    rng = np.random.default_rng(1)
    truth = _rig(rng)
    names = _known(truth).names
    off = rng.multivariate_normal(np.zeros(len(names)), _known(truth).covariance)
    off[[name.endswith("fx") for name in names]] = 0.0
    given = moved_rig(truth, names, off)
    ties = _ties(truth, rng, noise=0.03)
    # Half a millimetre and a tenth of a degree off, as a registration leaves it.
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.0, 0.002, 0.001]).as_matrix()
    pose[:3, 3] = [0.0, 5e-4, 0.0]
    turns = [names.index(f"{camera}.ry") for camera in ("c1", "c2")]
    error = []
    for surface in (None, KnownSurface(mesh, pose, ties)):
        made = refined_rig(given, None, ties, surface)
        assert made.better
        error.append(np.abs(_errors(made.rig, truth, names)[turns]).max())
    # A third, of which the chords are the most.
    assert error[1] < 0.5 * error[0]
