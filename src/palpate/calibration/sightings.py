"""Boards found in the pictures of all cameras."""

import re
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numba
import numpy as np
from jaxtyping import Float, UInt8

from palpate.calibration.adjustment import Corners
from palpate.calibration.targets import Sighting, Target
from palpate.errors import CalibrationError, RecordError
from palpate.progress import Progress, silent
from palpate.vision import read_grey

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
# A pose has six unknowns and a mark gives two numbers: four marks are the least, eight a check.
_MIN_MARKS = 8


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """What all cameras saw of the boards.

    Attributes
    ----------
    cameras : tuple of c str        names
    sizes : tuple of c (columns, rows) [px]
    views : tuple of v str          names of the instants and, where there are several, the boards
    targets : tuple of v int        which board each view is of
    corners : Corners               of all views, marks by their place on the board
    mark : (m,) int                 number of each corner's mark on its board
    notes : tuple of str            pictures that were left out, and why, in sentences
    """

    cameras: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    views: tuple[str, ...]
    targets: tuple[int, ...]
    corners: Corners
    mark: np.ndarray
    notes: tuple[str, ...]


def find_pictures(place: Path) -> dict[str, dict[str, Path]]:
    """Calibration pictures of every camera by the names of their instants.

    A folder with a folder per camera; pictures of one instant have the same name, the camera's own
    name within it apart.

    Parameters
    ----------
    place : Path

    Returns
    -------
    dict of camera to dict of instant to Path   both sorted

    Raises
    ------
    RecordError                     no folder, no cameras in it, a camera without pictures
    """
    if not place.is_dir():
        raise RecordError(f"{place}: no such folder; give one that has a folder for every camera")
    folders = [path for path in sorted(place.iterdir()) if path.is_dir()]
    found: dict[str, dict[str, Path]] = {}
    for folder in folders or [place]:
        files = sorted(folder.iterdir())
        pictures = [path for path in files if path.suffix.lower() in PICTURE_SUFFIXES]
        if pictures:
            found[folder.name] = {_instant(path.stem, folder.name): path for path in pictures}
    if not found:
        raise RecordError(
            f"{place}: has no pictures ({', '.join(PICTURE_SUFFIXES)}), neither itself nor in the"
            " folders within it; expected is a folder for every camera"
        )
    return found


def _instant(stem: str, camera: str) -> str:
    """The name of a picture without that of its camera: 201_07 of camera 201 is 07."""
    rest = re.sub(rf"(^|[_\-. ]){re.escape(camera)}([_\-. ]|$)", r"\1\2", stem).strip("_-. ")
    return rest or stem


def find_boards(
    pictures: Mapping[str, Mapping[str, Path]],
    targets: Sequence[Target],
    *,
    progress: Progress = silent,
) -> Sightings:
    """Find the marks of all boards in all pictures.

    Parameters
    ----------
    pictures : mapping of camera to mapping of instant to Path
    targets : sequence of Target    boards that may be seen, each at its own pose
    progress : callable

    Returns
    -------
    Sightings                       of views with a board in at least one camera

    Raises
    ------
    RecordError                     a picture that cannot be read
    CalibrationError                pictures of one camera of different size; no board found
    """
    jobs = [(c, name, path) for c, by in pictures.items() for name, path in by.items()]

    def work(job: tuple[str, str, Path]) -> tuple[tuple[int, int], list[Sighting]]:
        grey = eight_bits(read_grey(job[2]))
        return (grey.shape[1], grey.shape[0]), [target.find(grey) for target in targets]

    results = []
    with ThreadPoolExecutor(numba.get_num_threads()) as pool:
        for done, result in enumerate(pool.map(work, jobs), start=1):
            results.append(result)
            progress(f"{jobs[done - 1][2].name}", done / len(jobs))
    sizes = _sizes(jobs, [size for size, _ in results])
    return _gathered(list(pictures), sizes, jobs, [seen for _, seen in results], targets)


def eight_bits(grey: Float[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns"]:
    """Grey levels 0 to 255 as bytes.

    Parameters
    ----------
    grey : (rows, columns) float

    Returns
    -------
    (rows, columns) uint8
    """
    return np.clip(np.rint(grey), 0.0, 255.0).astype(np.uint8)


def _sizes(
    jobs: Sequence[tuple[str, str, Path]], sizes: Sequence[tuple[int, int]]
) -> dict[str, tuple[int, int]]:
    """Size of every camera's pictures."""
    found: dict[str, tuple[int, int]] = {}
    for (camera, _, path), size in zip(jobs, sizes, strict=True):
        if found.setdefault(camera, size) != size:
            raise CalibrationError(
                f"{path}: has {size[0]} x {size[1]} pixels, pictures of camera '{camera}' before it"
                f" {found[camera][0]} x {found[camera][1]}; a calibration holds for one size"
            )
    return found


def _gathered(
    cameras: list[str],
    sizes: Mapping[str, tuple[int, int]],
    jobs: Sequence[tuple[str, str, Path]],
    seen: Sequence[Sequence[Sighting]],
    targets: Sequence[Target],
) -> Sightings:
    """All marks in one list; pictures with too few of them are named."""
    views: dict[tuple[str, int], int] = {}
    parts, notes = [], []
    for (camera, instant, path), boards in zip(jobs, seen, strict=True):
        most = max((len(found.mark) for found in boards), default=0)
        if most < _MIN_MARKS:
            what = f"{most} marks of a board" if most else "no board"
            notes.append(f"{path}: {what} found; left out")
        for k, found in enumerate(boards):
            if len(found.mark) < _MIN_MARKS:
                continue
            view = views.setdefault((instant, k), len(views))
            numbers = np.tile([cameras.index(camera), view], (len(found.mark), 1))
            parts.append((numbers, targets[k].points[found.mark], found.pixel, found.mark))
    if not parts:
        raise CalibrationError(
            f"no board was found in any of {len(jobs)} pictures; is it the target that was named,"
            " with its numbers of columns and rows (a chessboard's are of inner corners), whole and"
            " sharp in the pictures?"
        )
    numbers, point, pixel, mark = (np.concatenate(part) for part in zip(*parts, strict=True))
    several = len(targets) > 1
    names = tuple(f"{instant} board {k}" if several else instant for instant, k in views)
    return Sightings(
        tuple(cameras),
        tuple(sizes[name] for name in cameras),
        names,
        tuple(k for _, k in views),
        Corners(numbers[:, 0], numbers[:, 1], point, pixel),
        mark,
        tuple(notes),
    )
