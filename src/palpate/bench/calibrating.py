"""A rig for a bench that has none: a board is held before its cameras until they are known well
enough; then the object is placed over their pictures.

The board's pictures stay in `boards`, the calibration in `calibration`: begun again, it goes on.
"""

from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from jaxtyping import Float

from palpate.bench.bench_file import Bench, put, read_board
from palpate.bench.pushing import grabbed, write_picture
from palpate.bench.questions import Pictures, Questions
from palpate.bench.turning import SCANNED, TURNS
from palpate.calibration import (
    TARGET_KINDS,
    Calibration,
    ObjectView,
    Sighting,
    Sightings,
    Target,
    board_frame,
    calibrate,
    camera_quality,
    eight_bits,
    find_pictures,
    gathered,
    length_sigma,
    timing_note,
    view_object,
    without_repeats,
    write_calibration,
)
from palpate.disk import atomic_replacement
from palpate.errors import CalibrationError, InputError
from palpate.figures import object_figure, save_figure
from palpate.geometry import TriangleMesh
from palpate.records import (
    Rig,
    RigCovariance,
    TomlTable,
    read_rig,
    read_rig_covariance,
    write_rig,
)
from palpate.vision import picture_path, read_grey

CALIBRATED = "calibration"
_BOARDS, _TABLE = "boards", "table"
# A board is still that moves by less [px] in so long [s], and at a new place where it has moved by
# more, over the width of the pictures.
_STILL, _LONG, _NEWS = 0.5, 0.5, 0.05
# With fewer marks a picture says nothing.
_MARKS = 8
# Places from which on the covariance is trusted: of three, lengths were off by three times as much.
_FEWEST = 4
# Relative standard deviation to which lengths on the object are to be known, whatever is wanted of
# the constants: squared in E it is 0.2 %, which widens the interval of a gauge's gain, 1 %, by 2 %.
PRECISE = 1e-3
_USUAL = {"charuco": "9 7 20mm 15mm", "aprilgrid": "6 6 22mm 6.6mm"}
_Seen = tuple[Sighting, ...]


class _Places:
    """Positions in which a board was held still so far, with the pictures of all cameras."""

    def __init__(self, folder: Path, board: Target, cameras: Sequence[str]) -> None:
        self.folder, self.board, self.cameras = folder, board, list(cameras)
        self.sizes: dict[str, tuple[int, int]] = {}
        self.pictures: list[tuple[str, str, Path, list[Sighting]]] = []
        earlier = find_pictures(folder) if any(folder.rglob("*.png")) else {}
        # What was being written when the process ended is left out.
        whole = set.intersection(*(set(earlier.get(camera, ())) for camera in self.cameras))
        for camera, instant in product(self.cameras, sorted(whole)):
            path = earlier[camera][instant]
            self._add(camera, instant, path, eight_bits(read_grey(path)))

    @property
    def count(self) -> int:
        """Number of places."""
        return len(self.pictures) // len(self.cameras)

    @property
    def has_table(self) -> bool:
        """Whether one of them is that where the object will stand."""
        return any(instant == _TABLE for _, instant, _, _ in self.pictures)

    def sightings(self) -> Sightings:
        """Sightings of the board in all pictures."""
        return gathered(self.cameras, self.sizes, self.pictures, [self.board])

    def dots(self) -> list[Float[np.ndarray, "k 2"]]:
        """All marks in the pictures of each camera [px]."""
        every = [[seen[0].pixel for c, _, _, seen in self.pictures if c == camera]
                 for camera in self.cameras]  # fmt: skip
        return [np.concatenate([np.zeros((0, 2)), *marks]) for marks in every]

    def is_new(self, seen: _Seen) -> bool:
        """Whether the board is at a place where it was not before."""
        here = [
            (camera, "", Path(), [sighting])
            for camera, sighting in zip(self.cameras, seen, strict=True)
        ]
        with_it = gathered(self.cameras, self.sizes, [*self.pictures, *here], [self.board])
        return "" in without_repeats(with_it, news=_NEWS).views

    def add(self, pictures: Pictures) -> None:
        """Keep a place; the first one is the table."""
        instant = f"{self.count:02d}" if self.has_table else _TABLE
        for camera, picture in zip(self.cameras, pictures, strict=True):
            path = self.folder / camera / f"{instant}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            write_picture(path, picture)
            self._add(camera, instant, path, picture)

    def forget_table(self) -> None:
        """Take the place of the object out again."""
        for _, _, path, _ in [picture for picture in self.pictures if picture[1] == _TABLE]:
            path.unlink()
        self.pictures = [picture for picture in self.pictures if picture[1] != _TABLE]

    def _add(self, camera: str, instant: str, path: Path, picture: np.ndarray) -> None:
        self.sizes[camera] = (picture.shape[1], picture.shape[0])
        self.pictures.append((camera, instant, path, [self.board.find(picture)]))


