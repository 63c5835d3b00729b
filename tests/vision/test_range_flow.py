"""Range flow between its points."""

import numpy as np

from palpate.vision.range_flow import Outcome, RangeFlow, dense_maps


def _flow(rejected: int | None = None) -> RangeFlow:
    """A displacement that is linear in the pixel, at points every 4 px."""
    column, row = np.meshgrid(np.arange(6, 40, 4), np.arange(10, 30, 4))
    pixel = np.stack([column.ravel(), row.ravel()], axis=1).astype(float)
    n = len(pixel)
    displacement = np.stack([pixel[:, 0], 2.0 * pixel[:, 1], pixel @ [1.0, -1.0]], axis=1)
    outcome = np.zeros(n, dtype=np.int64)
    if rejected is not None:
        outcome[rejected] = Outcome.SCORE
        displacement[rejected] = np.nan
    covariance = np.broadcast_to(np.eye(3) / 3.0, (n, 3, 3)).copy()
    return RangeFlow(
        pixel=pixel,
        point=np.zeros((n, 3)),
        tangent=np.zeros((n, 2, 3)),
        displacement=displacement,
        gradient=np.zeros((n, 2, 3)),
        covariance=covariance,
        bias=0.0 * covariance,
        score=np.ones(n),
        reprojection=np.zeros(n),
        cameras=np.full(n, 2),
        outcome=outcome,
        through_last=np.zeros(n, dtype=bool),
        drift=np.nan,
        noise=np.ones(2),
        subset=21,
        step=4,
        shape=(36, 44),
    )


def test_a_linear_field_is_exact_at_every_pixel() -> None:
    displacement, sigma = dense_maps(_flow())
    row, column = np.nonzero(np.isfinite(sigma))
    assert (column.min(), column.max(), row.min(), row.max()) == (6, 38, 10, 26)
    truth = np.stack([column, 2.0 * row, column - row], axis=1)
    # Single precision of numbers up to 50.
    assert np.allclose(displacement[row, column], truth, atol=1e-5)
    assert np.allclose(sigma[row, column], 1.0, atol=1e-6)


def test_a_rejected_point_leaves_a_hole_and_no_guess() -> None:
    _, whole = dense_maps(_flow())
    _, holed = dense_maps(_flow(rejected=13))
    x, y = _flow().pixel[13].astype(int)
    missing = np.isfinite(whole) & np.isnan(holed)
    rows, columns = np.nonzero(missing)
    assert missing[y, x]
    assert np.abs(columns - x).max() < 4
    assert np.abs(rows - y).max() < 4


def test_nothing_valid_gives_empty_maps() -> None:
    flow = _flow()
    flow.outcome[:] = Outcome.LOST
    displacement, sigma = dense_maps(flow)
    assert np.isnan(displacement).all()
    assert np.isnan(sigma).all()
