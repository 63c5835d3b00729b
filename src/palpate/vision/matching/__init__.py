"""Windows of one picture found in another, and smooth fields through scattered displacements.

Purpose    : the motion of every pixel without an initial guess (dense and sparse flow); the motion
             of a window to a hundredth of a pixel; predictions from neighbouring displacements.
Takes      : grey pictures, prepared by `images`; displacements of scattered points.
Gives      : `dense_start`, `refine_planar`, `local_field`, `noise_correlation`, `predicted`, and
             the window kernels.
Depends on : `vision.images`, `vision.small_systems`, `records`.
Read first : `window_sums.py`, then `planar_match.py`, then `dense_flow.py`.
"""

from palpate.vision.matching.dense_flow import dense_start as dense_start
from palpate.vision.matching.fit_operators import (
    LocalFits as LocalFits,
    coefficient_operators as coefficient_operators,
    local_fits as local_fits,
    local_terms as local_terms,
    sum_over_points as sum_over_points,
)
from palpate.vision.matching.local_regression import (
    LocalField as LocalField,
    local_field as local_field,
)
from palpate.vision.matching.noise_correlation import noise_correlation as noise_correlation
from palpate.vision.matching.outliers import (
    Prediction as Prediction,
    median_around as median_around,
    median_test as median_test,
    neighbours_median as neighbours_median,
    predicted as predicted,
)
from palpate.vision.matching.planar_match import (
    PlanarMatch as PlanarMatch,
    refine_planar as refine_planar,
)
from palpate.vision.matching.scatter import Scatter as Scatter, sum_variance as sum_variance
from palpate.vision.matching.window_sums import (
    BASES as BASES,
    load_window_kernel as load_window_kernel,
    window_advance_kernel as window_advance_kernel,
    window_blocks_kernel as window_blocks_kernel,
    window_residual_kernel as window_residual_kernel,
    window_right_kernel as window_right_kernel,
    window_system_kernel as window_system_kernel,
)
