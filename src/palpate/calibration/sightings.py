"""Detection of calibration boards in the pictures or videos of all cameras.

Frames of the same number show the same instant. From every section of the videos the frame is
chosen whose largest motion over the cameras is smallest, so that motion blur, rolling shutter and
synchronisation errors of a few milliseconds do not matter.
"""

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
from palpate.vision import VIDEO_SUFFIXES, read_grey, video_frames

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp")
# A pose has six unknowns and a mark gives two equations: four are a safe minimum, eight a check.
_MIN_MARKS = 8
# A picture counts as blurred if its edges are this many times wider than its camera's median.
_BLURRED = 2.0
# Quantile of the slopes taken as that of an edge, and the number of pixels sampled.
_STEEPEST, _SAMPLES = 0.998, 200_000
# A picture: its camera, its instant, its file.
_Job = tuple[str, str, Path]
# Maximum number of sections, and minimum number of frames in each.
_MAX_SECTIONS, _MIN_FRAMES = 60, 5
# Width to which frames are reduced for comparison [px].
_SMALL = 160
# Largest difference in length, as a fraction; videos with one trigger differ by a frame or two.
_MAX_EXTRA = 0.02
# A view is new if the board has moved by more than this fraction of the picture's width.
_NEWS = 0.015


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


def find_pictures(root: Path) -> dict[str, dict[str, Path]]:
    """List the calibration pictures of every camera by the names of their instants.

    Pictures of one instant have the same file name, ignoring the camera's name within it.

    Parameters
    ----------
    root : Path                     folder with one folder per camera; or with one camera's pictures

    Returns
    -------
    dict of camera to dict of instant to Path   both sorted; a camera whose folder has no pictures
                                    has none, which `find_boards` notes

    Raises
    ------
    RecordError                     there is no such folder, or there are no pictures in it
    """
    if not root.is_dir():
        raise RecordError(f"{root}: no such folder; give one that has a folder for every camera")
    folders = [path for path in sorted(root.iterdir()) if path.is_dir()]
    by_instant: dict[str, dict[str, Path]] = {}
    for folder in folders or [root]:
        files = sorted(folder.iterdir())
        pictures = [path for path in files if path.suffix.lower() in PICTURE_SUFFIXES]
        # An empty hidden folder is some program's, not a camera's.
        if pictures or not folder.name.startswith("."):
            by_instant[folder.name] = {_instant(path.stem, folder.name): path for path in pictures}
    if not any(by_instant.values()):
        raise RecordError(
            f"{root}: has no pictures ({', '.join(PICTURE_SUFFIXES)}), neither itself nor in the"
            " folders within it; expected is a folder for every camera"
        )
    return by_instant


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
    jobs = [(c, name, path) for c, files in pictures.items() for name, path in files.items()]

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
    sightings = gathered([name for name, files in pictures.items() if files], sizes, sharp, targets)
    return replace(
        sightings, notes=(*_without_pictures(pictures), *blurred.values(), *sightings.notes)
    )


def _without_pictures(pictures: Mapping[str, Mapping[str, Path]]) -> list[str]:
    """Notes on cameras whose folders have no pictures."""
    return [
        f"camera '{camera}': its folder has no pictures ({', '.join(PICTURE_SUFFIXES)}); the camera"
        " is left out: were they copied, and are they of one of these kinds?"
        for camera, files in pictures.items()
        if not files
    ]


