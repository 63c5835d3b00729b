"""From pictures of a sheet in tension to its constants: 60 000 points, grips that move.

    python -m benchmarks.sheet_fit [REPEATS]

The sheet, its grips and its load cell are those of `benchmarks.tension`, the truth finite elements.
Two cameras see it deformed: every pixel's ray is followed to the deformed surface by iteration, so
nothing of the package has a part in the pictures. The motion is matched anew for every repeat, with
noise in the pictures and in the force: some four minutes each on two cores.
"""

import sys
import time
from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter, map_coordinates

from benchmarks.tension import (
    FORCE,
    FORCE_ERROR,
    NU,
    SHEAR,
    SIZE,
    YOUNG,
    session_of,
    true_displacement,
)
from palpate.geometry import closest_points
from palpate.pipeline import fit_session
from palpate.records import Camera, DisplacementField, Estimate, Rig, Session
from palpate.records.error_priors import ErrorPriors
from palpate.vision import JointFlow, RangeFlow, is_valid

# Columns and rows; a pixel is 0.07 mm on the sheet.
SHAPE = (400, 1500)
DISTANCE, FOCAL = 0.4, 5700.0
PIXEL = DISTANCE / FOCAL
# Texture's pixels for one of the pictures', its speckles' size in them, the grey levels of noise.
FINE, BLOB, NOISE = 3, 1.7, 1.5
# Between the grips, a little away from them and from the edges [m].
LOW, HIGH = np.array([0.013, 0.001]), np.array([0.087, 0.019])
CONSTANTS = {"shear_modulus": SHEAR, "poisson_ratio": NU, "young_modulus": YOUNG}


def make_rig() -> Rig:
    """Two cameras 25 degrees apart above the middle of the sheet's upper face."""
    middle = np.append(0.5 * SIZE[:2], SIZE[2])
    cameras = []
    for k, angle in enumerate((-12.5, 12.5)):
        turn = cv2.Rodrigues(np.deg2rad([180.0, 0.0, 0.0]))[0]
        turn = cv2.Rodrigues(np.deg2rad([0.0, angle, 0.0]))[0] @ turn
        pose = np.eye(4)
        pose[:3, :3] = turn
        pose[:3, 3] = np.array([0.0, 0.0, DISTANCE]) - turn @ middle
        centre = (0.5 * SHAPE[1] - 0.5, 0.5 * SHAPE[0] - 0.5)
        matrix = np.array([[FOCAL, 0.0, centre[0]], [0.0, FOCAL, centre[1]], [0.0, 0.0, 1.0]])
        cameras.append(Camera(f"c{k}", SHAPE[::-1], matrix, np.zeros(8), pose))
    return Rig(tuple(cameras), 0, "sheet_fit")


