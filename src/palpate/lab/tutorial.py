"""Raw recordings for the tutorial: calibration boards, a turntable, videos of presses.

They show one unknown half ball, taken by three uncalibrated cameras. The ground truth is written to
a folder of its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
import tomlkit
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from palpate.lab.arm import aim
from palpate.lab.config import LabConfig
from palpate.lab.config_files import built_in, read_lab_config
from palpate.lab.head import board_picture, make_head
from palpate.lab.press_film import (
    Film,
    SolvedPress,
    film_frames,
    gauge_readings,
    rest_pictures,
    solve_press,
    write_film,
)
from palpate.lab.scene import Variant
from palpate.lab.studio import make_studio, photograph
from palpate.progress import Progress, part_of, silent
from palpate.records import Rig, camera_centre, write_rig, write_text
from palpate.shapes import Vector3

# The head looks from above, so that all three cameras also see a board on the table.
_TOWARD = (0.35, -0.5, 0.8)
_BOARD_BLUR = 0.6
# Largest tilt and in-plane rotation of the boards [degrees], and largest offsets of their middle
# across and along the viewing direction [m].
_TILT, _TURN, _AWAY, _NEARER = 32.0, 60.0, 0.015, 0.05
_SCAN = """\
# The half ball on a turntable whose axis goes up through the middle of the board that lay there.
format = "palpate-scan/1"
length_unit = "m"
support = "z=0"

[rig]
cameras = "../rig/rig.toml"

[turntable]
point = [0, 0, 0]
axis = [0, 0, 1]
"""


# A printed board: grey levels, (rows, columns), 0 ink and 255 paper; width and height [m].
Print = tuple[UInt8[np.ndarray, "_ _"], tuple[float, float]]


@dataclass(frozen=True, slots=True)
class TutorialSize:
    """How much is recorded.

    Attributes
    ----------
    columns, rows : int [px]        size of the pictures
    boards, views : int             number of board poses, and of turntable positions
    presses : int                   1 to 3
    frame_rate : float [Hz]         of the videos
    hold : float [s]                duration of the plateau of a press
    element : float [m]             edge of the body's finite elements
    depths : int                    number of solved depths of a press
    """

    columns: int = 480
    rows: int = 384
    boards: int = 15
    views: int = 12
    presses: int = 3
    frame_rate: float = 15.0
    hold: float = 1.2
    element: float = 0.008
    depths: int = 6


def make_tutorial(
    folder: Path,
    board: Print,
    *,
    variant: Variant,
    size: TutorialSize = TutorialSize(),
    progress: Progress = silent,
) -> None:
    """Record boards, turntable and presses into an empty folder.

    Parameters
    ----------
    folder : Path                   an existing folder; gets boards, turntable, presses and truth
    board : levels, extent          calibration board (`Print`)
    variant : Variant               of Mitsuba
    size : TutorialSize
    progress : callable             called with the current step (text) and the fraction done, 0..1

    Raises
    ------
    RecordError                     a file cannot be written
    InputError                      Mitsuba is not installed
    NotConvergedError               as in `solve_press`
    """
    config = _config(size)
    rig = make_head(config.head, config.specimen.mesh)
    _write_boards(folder / "boards", rig, board, config, size, part_of(progress, 0.0, 0.15))
    _write_turntable(folder / "turntable", rig, config, size, variant, part_of(progress, 0.15, 0.4))
    solved = _write_films(
        folder / "presses", rig, config, size, variant, part_of(progress, 0.4, 1.0)
    )
    _write_truth(folder, rig, config, solved)


def _config(size: TutorialSize) -> LabConfig:
    """Configuration of the demo's half ball with other cameras, texture size and elements."""
    demo = read_lab_config(built_in()["demo"])
    head = replace(
        demo.head, columns=size.columns, rows=size.rows, toward=np.array(_TOWARD), k1=-0.08
    )
    look = replace(demo.look, size=2.2e-3 * 400 / size.columns)
    specimen = replace(demo.specimen, element=size.element)
    return replace(
        demo, head=head, look=look, specimen=specimen, probes=demo.probes[: size.presses]
    )


def _write_boards(
    folder: Path, rig: Rig, board: Print, config: LabConfig, size: TutorialSize, progress: Progress
) -> None:
    """Pictures of the board: first lying on the table, then held at various poses."""
    rng = np.random.default_rng([config.seed, 10])
    for camera in rig.cameras:
        (folder / camera.name).mkdir(parents=True)
    for number in range(size.boards):
        progress("boards", number / size.boards)
        pose = board_pose(rig, board, config, number, rng)
        for camera in rig.cameras:
            picture = board_picture(
                camera, pose, *board, rng=rng, noise=config.pictures.noise,
                blur=_BOARD_BLUR,
            )  # fmt: skip
            cv2.imwrite(str(folder / camera.name / f"{number:02d}.png"), picture)


