"""Figure of compression tests: what was recorded, and the lines whose slopes are the moduli."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from palpate.figures.style import BLUE, GREY, ORANGE, open_frame, styled
from palpate.probe import CompressionRecord, CompressionResult
from palpate.records import modulus_unit

# Largest strain drawn, over the largest that was fitted.
_SHOWN = 2.0


@styled
def compression_figure(
    records: Sequence[CompressionRecord], results: Sequence[CompressionResult]
) -> Figure:
    """Stress against strain of every record, up to twice the range of its straight line.

    Parameters
    ----------
    records : sequence of CompressionRecord
    results : sequence of CompressionResult     of these records

    Returns
    -------
    Figure                          4.6 by 3.6 inches; strain in per cent
    """
    figure = Figure(figsize=(4.6, 3.6))
    axes = figure.add_axes((0.15, 0.14, 0.81, 0.74))
    pairs = list(zip(records, results, strict=True))
    factor, unit = modulus_unit(max(made.young_modulus * made.strain_range[1] for made in results))
    for record, result in pairs:
        strain, stress = record.displacement / result.height, record.force / result.area
        shown = strain <= _SHOWN * result.strain_range[1]
        axes.plot(100.0 * strain[shown], stress[shown] / factor, color=BLUE, linewidth=1.0)
        ends = np.array(result.strain_range)
        line = (result.intercept + result.young_modulus * ends) / factor
        axes.plot(100.0 * ends, line, color=ORANGE, linewidth=1.6)
    low, high = 100.0 * np.array(results[0].strain_range)
    axes.axvspan(low, high, color=GREY, alpha=0.12, linewidth=0, zorder=-1)
    axes.set(xlabel="strain (%)", ylabel=f"stress ({unit})")
    recorded, fitted, *_ = axes.lines
    names = {"recorded": recorded, f"line, {low:g} to {high:g} %": fitted}
    figure.legend(names.values(), names.keys(), loc="upper center", ncols=2)
    open_frame(axes)
    return figure
