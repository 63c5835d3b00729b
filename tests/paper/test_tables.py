"""Tables 1 and 2: units, what stands beside what, and the figures of the summaries."""

import numpy as np
import pytest

from palpate.paper.published import FlowRow, Spread, VertexRow
from palpate.paper.tables import PAPER, flow_summary, flow_table, vertex_summary, vertex_table


def flow(step, *, off=0.0, std=1e-3, encoder_off=0.0, points=7):
    """A step of 2.5 mm that is measured too long by `off`; sigma of the angle: 8 degrees / step."""
    way = 2.5e-3 * step
    angle = Spread(np.radians(60.0), np.radians(8.0) / step)
    return FlowRow(step, angle, Spread(way + off, std), way + encoder_off, way, points)


def direction(step, error, *, length=None):
    return VertexRow(
        step, Spread(np.radians(error), np.radians(2 * error)),
        None if length is None else Spread(length, 0.5 * length), length,
    )  # fmt: skip


def test_steps_are_grouped_and_in_the_units_of_the_head():
    rows = {PAPER: (flow(1, points=None), flow(2, points=None)), "joint": (flow(1), flow(2))}
    table = flow_table("t", rows)
    assert [(row[0], row[1]) for row in table.rows] == [
        (1, PAPER), (1, "joint"), (2, PAPER), (2, "joint"),
    ]  # fmt: skip
    assert table.columns[2:8] == (
        "angle (deg)", "sigma (deg)", "length (mm)", "sigma (mm)", "encoder (mm)", "command (mm)",
    )  # fmt: skip
    assert table.rows[2][2:8] == pytest.approx((60.0, 4.0, 5.0, 1.0, 5.0, 5.0))
    assert [row[8] for row in table.rows] == [None, 7, None, 7]


def test_the_worst_step_is_found_whichever_its_sign():
    rows = (flow(1, off=1e-4), flow(2, off=-3e-4, std=5e-3), flow(3, off=2e-4))
    table = flow_summary("t", {"x": {"joint": rows}})
    assert table.rows[0][:2] == ("x", "joint")
    assert table.rows[0][2:] == pytest.approx((-0.3, 5.0, 8.0, 3))


def test_the_paper_is_compared_with_its_encoder_others_with_the_true_way():
    rows = (flow(1, off=1e-4, encoder_off=-2e-4),)
    table = flow_summary("t", {"x": {PAPER: rows, "joint": rows}})
    assert [row[2] for row in table.rows] == pytest.approx([0.3, 0.1])


def test_a_step_without_points_is_not_hidden():
    lost = FlowRow(2, Spread(np.nan, np.nan), Spread(np.nan, np.nan), 5e-3, 5e-3, 0)
    table = flow_summary("t", {"x": {"joint": (flow(1, off=1e-3), lost, flow(3))}})
    assert np.isnan(table.rows[0][2])
    assert np.isnan(table.rows[0][3])


def test_directions_have_lengths_only_where_they_are_told():
    table = vertex_table(
        "t", {PAPER: (direction(1, 10.0),), "joint": (direction(1, 1.0, length=4e-3),)}
    )
    assert table.rows[0][2:4] == pytest.approx((10.0, 20.0))
    assert table.rows[0][4:] == (None, None, None, None)
    assert table.rows[1][2:7] == pytest.approx((1.0, 2.0, 4.0, 2.0, 4.0))


def test_the_summary_of_directions_has_the_first_and_the_last_step():
    rows = (direction(1, 9.0), direction(2, 30.0), direction(3, 3.0))
    table = vertex_summary("t", {"y": {"lang-pai": rows}})
    assert table.rows[0][:2] == ("y", "lang-pai")
    assert table.rows[0][2:] == pytest.approx((9.0, 18.0, 3.0, 6.0, 3))