def calibrate_live(
    bench: Bench, questions: Questions, folder: Path, *, wanted: float = PRECISE
) -> None:
    """Calibrate the cameras with a board that a person holds, into `calibration` of a folder.

    Parameters
    ----------
    bench : Bench                   started
    questions : Questions
    folder : Path                   of the session
    wanted : float [-]              relative standard deviation to which lengths on an object where
                                    the board lay are to be known

    Raises
    ------
    DeviceError                     a camera that fails; what was found stays
    """
    board = bench.board or _asked_board(questions)
    places = _Places(folder / _BOARDS, board, [camera.name for camera in bench.cameras])
    while True:
        if not places.has_table:
            questions.wait("Lay the board where the object will stand, in view of all cameras")
        places.add(_still_pictures(bench, questions, places))
        calibration = _calibrated(places, questions)
        if calibration is None:
            continue
        if _TABLE not in calibration.sightings.views:
            questions.tell("The board on the table does not agree with the others: once more")
            places.forget_table()
            continue
        if not _is_enough(calibration, places, wanted, questions):
            continue
        frame = board_frame(calibration, [board], _TABLE)
        with atomic_replacement(folder / CALIBRATED, folder=True) as staged:
            write_calibration(staged, calibration, frame=frame)
        return


def _asked_board(questions: Questions) -> Target:
    """The board that a person has."""
    kind = questions.choose("What kind of board is it?", list(TARGET_KINDS))
    second = TARGET_KINDS[kind]
    lengths = "side of a square or tag, or spacing of circles"
    text = f"Columns, rows, {lengths}{f', {second}' if second else ''}"
    while True:
        words = questions.ask(text, _USUAL.get(kind, "9 7 20mm")).split()
        names = ["columns", "rows", "square", *([second] if second else [])]
        values = {name: int(word) if word.isdigit() else word.replace("mm", " mm")
                  for name, word in zip(names, words, strict=False)}  # fmt: skip
        try:
            return read_board(TomlTable(Path("answer"), "board", {"target": kind, **values}))
        except InputError as error:
            questions.tell(str(error))


def _still_pictures(bench: Bench, questions: Questions, places: _Places) -> Pictures:
    """Pictures of the board, once it is still at a new place."""
    since: tuple[float, _Seen] | None = None
    while True:
        when, pictures = grabbed(bench)
        seen = tuple(places.board.find(picture) for picture in pictures)
        there = any(len(sighting.mark) >= _MARKS for sighting in seen)
        new = there and (not places.has_table or places.is_new(seen))
        state = "hold still" if new else "elsewhere, or tilted otherwise" if there else "no board"
        questions.see(pictures, [], [], f"{state}; {places.count} places", places.dots())
        if not new or since is None or _shift(since[1], seen) > _STILL:
            since = when, seen
        elif when - since[0] > _LONG:
            return pictures


def _shift(before: _Seen, after: _Seen) -> float:
    """How far a board has moved in the picture where it moved most [px]."""
    distances = []
    for first, second in zip(before, after, strict=True):
        _, a, b = np.intersect1d(first.mark, second.mark, return_indices=True)
        if len(a) >= _MARKS:
            distances.append(np.median(np.linalg.norm(first.pixel[a] - second.pixel[b], axis=1)))
    return float(max(distances, default=np.inf))


