"""Detection of calibration boards in the pictures of all cameras."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from palpate.calibration.adjustment import Corners
from palpate.calibration.targets import Sighting, Target
from palpate.errors import CalibrationError, RecordError
from palpate.progress import Progress, silent
from palpate.threads import map_in_threads
from palpate.vision import read_grey

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
# A pose has six unknowns and a mark gives two equations: four are a safe minimum, eight a check.
_MIN_MARKS = 8
# A picture counts as blurred if its edges are this many times wider than its camera's median.
_BLURRED = 2.0
# Quantile of the slopes taken as that of an edge, and the number of pixels sampled.
_STEEPEST, _SAMPLES = 0.998, 200_000
# A picture: its camera, its instant, its file.
_Job = tuple[str, str, Path]


@dataclass(frozen=True, slots=True, eq=False)
class Sightings:
    """Marks of boards detected by all cameras. A view is one board at one instant.

    Attributes
    ----------
    cameras : tuple of c str        names
    sizes : tuple of c (columns, rows) [px]
    views : tuple of v str          names of the instants and, if there are several, of the boards
    targets : tuple of v int        index of each view's board
    corners : Corners               of all views, with positions on the board and in the picture
    mark : (m,) int                 number of each corner's mark on its board
    notes : tuple of str            sentences about cameras and pictures that were left out, and why
    """

    cameras: tuple[str, ...]
    sizes: tuple[tuple[int, int], ...]
    views: tuple[str, ...]
    targets: tuple[int, ...]
    corners: Corners
    mark: np.ndarray
    notes: tuple[str, ...]


def find_pictures(place: Path) -> dict[str, dict[str, Path]]:
    """List the calibration pictures of every camera by the names of their instants.

    Pictures of one instant have the same file name, ignoring the camera's name within it.

    Parameters
    ----------
    place : Path                    folder with one folder per camera; or with one camera's pictures

    Returns
    -------
    dict of camera to dict of instant to Path   both sorted; a camera whose folder has no pictures
                                    has none, which `find_boards` notes

    Raises
    ------
    RecordError                     there is no such folder, or there are no pictures in it
    """
    if not place.is_dir():
        raise RecordError(f"{place}: no such folder; give one that has a folder for every camera")
    folders = [path for path in sorted(place.iterdir()) if path.is_dir()]
    found: dict[str, dict[str, Path]] = {}
    for folder in folders or [place]:
        files = sorted(folder.iterdir())
        pictures = [path for path in files if path.suffix.lower() in PICTURE_SUFFIXES]
        # An empty hidden folder is some program's, not a camera's.
        if pictures or not folder.name.startswith("."):
            found[folder.name] = {_instant(path.stem, folder.name): path for path in pictures}
    if not any(found.values()):
        raise RecordError(
            f"{place}: has no pictures ({', '.join(PICTURE_SUFFIXES)}), neither itself nor in the"
            " folders within it; expected is a folder for every camera"
        )
    return found


def _instant(stem: str, camera: str) -> str:
    """File name without the camera's name: 201_07 of camera 201 gives 07."""
    rest = re.sub(rf"(^|[_\-. ]){re.escape(camera)}([_\-. ]|$)", r"\1\2", stem).strip("_-. ")
    return rest or stem


def find_boards(
    pictures: Mapping[str, Mapping[str, Path]],
    targets: Sequence[Target],
    *,
    progress: Progress = silent,
) -> Sightings:
    """Detect the marks of all boards in all pictures.

    Parameters
    ----------
    pictures : mapping of camera to mapping of instant to Path      a camera without pictures is
                                    left out, with a note
    targets : sequence of Target    boards that may be visible, each with its own pose
    progress : callable

    Returns
    -------
    Sightings                       of views in which at least one camera sees a board

    Raises
    ------
    RecordError                     a picture cannot be read
    CalibrationError                pictures of one camera differ in size; no board was found
    """
    jobs = [(c, name, path) for c, by in pictures.items() for name, path in by.items()]

    def work(job: _Job) -> tuple[tuple[int, int], list[Sighting], float]:
        grey = eight_bits(read_grey(job[2]))
        seen = [target.find(grey) for target in targets]
        return (grey.shape[1], grey.shape[0]), seen, _edge_width(grey, seen)

    results = []
    for done, result in enumerate(map_in_threads(work, jobs), start=1):
        results.append(result)
        progress(f"{jobs[done - 1][2].name}", done / len(jobs))
    sizes = _sizes(jobs, [size for size, _, _ in results])
    blurred = _blurred(jobs, [seen for _, seen, _ in results], [width for _, _, width in results])
    sharp = [(*jobs[k], results[k][1]) for k in range(len(jobs)) if k not in blurred]
    found = _gathered([name for name, by in pictures.items() if by], sizes, sharp, targets)
    return replace(found, notes=(*_without_pictures(pictures), *blurred.values(), *found.notes))


