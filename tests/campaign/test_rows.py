"""What stands out of a group, and what the picture of a campaign shows of it."""

import math
from dataclasses import replace

import numpy as np
import pytest
from estimate_samples import sample_result

from palpate.campaign.rows import DONE, FAILED, Row, campaign_figure, constants_of, outliers
from palpate.records import Status, read_session


def _rows(moduli, *, group="", width=0.01, ratio=0.3):
    return [
        Row(
            f"{group}{k}",
            group,
            "done",
            young_modulus=E,
            young_modulus_low=E * math.exp(-1.96 * width),
            young_modulus_high=E * math.exp(1.96 * width),
            poisson_ratio=ratio,
            poisson_ratio_low=ratio - 0.02,
            poisson_ratio_high=ratio + 0.02,
        )
        for k, E in enumerate(moduli)
    ]


def test_a_value_far_out_of_its_group_is_named():
    rng = np.random.default_rng(5)
    # 10 % scatter; one of twice the modulus, one that would be usual in the other group.
    soft, hard = 5e4 * np.exp(0.1 * rng.normal(size=(2, 30)))
    soft[7], hard = 1e5, 4 * hard
    soft[9] = hard[3]
    outlying = outliers([*_rows(soft, group="soft"), *_rows(hard, group="hard")])
    assert outlying == {"soft7": ("young_modulus",), "soft9": ("young_modulus",)}


def test_one_without_an_interval_to_speak_of_is_no_outlier():
    moduli = [5e4, 5.1e4, 4.9e4, 5.05e4, 1.5e5]
    rows = _rows(moduli)
    assert list(outliers(rows)) == ["4"]
    # Its own interval reaches to the others: it says nothing against them.
    assert outliers([*rows[:4], *_rows([*moduli[:4], 1.5e5], width=0.5)[4:]]) == {}
    assert outliers(_rows(moduli[1:])) == {}  # too few to tell


def test_what_is_usual_is_seldom_named():
    # One in 370, as stated: 9.7 of 3600 here, and their number scatters by about its root.
    rng = np.random.default_rng(1)
    groups = 5e4 * np.exp(0.1 * rng.normal(size=(300, 12)))
    named = sum(len(outliers(_rows(group))) for group in groups)
    assert named < groups.size / 370 + 3 * np.sqrt(groups.size / 370)


def test_what_is_not_determined_is_left_empty(cube_session):
    estimate = sample_result(read_session(cube_session)).estimate
    constants = constants_of(estimate)
    assert (
        constants["young_modulus_low"]
        < constants["young_modulus"]
        < constants["young_modulus_high"]
    )
    lost = dict.fromkeys(("poisson_ratio", "young_modulus"), False)
    wide = replace(estimate.poisson_ratio, ci95=(-np.inf, 0.5))
    unknown = replace(
        estimate,
        status=Status.POISSON_RATIO_AND_YOUNG_MODULUS_NOT_IDENTIFIABLE,
        identifiable=estimate.identifiable | lost,
        poisson_ratio=wide,
    )
    constants = constants_of(unknown)
    assert [name for name, value in constants.items() if value is None] == [
        "poisson_ratio",
        "poisson_ratio_low",
        "young_modulus",
    ]


@pytest.mark.parametrize("state", ["failed", "waiting"])
def test_rows_without_a_result_do_not_count(state):
    rows = _rows([5e4] * 6)
    assert outliers([*rows, Row("x", "", state)]) == {}


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
