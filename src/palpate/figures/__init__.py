"""figures."""

from palpate.figures.displacement import displacement_figure as displacement_figure
from palpate.figures.estimate import (
    BLUE as BLUE,
    GREY as GREY,
    INK as INK,
    ORANGE as ORANGE,
    STYLE as STYLE,
    probings_figure as probings_figure,
    write_plots as write_plots,
)
from palpate.figures.flow import (
    flow_figure as flow_figure,
    write_flow_pictures as write_flow_pictures,
)
from palpate.figures.flow_view import make_flow_view as make_flow_view
