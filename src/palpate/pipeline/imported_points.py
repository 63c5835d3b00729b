"""What may be believed of displacements that another program measured."""

from palpate.records import MeasuredPoints, measured_rows
from palpate.vision import median_test

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
