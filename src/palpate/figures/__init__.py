"""Figures: of estimates, displacements, measured motions, calibrations and surfaces.

Purpose    : draw results with matplotlib in one style; compute only what a figure needs.
Takes      : `Session`, `FitResult`, `RangeFlow`, `VertexDisplacement`, `Recorded`.
Gives      : matplotlib figures, PNG files, pixels.
Depends on : `pipeline`, `calibration`, `scanning`, `recording`, `vision`, `estimation`, `probe`,
             `relaxation`, `records`, `geometry`.
Read first : `style.py`, then `estimate.py` and `flow.py`.
"""

from palpate.figures.calibration import (
    board_figure as board_figure,
    drawn_edges as drawn_edges,
    object_figure as object_figure,
    recording_figure as recording_figure,
    residual_figure as residual_figure,
    rig_figure as rig_figure,
    save_page as save_page,
)
from palpate.figures.compression import compression_figure as compression_figure
from palpate.figures.displacement import (
    HELD as HELD,
    LENGTHS as LENGTHS,
    MOST_SIGMAS as MOST_SIGMAS,
    OUTLIER_WEIGHT as OUTLIER_WEIGHT,
    RESIDUALS as RESIDUALS,
    best_direction as best_direction,
    displacement_figure as displacement_figure,
    make_view as make_view,
    projected as projected,
    rms_of_known as rms_of_known,
)
from palpate.figures.estimate import (
    budget_figure as budget_figure,
    errors_figure as errors_figure,
    likelihood_figure as likelihood_figure,
    modulus_map_figure as modulus_map_figure,
    predictions_figure as predictions_figure,
    probings_figure as probings_figure,
    refined_likelihood as refined_likelihood,
    write_plots as write_plots,
)
from palpate.figures.flow import (
    flow_figure as flow_figure,
    make_flow_view as make_flow_view,
    write_flow_pictures as write_flow_pictures,
)
from palpate.figures.modulus import (
    MODULI as MODULI,
    half_way as half_way,
    modulus_span as modulus_span,
)
from palpate.figures.style import (
    BLUE as BLUE,
    GREY as GREY,
    INK as INK,
    MIDDLE_BLUE as MIDDLE_BLUE,
    ORANGE as ORANGE,
    PALE_BLUE as PALE_BLUE,
    Picture as Picture,
    figure_pixels as figure_pixels,
    open_frame as open_frame,
    save_drawing as save_drawing,
    save_figure as save_figure,
    save_pixels as save_pixels,
    styled as styled,
)
from palpate.figures.surface import (
    next_probings_figure as next_probings_figure,
    scan_figure as scan_figure,
    surface_figure as surface_figure,
)
