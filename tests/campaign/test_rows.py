"""What stands out of a group, and what does not."""

import math
from dataclasses import replace

import numpy as np
import pytest
from estimate_samples import sample_result

from palpate.campaign.rows import Row, constants_of, outliers
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
    found = outliers([*_rows(soft, group="soft"), *_rows(hard, group="hard")])
    assert found == {"soft7": ("young_modulus",), "soft9": ("young_modulus",)}


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
    found = constants_of(estimate)
    assert found["young_modulus_low"] < found["young_modulus"] < found["young_modulus_high"]
    lost = dict.fromkeys(("poisson_ratio", "young_modulus"), False)
    wide = replace(estimate.poisson_ratio, ci95=(-np.inf, 0.5))
    unknown = replace(
        estimate,
        status=Status.POISSON_RATIO_AND_YOUNG_MODULUS_NOT_IDENTIFIABLE,
        identifiable=estimate.identifiable | lost,
        poisson_ratio=wide,
    )
    found = constants_of(unknown)
    assert [name for name, value in found.items() if value is None] == [
        "poisson_ratio",
        "poisson_ratio_low",
        "young_modulus",
    ]


@pytest.mark.parametrize("state", ["failed", "waiting"])
def test_rows_without_a_result_do_not_count(state):
    rows = _rows([5e4] * 6)
    assert outliers([*rows, Row("x", "", state)]) == {}