def _edge_width(grey: UInt8[np.ndarray, "rows columns"], seen: Sequence[Sighting]) -> float:
    """Width of edges between dark and bright, in the direction where they are widest [px].

    It is contrast over steepest slope, within the boards or, if none is found, in the whole
    picture. All directions are tested, since motion blur leaves edges along the motion sharp. The
    picture is smoothed first, against noise, so that no edge is narrower than 2.5 px.
    """
    pixel = np.concatenate([sighting.pixel for sighting in seen])
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
    usual = {camera: float(np.median(edge_widths)) for camera, edge_widths in of_camera.items()}
    blurred = {}
    for k, ((camera, _, path), boards, width) in enumerate(zip(jobs, seen, widths, strict=True)):
        if width <= _BLURRED * usual[camera]:
            continue
        # Without a board found there may be none: such a picture may have no sharp edges either.
        what = (
            "blurred"
            if any(len(sighting.mark) for sighting in boards)
            else "no board found, or blurred"
        )
        blurred[k] = (
            f"{path}: {what}: its edges are {width:.1f} px wide and those of '{camera}' usually"
            f" {usual[camera]:.1f}; left out: did the board move?"
        )
    return blurred


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
    size_of: dict[str, tuple[int, int]] = {}
    for (camera, _, path), size in zip(jobs, sizes, strict=True):
        if size_of.setdefault(camera, size) != size:
            raise CalibrationError(
                f"{path}: has {size[0]} x {size[1]} pixels, pictures of camera '{camera}' before it"
                f" {size_of[camera][0]} x {size_of[camera][1]}; a calibration holds for one size"
            )
    return size_of


def gathered(
    cameras: list[str],
    sizes: Mapping[str, tuple[int, int]],
    pictures: Sequence[tuple[str, str, Path, list[Sighting]]],
    targets: Sequence[Target],
) -> Sightings:
    """Collect all marks in one list, with notes on pictures that have too few.

    Parameters
    ----------
    cameras : list of str           names
    sizes : mapping of camera to (columns, rows) [px]
    pictures : sequence of (camera, instant, file, sightings)   a sighting for each target
    targets : sequence of Target

    Returns
    -------
    Sightings

    Raises
    ------
    CalibrationError                no board was found
    """
    views: dict[tuple[str, int], int] = {}
    parts, notes = [], []
    for camera, instant, path, boards in pictures:
        count = max((len(board.mark) for board in boards), default=0)
        if count < _MIN_MARKS:
            what = f"{count} marks of a board" if count else "no board"
            notes.append(f"{path}: {what} found; left out")
        for k, board in enumerate(boards):
            if len(board.mark) < _MIN_MARKS:
                continue
            view = views.setdefault((instant, k), len(views))
            numbers = np.tile([cameras.index(camera), view], (len(board.mark), 1))
            parts.append((numbers, targets[k].points[board.mark], board.pixel, board.mark))
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


def find_videos(root: Path) -> dict[str, Path]:
    """List the videos of boards, one per camera.

    Parameters
    ----------
    root : Path                     folder of videos named after the cameras, or with a folder for
                                    every camera that contains its video

    Returns
    -------
    dict of camera to Path          sorted; empty if the folder has no videos

    Raises
    ------
    RecordError                     there is no such folder, or a camera has several videos
    """
    if not root.is_dir():
        raise RecordError(f"{root}: no such folder; give one that has a folder for every camera")
    videos: dict[str, Path] = {}
    for path in sorted([*root.iterdir(), *root.glob("*/*")]):
        if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file():
            camera = path.stem if path.parent == root else path.parent.name
            if camera in videos:
                raise RecordError(
                    f"{path}: is a second video of camera '{camera}', beside {videos[camera].name};"
                    " give one video a camera"
                )
            videos[camera] = path
    return videos


