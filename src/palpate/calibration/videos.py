"""Pictures of boards out of videos: frames in which the board is held still.

Frames of one number are of one instant. Of every stretch of the videos the frame is taken in which
least moves in the camera where most does, so that neither blur nor a shutter that rolls nor a few
milliseconds between the cameras matter.
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

# At most so many stretches, each of so many frames at least.
_STRETCHES, _FEWEST_FRAMES = 60, 5
# Width that frames are shrunk to before they are compared [px].
_SMALL = 160
# Videos of one trigger differ by a frame or two at their ends.
_MAX_EXTRA = 0.02
# A board that no camera sees this far from where it was says nothing new [share of the width].
_NEWS = 0.015


def find_videos(place: Path) -> dict[str, Path]:
    """Videos of boards, one a camera.

    Parameters
    ----------
    place : Path                    folder of videos named like the cameras, or with a folder for
                                    every camera that has its video

    Returns
    -------
    dict of camera to Path          sorted; none where the folder has no videos

    Raises
    ------
    RecordError                     no folder; a camera with several videos
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
    """Take the stillest frames out of videos and write them as pictures.

    Parameters
    ----------
    videos : mapping of camera to Path
    folder : Path                   where a folder of every camera is made
    progress : callable

    Returns
    -------
    dict of camera to dict of instant to Path   pictures, the number of the frame is the name of the
                                    instant

    Raises
    ------
    RecordError                     a video that cannot be decoded
    CalibrationError                videos of different length
    """
    motion = {}
    for k, (camera, video) in enumerate(videos.items()):
        progress(f"video of {camera}", 0.5 * k / len(videos))
        motion[camera] = _motion(video)
    _check_lengths(videos, {camera: len(one) for camera, one in motion.items()})
    count = min(len(one) for one in motion.values())
    most = np.max([one[:count] / max(np.median(one), 1e-9) for one in motion.values()], axis=0)
    stretches = min(_STRETCHES, max(count // _FEWEST_FRAMES, 1))
    chosen = [
        int(part[most[part].argmin()]) for part in np.array_split(np.arange(count), stretches)
    ]
    files: dict[str, dict[str, Path]] = {}
    for k, (camera, video) in enumerate(videos.items()):
        progress(f"frames of {camera}", 0.5 + 0.5 * k / len(videos))
        files[camera] = _written(video, chosen, folder / camera)
    return files


def _name(number: int) -> str:
    return f"{number:06d}"


def _motion(video: Path) -> Float[np.ndarray, " n"]:
    """Mean change of grey levels of every frame to the one before; the first's is the second's."""
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
    """Chosen frames of a video as pictures."""
    folder.mkdir(parents=True)
    wanted, files = set(chosen), {}
    for number, (_, grey) in enumerate(video_frames(video)):
        if number in wanted:
            files[_name(number)] = folder / f"{_name(number)}.png"
            if not cv2.imwrite(str(files[_name(number)]), grey):
                raise RecordError(f"{folder}: no picture can be written there; check the space")
    return files


def without_repeats(found: Sightings) -> Sightings:
    """Sightings without views in which the board is where an earlier one has it.

    A board that was held still for long would count as often as it was filmed.

    Parameters
    ----------
    found : Sightings

    Returns
    -------
    Sightings                       with a note of how many went
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
    gone = len(found.views) - len(keep)
    if gone == 0:
        return found
    stays = np.isin(np.arange(len(found.views)), keep)
    rows = stays[corners.view]
    number = np.cumsum(stays) - 1
    left = corners.chosen(rows)
    note = f"{gone} of {len(found.views)} frames show the board where another does; left out"
    return replace(
        found,
        views=tuple(found.views[v] for v in keep),
        targets=tuple(found.targets[v] for v in keep),
        corners=replace(left, view=number[left.view]),
        mark=found.mark[rows],
        notes=(*found.notes, note),
    )


def _same(
    first: Mapping[tuple[int, int], np.ndarray],
    second: Mapping[tuple[int, int], np.ndarray],
    sizes: tuple[tuple[int, int], ...],
) -> bool:
    """Whether a board lies in both views at the same place in every camera."""
    common = first.keys() & second.keys()
    if 2 * len(common) < max(len(first), len(second)):
        return False
    away = [np.linalg.norm(first[key] - second[key]) / sizes[key[0]][0] for key in common]
    return bool(np.median(away) < _NEWS)
