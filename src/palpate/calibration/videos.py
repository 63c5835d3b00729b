"""Pictures of boards from videos: frames in which the board is held still.

Frames of the same number show the same instant. From every section of the videos the frame is
chosen whose largest motion over the cameras is smallest, so that motion blur, rolling shutter and
synchronisation errors of a few milliseconds do not matter.
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float

from palpate.calibration.sightings import Sightings
from palpate.errors import CalibrationError, RecordError
from palpate.progress import Progress, silent
from palpate.vision import VIDEO_SUFFIXES, video_frames

# Maximum number of sections, and minimum number of frames in each.
_MAX_SECTIONS, _MIN_FRAMES = 60, 5
# Width to which frames are reduced for comparison [px].
_SMALL = 160
# Largest difference in length, as a fraction; videos with one trigger differ by a frame or two.
_MAX_EXTRA = 0.02
# A view is new if the board has moved by more than this fraction of the picture's width.
_NEWS = 0.015


def find_videos(place: Path) -> dict[str, Path]:
    """List the videos of boards, one per camera.

    Parameters
    ----------
    place : Path                    folder of videos named after the cameras, or with a folder for
                                    every camera that contains its video

    Returns
    -------
    dict of camera to Path          sorted; empty if the folder has no videos

    Raises
    ------
    RecordError                     there is no such folder, or a camera has several videos
    """
    if not place.is_dir():
        raise RecordError(f"{place}: no such folder; give one that has a folder for every camera")
    found: dict[str, Path] = {}
    for path in sorted([*place.iterdir(), *place.glob("*/*")]):
        if path.suffix.lower() in VIDEO_SUFFIXES and path.is_file():
            camera = path.stem if path.parent == place else path.parent.name
            if camera in found:
                raise RecordError(
                    f"{path}: is a second video of camera '{camera}', beside {found[camera].name};"
                    " give one video a camera"
                )
            found[camera] = path
    return found


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
    _check_lengths(videos, {camera: len(one) for camera, one in motion.items()})
    count = min(len(one) for one in motion.values())
    largest = np.max([one[:count] / max(np.median(one), 1e-9) for one in motion.values()], axis=0)
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


def without_repeats(found: Sightings) -> Sightings:
    """Drop views in which the board is where it was in an earlier one.

    Otherwise a board that is held still for long would be counted many times.

    Parameters
    ----------
    found : Sightings

    Returns
    -------
    Sightings                       with a note on how many were dropped
    """
    corners, keep = found.corners, []
    kept: list[dict[tuple[int, int], np.ndarray]] = []
    for v in range(len(found.views)):
        rows = np.flatnonzero(corners.view == v)
        seen = {
            (int(corners.camera[r]), int(found.mark[r])): corners.pixel[r] for r in rows.tolist()
        }
        if not any(_same(seen, other, found.sizes) for other in kept):
            keep.append(v)
            kept.append(seen)
    dropped = len(found.views) - len(keep)
    if dropped == 0:
        return found
    stays = np.isin(np.arange(len(found.views)), keep)
    rows = stays[corners.view]
    number = np.cumsum(stays) - 1
    remaining = corners.chosen(rows)
    note = f"{dropped} of {len(found.views)} frames show the board where another does; left out"
    return replace(
        found,
        views=tuple(found.views[v] for v in keep),
        targets=tuple(found.targets[v] for v in keep),
        corners=replace(remaining, view=number[remaining.view]),
        mark=found.mark[rows],
        notes=(*found.notes, note),
    )


def _same(
    first: Mapping[tuple[int, int], np.ndarray],
    second: Mapping[tuple[int, int], np.ndarray],
    sizes: tuple[tuple[int, int], ...],
) -> bool:
    """Whether two views show a board at the same place, by the median motion of common marks."""
    common = first.keys() & second.keys()
    if 2 * len(common) < max(len(first), len(second)):
        return False
    motion = [np.linalg.norm(first[key] - second[key]) / sizes[key[0]][0] for key in common]
    return bool(np.median(motion) < _NEWS)
