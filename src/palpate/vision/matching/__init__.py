"""matching."""

from palpate.vision.matching.dense_flow import dense_start as dense_start
from palpate.vision.matching.local_regression import (
    LocalField as LocalField,
    Scatter as Scatter,
    local_field as local_field,
)
from palpate.vision.matching.outliers import median_around as median_around, predicted as predicted
from palpate.vision.matching.planar_match import (
    PlanarMatch as PlanarMatch,
    PlanarSettings as PlanarSettings,
    refine_planar as refine_planar,
)
from palpate.vision.matching.window_sums import (
    load_window_kernel as load_window_kernel,
    window_blocks_kernel as window_blocks_kernel,
    window_hessian_kernel as window_hessian_kernel,
    window_right_kernel as window_right_kernel,
    window_side_sums_kernel as window_side_sums_kernel,
)
