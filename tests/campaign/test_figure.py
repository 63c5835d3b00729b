"""What the picture of a campaign shows is what its table says."""

import numpy as np
import pytest

from palpate.campaign.rows import DONE, FAILED, Row, campaign_figure


def row(name, young, half, *, group="", ratio=0.4):
    """A session that was fitted: E [Pa] with the half width of its interval."""
    return Row(
        name, group, DONE, young_modulus=young, young_modulus_low=young - half,
        young_modulus_high=young + 2 * half, poisson_ratio=ratio, poisson_ratio_low=ratio - 0.01,
        poisson_ratio_high=ratio + 0.02,
    )  # fmt: skip


ROWS = [
    row("a/1", 50e3, 1e3, group="a"),
    row("b/1", 70e3, 3e3, group="b"),
    row("a/2", 52e3, 2e3, group="a", ratio=0.3),
    row("b/2", 71e3, 3e3, group="b"),
    row("b/3", 78e3, 3e3, group="b"),
    Row("b/4", "b", FAILED, message="no force"),
]


@pytest.fixture
def panels():
    """E and nu over the sessions, group by group: a/1, a/2, b/1, b/2, b/3, b/4."""
    return campaign_figure(ROWS, "fruit").axes


def test_points_and_intervals_are_those_of_the_rows(panels):
    wanted = (
        ([50, 52, 70, 71, 78], [1, 2, 3, 3, 3]),
        ([0.4, 0.3, 0.4, 0.4, 0.4], [0.01] * 5),
    )
    for axes, (values, halves) in zip(panels, wanted, strict=True):
        (bars,) = axes.containers
        points, _, (spans,) = bars.lines
        assert list(points.get_xdata()) == list(range(5))
        np.testing.assert_allclose(points.get_ydata(), values)
        ends = np.array([span[:, 1] for span in spans.get_segments()]).T
        np.testing.assert_allclose(ends[0], np.subtract(values, halves))
        np.testing.assert_allclose(ends[1], np.add(values, np.multiply(2, halves)))
    assert panels[0].get_ylabel() == "Young's modulus E / kPa"


def test_groups_have_their_names_medians_and_failures(panels):
    upper, lower = panels
    names = {text.get_text(): text.xy[0] for text in upper.texts}
    assert names == {"a": 0.5, "b": 3.5}
    # A median of two is none: that of b alone is drawn, and the line between the groups.
    lines = [line for line in upper.lines if len(line.get_xdata()) == 2]
    assert [list(line.get_ydata()) for line in lines if line.get_linestyle() == "-"] == [[71, 71]]
    assert [list(line.get_xdata()) for line in lines if line.get_linestyle() == ":"] == [[1.5, 1.5]]
    crosses = [line for line in upper.lines if line.get_marker() == "x"]
    assert [list(line.get_xdata()) for line in crosses] == [[5]]
    assert "6 sessions, 1 without a result" in upper.get_title(loc="left")
    assert [label.get_text() for label in lower.get_xticklabels()] == ["1", "2", "1", "2", "3", "4"]


def test_what_differs_by_decades_is_drawn_on_a_logarithmic_scale():
    soft = [row(str(k), 1e3 * 3**k, 10.0) for k in range(4)]
    upper, lower = campaign_figure(soft, "gels").axes
    assert (upper.get_yscale(), lower.get_yscale()) == ("log", "linear")
