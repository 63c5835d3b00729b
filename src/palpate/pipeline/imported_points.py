"""Plausibility checks and triangulation of displacements measured by another program."""

from palpate.errors import CalibrationError
from palpate.records import MeasuredPoints, PictureTracks, ProgramPoints, Rig, measured_rows
from palpate.vision import median_test, triangulate

# A displacement is an outlier if it differs from its neighbours by more than so many times their
# own scatter (see `median_test`); for normal errors, ten standard deviations.
_MAX_DIFFERENCE = 4.0


def without_contradicted(measured: MeasuredPoints) -> MeasuredPoints:
    """The points without those whose displacements contradict their neighbours.

    Parameters
    ----------
    measured : MeasuredPoints

    Returns
    -------
    MeasuredPoints                  outliers are rows of NaN, and counted
    """
    valid = measured_rows(measured.displacement)
    ratio = median_test(measured.points, measured.displacement, valid)
    return measured.without(ratio > _MAX_DIFFERENCE)


def triangulated(tracks: PictureTracks, rig: Rig) -> ProgramPoints:
    """Triangulate matches in pictures.

    Parameters
    ----------
    tracks : PictureTracks
    rig : Rig                       with the cameras of the tracks, by name; or the same number

    Returns
    -------
    ProgramPoints                   in metres, in the frame of the rig

    Raises
    ------
    CalibrationError                the rig has neither those cameras nor the same number
    """
    names = [camera.name for camera in rig.cameras]
    if set(tracks.cameras) <= set(names) and len(tracks.cameras) == len(tracks.rest):
        chosen = [names.index(name) for name in tracks.cameras]
    elif len(names) == len(tracks.rest):
        chosen = list(range(len(names)))
    else:
        raise CalibrationError(
            f"{rig.source}: has the cameras {', '.join(names)}; must have the {len(tracks.rest)} of"
            f" the matches ({', '.join(tracks.cameras) or 'of any name'})"
        )
    pair = Rig(tuple(rig.cameras[i] for i in chosen), 0, rig.source)
    # Equal pixel noise for all matches; its size does not affect the points.
    rest, loaded = (triangulate(pair, pixels, 1.0).point for pixels in (tracks.rest, tracks.loaded))
    return ProgramPoints(rest, loaded - rest, unit="m", notes=tracks.notes, score=tracks.score)