def _without_pictures(pictures: Mapping[str, Mapping[str, Path]]) -> list[str]:
    """Notes on cameras whose folders have no pictures."""
    return [
        f"camera '{camera}': its folder has no pictures ({', '.join(PICTURE_SUFFIXES)}); the camera"
        " is left out: were they copied, and are they of one of these kinds?"
        for camera, by in pictures.items()
        if not by
    ]


def _edge_width(grey: UInt8[np.ndarray, "rows columns"], seen: Sequence[Sighting]) -> float:
    """Width of edges between dark and bright, in the direction where they are widest [px].

    It is contrast over steepest slope, within the boards or, if none is found, in the whole
    picture. All directions are tested, since motion blur leaves edges along the motion sharp. The
    picture is smoothed first, against noise, so that no edge is narrower than 2.5 px.
    """
    pixel = np.concatenate([found.pixel for found in seen])
    part = grey
    if len(pixel) >= _MIN_MARKS:
        low, high = np.maximum(pixel.min(axis=0), 0.0), pixel.max(axis=0) + 1.0
        part = grey[int(low[1]) : int(high[1]), int(low[0]) : int(high[0])]
    smooth = cv2.GaussianBlur(part, (0, 0), 1.0)
    step = int(np.ceil(np.sqrt(smooth.size / _SAMPLES)))
    across, down = (
        cv2.Sobel(smooth, cv2.CV_32F, *axis, scale=0.125)[::step, ::step]
        for axis in ((1, 0), (0, 1))
    )
    steepest = min(
        float(np.quantile(np.abs(np.cos(way) * across + np.sin(way) * down), _STEEPEST))
        for way in np.arange(6) * np.pi / 6.0
    )
    dark, bright = np.quantile(smooth[::step, ::step], [0.05, 0.95])
    return float(bright - dark) / max(steepest, 1e-6)


def _blurred(
    jobs: Sequence[_Job], seen: Sequence[Sequence[Sighting]], widths: Sequence[float]
) -> dict[int, str]:
    """Notes on pictures whose edges are far wider than their camera's median, by index."""
    of_camera: dict[str, list[float]] = {}
    for (camera, _, _), width in zip(jobs, widths, strict=True):
        of_camera.setdefault(camera, []).append(width)
    usual = {camera: float(np.median(each)) for camera, each in of_camera.items()}
    found = {}
    for k, ((camera, _, path), boards, width) in enumerate(zip(jobs, seen, widths, strict=True)):
        if width <= _BLURRED * usual[camera]:
            continue
        # Without a board found there may be none: such a picture may have no sharp edges either.
        what = "blurred" if any(len(one.mark) for one in boards) else "no board found, or blurred"
        found[k] = (
            f"{path}: {what}: its edges are {width:.1f} px wide and those of '{camera}' usually"
            f" {usual[camera]:.1f}; left out: did the board move?"
        )
    return found


def eight_bits(grey: Float[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns"]:
    """Round grey levels to bytes, clipped to 0 to 255.

    Parameters
    ----------
    grey : (rows, columns) float [grey levels]

    Returns
    -------
    (rows, columns) uint8
    """
    return np.clip(np.rint(grey), 0.0, 255.0).astype(np.uint8)


def _sizes(jobs: Sequence[_Job], sizes: Sequence[tuple[int, int]]) -> dict[str, tuple[int, int]]:
    """Size (columns, rows) of every camera's pictures; raises if they differ."""
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
    pictures: Sequence[tuple[str, str, Path, list[Sighting]]],
    targets: Sequence[Target],
) -> Sightings:
    """Collect all marks in one list, with notes on pictures that have too few."""
    views: dict[tuple[str, int], int] = {}
    parts, notes = [], []
    for camera, instant, path, boards in pictures:
        count = max((len(found.mark) for found in boards), default=0)
        if count < _MIN_MARKS:
            what = f"{count} marks of a board" if count else "no board"
            notes.append(f"{path}: {what} found; left out")
        for k, found in enumerate(boards):
            if len(found.mark) < _MIN_MARKS:
                continue
            view = views.setdefault((instant, k), len(views))
            numbers = np.tile([cameras.index(camera), view], (len(found.mark), 1))
            parts.append((numbers, targets[k].points[found.mark], found.pixel, found.mark))
    if not parts:
        raise CalibrationError(
            f"no board was found in any of {len(pictures)} pictures; is it the target that was"
            " named, with its numbers of columns and rows (a chessboard's are of inner corners),"
            " whole and sharp in the pictures?"
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
