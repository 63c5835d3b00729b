"""What may be believed of displacements that another program measured."""

from palpate.errors import CalibrationError
from palpate.records import MeasuredPoints, PictureTracks, ProgramPoints, Rig, measured_rows
from palpate.vision import median_test, triangulate

# A displacement is a mistake where it differs from those around by more than so many times what
# these differ by (see `median_test`): of normal errors, ten standard deviations.
_MAX_DIFFERENCE = 4.0


def without_contradicted(measured: MeasuredPoints) -> MeasuredPoints:
    """The points without those whose motion contradicts all around them.

    Parameters
    ----------
    measured : MeasuredPoints

    Returns
    -------
    MeasuredPoints                  contradicted ones are rows of NaN, and counted
    """
    valid = measured_rows(measured.displacement)
    ratio = median_test(measured.points, measured.displacement, valid)
    return measured.without(ratio > _MAX_DIFFERENCE)


def triangulated(tracks: PictureTracks, rig: Rig) -> ProgramPoints:
    """Matches in pictures, brought into space.

    Parameters
    ----------
    tracks : PictureTracks
    rig : Rig                       with the cameras of the tracks, by name; or just as many

    Returns
    -------
    ProgramPoints                   in metres, in the frame of the rig

    Raises
    ------
    CalibrationError                the rig has neither those cameras nor as many
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
    # All pixels are known alike; how well does not matter for the points.
    rest, loaded = (triangulate(pair, pixels, 1.0).point for pixels in (tracks.rest, tracks.loaded))
    return ProgramPoints(rest, loaded - rest, unit="m", notes=tracks.notes, score=tracks.score)