def board_pose(
    rig: Rig, board: Print, config: LabConfig, number: int, rng: np.random.Generator
) -> Float[np.ndarray, "4 4"]:
    """Pose of a board that is shown to the cameras: the first on the table, where the object will
    stand; the others tilted in front of the cameras.

    Parameters
    ----------
    rig : Rig
    board : levels, extent          `Print`
    config : LabConfig              its specimen's size says where the table is
    number : int                    of the pose, from 0
    rng : Generator

    Returns
    -------
    (4, 4) float [m]                x_object = pose x_board
    """
    # The print faces -z of its own frame.
    turn, middle = np.diag([1.0, -1.0, -1.0]), np.zeros(3)
    if number > 0:
        middle = 0.5 * np.ptp(config.specimen.mesh.vertices, axis=0) * [0.0, 0.0, 1.0]
        eye = np.mean([camera_centre(camera) for camera in rig.cameras], axis=0)
        view = (middle - eye) / np.linalg.norm(middle - eye)
        right = np.cross(view, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        facing = np.stack([right, np.cross(view, right), view], axis=1)
        # Tilt directions in turn all around, so that no two views are alike.
        side = 2.4 * number
        angle = np.deg2rad(_TILT * rng.uniform(0.5, 1.0))
        tilt = angle * np.array([np.cos(side), np.sin(side), 0.0])
        spin = np.deg2rad(_TURN) * rng.uniform(-1.0, 1.0)
        turn = facing @ Rotation.from_rotvec(tilt).as_matrix()
        turn = turn @ Rotation.from_rotvec([0.0, 0.0, spin]).as_matrix()
        middle = middle + facing @ (rng.uniform(-1, 1, 3) * [_AWAY, _AWAY, _NEARER])
    pose = np.eye(4)
    pose[:3, :3] = turn
    _, (width, height) = board
    pose[:3, 3] = middle - turn @ [0.5 * width, 0.5 * height, 0.0]
    return pose


def _write_turntable(
    folder: Path,
    rig: Rig,
    config: LabConfig,
    size: TutorialSize,
    variant: Variant,
    progress: Progress,
) -> None:
    """The object on a turntable, and scan.toml."""
    folder.mkdir()
    studio = make_studio(config, rig, variant, rng=np.random.default_rng([config.seed, 0, 0]))
    step = 360.0 / size.views
    for k in range(size.views):
        progress("turntable", k / size.views)
        turn = Rotation.from_euler("z", k * step, degrees=True)
        instant = [studio.mesh.vertices @ turn.as_matrix().T]
        taken = photograph(studio, instant, rng=np.random.default_rng([config.seed, 11, k]))
        for camera, picture in zip(rig.cameras, taken, strict=True):
            cv2.imwrite(str(folder / f"v{k:02d}_{camera.name}.png"), picture)
    views = "".join(
        f'\n[[view]]\nimages = "v{k:02d}_{{camera}}.png"\nangle = {k * step:g}\n'
        for k in range(size.views)
    )
    write_text(folder / "scan.toml", _SCAN + views)


def _write_films(
    folder: Path,
    rig: Rig,
    config: LabConfig,
    size: TutorialSize,
    variant: Variant,
    progress: Progress,
) -> list[SolvedPress]:
    """Videos of the presses and the gauge's log."""
    folder.mkdir()
    mesh, count = config.specimen.mesh, len(config.probes)
    film = Film(count, size.depths, frame_rate=size.frame_rate, hold=size.hold)
    solved = []
    for k, probe in enumerate(config.probes):
        progress(f"press {k + 1}", 0.4 * k / count)
        tip = aim(probe, config.arm, mesh, rng=np.random.default_rng([config.seed, 1, k]))
        solved.append(solve_press(config, tip, k, film))
    rests = rest_pictures(config, rig, variant)
    for number, camera in enumerate(rig.cameras):
        progress(f"film of {camera.name}", 0.4 + 0.6 * number / len(rig.cameras))
        rng = np.random.default_rng([config.seed, 12, number])
        frames = film_frames(film, config, rig, number, rests[number], solved, rng=rng)
        write_film(folder / f"{camera.name}.avi", frames, film.frame_rate)
    time, force = gauge_readings(film, solved, rng=np.random.default_rng([config.seed, 13]))
    rows = "\n".join(",".join(f"{x:.5f}" for x in row) for row in np.column_stack([time, force]))
    write_text(folder / "force.csv", f"time [s],Fx [N],Fy [N],Fz [N]\n{rows}\n")
    return solved


def _write_truth(folder: Path, rig: Rig, config: LabConfig, solved: Sequence[SolvedPress]) -> None:
    """Ground truth: rig, constants and contacts."""
    target = folder / "truth"
    target.mkdir()
    write_rig(target / "rig.toml", rig)
    table = {
        "young_modulus": config.material.young_modulus,
        "poisson_ratio": config.material.poisson_ratio,
        "press": [
            {
                "point": _listed(press.point),
                "radius": press.radius,
                "force": _listed(press.force[-1]),
            }
            for press in solved
        ],
    }
    write_text(target / "truth.toml", tomlkit.dumps(table))


def _listed(vector: Vector3) -> list[float]:
    return [round(float(x), 9) for x in vector]