def _calibrated(places: _Places, questions: Questions) -> Calibration | None:
    """The calibration from all places; None, which is said, where they do not give one yet."""
    if places.count < _FEWEST:
        questions.tell(f"{places.count} places of the board: now hold it up, turn and tilt it")
        return None
    try:
        with questions.working() as progress:
            progress("calibration", 0.0)
            return calibrate(places.sightings(), [places.board])
    except CalibrationError as error:
        questions.tell(f"{places.count} places of the board: {error}")
        return None


def _is_enough(
    calibration: Calibration, places: _Places, wanted: float, questions: Questions
) -> bool:
    """Whether lengths are known well enough where the object will stand; how well is said, and what
    views are missing where that is not enough."""
    try:
        sigma = length_sigma(calibration, [places.board], _TABLE)
    except CalibrationError as error:
        questions.tell(str(error))
        return False
    enough = sigma <= wanted
    missing = [text for camera in camera_quality(calibration) for text in camera.missing]
    more = [*(() if enough else missing), *filter(None, [timing_note(calibration)])]
    questions.tell(
        f"{places.count} places of the board: lengths are known to {100 * sigma:.2g} %, of"
        f" {100 * wanted:.2g} % wanted{''.join(f'; {text}' for text in more)}"
    )
    return enough


def place_object(bench: Bench, questions: Questions, folder: Path, mesh: TriangleMesh) -> None:
    """Find the object in the pictures, and write the rig in its frame, with its covariance.

    Parameters
    ----------
    bench : Bench                   started
    questions : Questions
    folder : Path                   of the session, with `calibration`
    mesh : TriangleMesh             the object

    Raises
    ------
    DeviceError                     a camera that fails
    """
    given = read_rig(folder / CALIBRATED / "rig.toml")
    covariance = folder / CALIBRATED / "rig_covariance.npz"
    known = read_rig_covariance(covariance)
    start = np.eye(4)
    if not (folder / SCANNED).exists():
        # It stands with z up, about where the board lay.
        low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
        start[:3, 3] = -np.array([*(0.5 * (low + high)[:2]), low[2]])
    # Scanned here, it stands as the last view shows it.
    rig, search = moved_rig(given, start), not (folder / TURNS).exists()
    if search:
        questions.wait("Put the object there, as it will be pressed, and hands out of the pictures")
    while True:
        pictures = grabbed(bench)[1]
        if search:
            try:
                with questions.working() as progress:
                    progress("the object in the pictures", 0.0)
                    view = _view(rig, mesh, pictures, known)
            except CalibrationError as error:
                questions.tell(str(error))
            else:
                rig = view.rig
                for note in view.notes:
                    questions.tell(note)
        save_figure(object_figure(rig, mesh, pictures), folder / "object.png")
        motion = questions.over(rig, mesh, folder / "object.png")
        if motion is None:
            break
        rig = moved_rig(rig, motion)
        search = questions.choose("Fit it to the pictures from there?", ["yes", "no"]) == "yes"
    put(covariance.read_bytes(), folder / covariance.name)
    with atomic_replacement(folder / "rig.toml") as staged:
        write_rig(staged, rig)


def _view(rig: Rig, mesh: TriangleMesh, pictures: Pictures, known: RigCovariance) -> ObjectView:
    """The rig in the object's frame."""
    with TemporaryDirectory() as folder:
        pattern = str(Path(folder, "{camera}.png"))
        for camera, picture in zip(rig.cameras, pictures, strict=True):
            write_picture(picture_path(camera, pattern, Path()), picture)
        return view_object(rig, mesh, [pattern], known=known)


def moved_rig(rig: Rig, motion: Float[np.ndarray, "4 4"]) -> Rig:
    """The rig in a frame that was moved with the object: x_before = motion x_after."""
    return replace(
        rig,
        cameras=tuple(
            replace(camera, T_camera_object=camera.T_camera_object @ motion)
            for camera in rig.cameras
        ),
    )