def still_frames(
    videos: Mapping[str, Path], folder: Path, *, progress: Progress = silent
) -> dict[str, dict[str, Path]]:
    """Extract the frames with the least motion from videos and write them as pictures.

    Parameters
    ----------
    videos : mapping of camera to Path
    folder : Path                   where a folder is made for every camera
    progress : callable

    Returns
    -------
    dict of camera to dict of instant to Path   pictures; the instant is named by its frame number

    Raises
    ------
    RecordError                     a video cannot be decoded, or a picture not written
    CalibrationError                the videos differ in length
    """
    motion = {}
    for k, (camera, video) in enumerate(videos.items()):
        progress(f"video of {camera}", 0.5 * k / len(videos))
        motion[camera] = _motion(video)
    _check_lengths(videos, {camera: len(amounts) for camera, amounts in motion.items()})
    count = min(len(amounts) for amounts in motion.values())
    largest = np.max(
        [amounts[:count] / max(np.median(amounts), 1e-9) for amounts in motion.values()], axis=0
    )
    sections = min(_MAX_SECTIONS, max(count // _MIN_FRAMES, 1))
    chosen = [
        int(part[largest[part].argmin()]) for part in np.array_split(np.arange(count), sections)
    ]
    files: dict[str, dict[str, Path]] = {}
    for k, (camera, video) in enumerate(videos.items()):
        progress(f"frames of {camera}", 0.5 + 0.5 * k / len(videos))
        files[camera] = _written(video, chosen, folder / camera)
    return files


def _name(number: int) -> str:
    return f"{number:06d}"


def _motion(video: Path) -> Float[np.ndarray, " n"]:
    """Mean absolute change of grey levels from the previous frame; the first repeats the second."""
    before, change = None, []
    for _, grey in video_frames(video):
        scale = _SMALL / grey.shape[1]
        size = (_SMALL, max(round(scale * grey.shape[0]), 1))
        small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        if before is not None:
            change.append(float(np.abs(small - before).mean()))
        before = small
    return np.array([change[0], *change])


def _check_lengths(videos: Mapping[str, Path], counts: Mapping[str, int]) -> None:
    low, high = min(counts, key=counts.__getitem__), max(counts, key=counts.__getitem__)
    if counts[high] - counts[low] > max(2, _MAX_EXTRA * counts[high]):
        raise CalibrationError(
            f"{videos[low]} has {counts[low]} frames and {videos[high]} {counts[high]}; frames of"
            " one number must be of one instant: start the cameras by one trigger and let none drop"
            " frames, cut the videos to the same begin, or take pictures"
        )


def _written(video: Path, chosen: list[int], folder: Path) -> dict[str, Path]:
    """Write the chosen frames of a video as pictures."""
    folder.mkdir(parents=True)
    wanted, files = set(chosen), {}
    for number, (_, grey) in enumerate(video_frames(video)):
        if number in wanted:
            files[_name(number)] = folder / f"{_name(number)}.png"
            if not cv2.imwrite(str(files[_name(number)]), grey):
                raise RecordError(f"{folder}: no picture can be written there; check the space")
    return files


def without_repeats(sightings: Sightings, *, news: float = _NEWS) -> Sightings:
    """Drop views in which the board is where it was in an earlier one.

    Otherwise a board that is held still for long would be counted many times.

    Parameters
    ----------
    sightings : Sightings
    news : float                    a board that moved by more is at another place, over the width
                                    of the pictures

    Returns
    -------
    Sightings                       with a note on how many were dropped
    """
    corners, keep = sightings.corners, []
    earlier: list[dict[tuple[int, int], np.ndarray]] = []
    for v in range(len(sightings.views)):
        rows = np.flatnonzero(corners.view == v)
        seen = {
            (int(corners.camera[r]), int(sightings.mark[r])): corners.pixel[r]
            for r in rows.tolist()
        }
        if not any(_same(seen, other, sightings.sizes, news) for other in earlier):
            keep.append(v)
            earlier.append(seen)
    dropped = len(sightings.views) - len(keep)
    if dropped == 0:
        return sightings
    stays = np.isin(np.arange(len(sightings.views)), keep)
    rows = stays[corners.view]
    number = np.cumsum(stays) - 1
    remaining = corners.chosen(rows)
    note = f"{dropped} of {len(sightings.views)} frames show the board where another does; left out"
    return replace(
        sightings,
        views=tuple(sightings.views[v] for v in keep),
        targets=tuple(sightings.targets[v] for v in keep),
        corners=replace(remaining, view=number[remaining.view]),
        mark=sightings.mark[rows],
        notes=(*sightings.notes, note),
    )


def _same(
    first: Mapping[tuple[int, int], np.ndarray],
    second: Mapping[tuple[int, int], np.ndarray],
    sizes: tuple[tuple[int, int], ...],
    news: float,
) -> bool:
    """Whether two views show a board at the same place, by the median motion of common marks."""
    common = first.keys() & second.keys()
    if 2 * len(common) < max(len(first), len(second)):
        return False
    motion = [np.linalg.norm(first[key] - second[key]) / sizes[key[0]][0] for key in common]
    return bool(np.median(motion) < news)