class DeformedFace:
    """The upper face as the finite elements move it, between their values a spline."""

    def __init__(self) -> None:
        x, y = np.linspace(0.0, SIZE[0], 201), np.linspace(0.0, SIZE[1], 41)
        grid = np.stack([a.ravel() for a in np.meshgrid(x, y, SIZE[2:], indexing="ij")], axis=1)
        moved = true_displacement()(grid).reshape(x.size, y.size, 3)
        self.splines = [RectBivariateSpline(x, y, moved[:, :, k]) for k in range(3)]

    def __call__(self, point: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Displacement of points of the face; beyond its rim that of the rim."""
        x, y = np.clip(point, 0.0, SIZE[:2]).T
        return np.stack([spline.ev(x, y) for spline in self.splines], axis=1)


def picture(
    camera: Camera, texture: Float[np.ndarray, "_ _"], face: DeformedFace | None
) -> Float[np.ndarray, "_ _"]:
    """What a camera sees of the sheet, moved or at rest, without noise."""
    row, column = np.mgrid[: SHAPE[0], : SHAPE[1]].reshape(2, -1)
    pose = camera.T_camera_object
    sight = np.linalg.solve(camera.matrix, np.stack([column, row, np.ones(row.size)]))
    sight = (pose[:3, :3].T @ sight).T
    eye = -pose[:3, :3].T @ pose[:3, 3]
    moved = np.zeros((row.size, 3))
    # Strains of 1 % and tilts of 0.01: every round leaves a fiftieth of the error, 1e-16 m in all.
    for _ in range(1 if face is None else 8):
        depth = (SIZE[2] + moved[:, 2] - eye[2]) / sight[:, 2]
        position = (eye + depth[:, None] * sight - moved)[:, :2]
        if face is not None:
            moved = face(position)
    depth = (SIZE[2] + moved[:, 2] - eye[2]) / sight[:, 2]
    position = (eye + depth[:, None] * sight - moved)[:, :2]
    seen = map_coordinates(
        texture, ((position - 0.5 * SIZE[:2]) * FINE / PIXEL + 0.5 * np.array(texture.shape)).T,
        order=3, mode="mirror",
    )  # fmt: skip
    on_sheet = ((position >= 0.0) & (position <= SIZE[:2])).all(axis=1)
    return np.where(on_sheet, seen, 20.0).reshape(SHAPE)


def measured(session: Session, flow: RangeFlow) -> Session:
    """The session with every valid point between the grips as its measurement."""
    position = flow.point[:, :2]
    valid = is_valid(flow) & ((position > LOW) & (position < HIGH)).all(axis=1)
    points = flow.point[valid]
    std = np.sqrt(np.einsum("nii->ni", flow.covariance[valid]))
    field = DisplacementField(
        points, flow.displacement[valid], std, None, closest_points(session.mesh, points), "flow"
    )
    (probing,) = session.probings
    return replace(session, probings=(replace(probing, displacement=field),))


def repeated(count: int) -> list[Estimate]:
    """Take pictures, match and fit as often as asked."""
    rng = np.random.default_rng(0)
    size = (int(1.3 * SHAPE[1]) * FINE, int(1.3 * SHAPE[0]) * FINE)
    texture = gaussian_filter(rng.normal(size=size).astype(np.float32), FINE * BLOB)
    texture = 120.0 + 40.0 * texture / texture.std()
    rig, face = make_rig(), DeformedFace()
    clean = [[picture(camera, texture, moved) for camera in rig.cameras] for moved in (None, face)]
    session = session_of(np.array([[0.05, 0.01, SIZE[2]]]), ErrorPriors())
    estimates = []
    for _ in range(count):
        begun = time.perf_counter()
        rest, loaded = (
            tuple((seen + rng.normal(scale=NOISE, size=SHAPE)).clip(0, 255) for seen in instant)
            for instant in clean
        )
        method = JointFlow(step=2)
        _, flow = method.follow(method.start(rig, rest, session.mesh), loaded)
        matched = time.perf_counter()
        given = measured(session, flow)
        (probing,) = given.probings
        force = FORCE * (1 + FORCE_ERROR * rng.normal())
        given = replace(given, probings=(replace(probing, force=force),))
        field = given.probings[0].displacement
        error = field.displacement - face(field.points[:, :2])
        estimates.append(fit_session(given).estimate)
        rms = ", ".join(f"{value:.2f}" for value in 1e6 * np.sqrt((error**2).mean(axis=0)))
        print(
            f"{len(error)} points, rms error {rms} um; matched in {matched - begun:.0f} s, fitted"
            f" in {time.perf_counter() - matched:.0f} s",
            flush=True,
        )
    return estimates


def main(count: int) -> None:
    """Print the constants, their errors and whether the intervals hold them."""
    estimates = repeated(count)
    for name, true in CONSTANTS.items():
        constants = [getattr(estimate, name) for estimate in estimates]
        held = sum(constant.ci95[0] <= true <= constant.ci95[1] for constant in constants)
        values = ", ".join(f"{constant.value:.5g}" for constant in constants)
        width = np.median([np.ptp(constant.ci95) for constant in constants])
        print(
            f"{name}: true {true:.5g}, found {values}; median width of the interval {width:.2g},"
            f" holds the truth in {held} of {len(constants)}"
        )
    print("status: " + ", ".join(sorted({str(estimate.status) for estimate in estimates})))


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 1)
