"""Tables on the terminal: names as they are, nothing left out on a narrow screen."""

import io
from collections import Counter
from dataclasses import replace

import pytest
from cube_session import cube_session as cube_session
from estimate_relaxation import sample_relaxation
from estimate_samples import sample_result
from rich.console import Console

from palpate.app.tables import (
    constants_table,
    number_text,
    probes_table,
    regions_table,
    relaxation_table,
    terminal_table,
    truth_text,
)
from palpate.lab import Material
from palpate.records import (
    BudgetEntry,
    Constant,
    ErrorEstimate,
    LoadDependence,
    RegionEstimate,
    Status,
    read_session,
)

NAMES = ("probing-of-18-char", "another_of-18-char")


def printed(table, width):
    console = Console(width=width, record=True, file=io.StringIO())
    console.print(table)
    return console.export_text()


def test_the_terminal_shows_names_as_they_are():
    table = terminal_table(
        "Lengths [a]", ("source", "length", "text"), [("paper [b]", "0.33", "[c]")], caption="[d]"
    )
    text = printed(table, 100)
    assert all(word in text for word in ("Lengths [a]", "paper [b]", "0.33", "[c]", "[d]"))


def test_words_are_set_to_the_left_and_numbers_to_the_right():
    rows = [("a", "1", "kPa", "unknown"), ("b", "1000", "-", "12.5"), ("c", "-3.5", "", "-inf")]
    table = terminal_table("t", ("name", "number", "unit", "value"), rows)
    assert [column.justify for column in table.columns] == ["left", "right", "left", "right"]


def test_the_last_row_stands_apart_where_it_is_a_total():
    rows = [("a", "1"), ("b", "2"), ("all", "3")]
    assert [row.end_section for row in terminal_table("t", ("n", "k"), rows, total=True).rows] == [
        False, True, False,
    ]  # fmt: skip
    assert not any(row.end_section for row in terminal_table("t", ("n", "k"), rows).rows)


@pytest.mark.parametrize("width", [30, 60, 90])
def test_columns_are_as_narrow_as_their_numbers_and_nothing_is_left_out(width):
    columns = ("source", *(["largest error (kPa)"] * 7))
    text = printed(
        terminal_table("Wide", columns, [("tip misalignment", *(["-1234.50"] * 7))]), width
    )
    # Seven headings of 19 characters would take 140 columns; where even the numbers have no room,
    # columns go on below.
    assert text.count("-1234.50") == 7
    assert "…" not in text
    assert max(map(len, text.splitlines())) <= width


@pytest.mark.parametrize("width", [24, *range(55, 71)])
def test_two_columns_of_words_lose_no_character(width):
    rows = [
        ("worst aspect (longest edge / height)", "28.00"),
        ("support", "98 triangles, 9 cm^2, 6.5 % of all"),
    ]
    title = "Surface: closed, manifold, outward, without self-intersection"
    lines = printed(terminal_table(title, ("figure", "value"), rows), width).splitlines()
    assert max(map(len, lines)) <= width
    wanted = title + "figure" + "value" + "".join(map("".join, rows))
    shown = Counter("".join(lines).replace("─", "").replace(" ", ""))
    assert shown == Counter(wanted.replace(" ", ""))


def test_headings_titles_and_captions_take_the_room_there_is():
    table = terminal_table(
        "Elastic constants", ("constant", "value ± 1 sigma"), [("E", "3 ± 1")],
        caption="sigma: one standard deviation",
    )  # fmt: skip
    text = printed(table, 40)
    assert "constant  value ± 1 sigma" in text
    assert "\nsigma: one standard deviation" in text
    assert text.startswith("Elastic constants\n")


@pytest.mark.parametrize("value", [None, float("nan"), float("inf")])
def test_what_is_not_known_is_a_dash(value):
    assert number_text(value, ".2f") == "-"
    assert number_text(1.005e3, ".3g") == "1e+03"


def test_what_the_intervals_hold_is_said_below_the_constants(cube_session):
    known = sample_result(read_session(cube_session)).estimate
    assert "no force_std" not in printed(constants_table(known), 120)
    settings = {"assumed_forces": ["n01"], "errors": {"force": 0.01}}
    errors = (
        ErrorEstimate("gain of the force sensor", "", 0.004, 0.008, 0.01),
        ErrorEstimate("shift of the object along x", "m", -3e-4, 5e-5, 2e-4),
    )
    assumed = replace(known, settings=settings, errors=errors)
    text = " ".join(printed(constants_table(assumed), 120).split())
    assert "The force of 1 of 1 probing is assumed known to 1 % (no force_std given)" in text
    assert "Sigma of" not in text
    budget = (BudgetEntry("mesh", 0.01, 2e-3, 0.012), BudgetEntry("pose", 0.005, 1e-4, 0.006))
    text = " ".join(printed(constants_table(replace(known, budget=budget)), 120).split())
    assert (
        "Sigma of E comes from: mesh 1.2 %, pose 0.6 %. Sigma of nu comes from: mesh 0.002." in text
    )
    text = " ".join(printed(constants_table(assumed), 120).split())
    # The one that is farthest off by its own prior.
    assert "shift of the object along x, by -0.300 mm ± 0.050 mm (assumed: 0.2 mm, prior" in text


def named(cube_session):
    """An estimate of two probings with names of 18 characters."""
    estimate = sample_result(read_session(cube_session)).estimate
    (probe,) = estimate.probes
    return replace(estimate, probes=tuple(replace(probe, name=name) for name in NAMES))


@pytest.mark.parametrize("width", [60, 80, 140])
def test_numbers_stay_whole_and_names_are_all_there(cube_session, width):
    text = printed(probes_table(named(cube_session)), width)
    assert "…" not in text
    for word in (*NAMES, "0.3000 ± 0.0060", "23.08", "60.0 ± 1.2"):
        assert word in text
    assert max(map(len, text.splitlines())) <= width


def test_no_width_cuts_a_number(cube_session):
    table = probes_table(named(cube_session))
    for width in range(40, 120):
        lines = printed(table, width).splitlines()
        assert max(map(len, lines)) <= width
        text = " ".join(lines)
        # Every row of each part has its name; the last columns are there to their last digits.
        for word in (*NAMES, "0.3000 ± 0.0060", "60.0 ± 1.2", " 0.2 ", " 20 "):
            assert text.count(word) >= 2 - (word in NAMES), (width, word)


def test_what_is_not_determined_is_said_in_place_of_a_number(cube_session):
    lost = {"shear_modulus": True, "poisson_ratio": False, "young_modulus": True}
    estimate = replace(
        named(cube_session), identifiable=lost, status=Status.from_identifiable(lost)
    )
    text = printed(constants_table(estimate), 100)
    assert "not determined" in text
    assert "(0.2880 to 0.3120)" in text
    assert "0.3000" not in text
    # A probing alone tells no more than all of them.
    assert "0.3000" not in printed(probes_table(estimate), 140)


def test_stiffening_has_rows(cube_session):
    known = sample_result(read_session(cube_session)).estimate
    assert "load" not in printed(constants_table(known), 120)
    exponent = Constant(0.12, 0.03, (0.06, 0.18))
    load = LoadDependence(exponent, (0.51, 1.0), (0.95, 1.05))
    stiff = replace(known, stiffening=Constant(3.0, 0.2, (2.6, 3.4)), load=load)
    rows = [line.split("  ") for line in printed(constants_table(stiff), 80).splitlines()]
    rows = {cells[0].strip(): [cell.strip() for cell in cells if cell.strip()] for cells in rows}
    assert rows["stiffening C2 / C1"][1:] == ["3.00 \u00b1 0.20", "2.60 to 3.40", "-"]
    young = known.young_modulus.value / 1e3
    assert rows["E at 0.51 N"][1:] == [f"{0.95 * young:.3g}", "-", "kPa"]
    assert rows["E at 1 N"][1:] == [f"{1.05 * young:.3g}", "-", "kPa"]
    rises = rows["E rises with load, as force to the"]
    assert rises[1:] == ["0.120 \u00b1 0.030", "0.060 to 0.180", "-"]


def test_regions_have_a_table(cube_session):
    known = sample_result(read_session(cube_session)).estimate
    modulus, ratio = Constant(6e4, 1.5e3, (57e3, 63e3)), Constant(3.0, 0.1, (2.8, 3.2))
    insert = RegionEstimate("insert", ratio, modulus, modulus, "", True, True)
    skin = replace(insert, name="skin", identifiable=False, is_seen=False)
    lines = printed(regions_table(replace(known, regions=(insert, skin))), 120).splitlines()
    (row,) = (line for line in lines if "insert" in line)
    assert all(text in row for text in ("60.0 \u00b1 1.5 kPa", "57.0 to 63.0 kPa", "2.80 to 3.20"))
    assert any("skin" in line and "not seen" in line for line in lines)


def test_the_modulus_over_time_has_a_table():
    lines = printed(relaxation_table(sample_relaxation(2e4)), 120).splitlines()
    rows = {line.split("  ")[0].strip(): line for line in lines if "  " in line.strip()}
    assert "20.00 \u00b1 0.40" in rows["G at once"]
    # 0.5556 + 0.2379 exp(-10 / 2.297) + 0.2065 exp(-10 / 43.54), of 20 kPa.
    assert "14.45 \u00b1 0.29" in rows["G at 10 s"]
    assert "not determined" in rows["G in the long term"]
    assert "2.297 \u00b1 0.046" in rows["time constant, 24 % of G"]
    assert not any("G at 2" in line for line in lines)
    text = " ".join(" ".join(lines).split())
    assert "The constants above are those at 12 s after contact" in text
    assert "hold for 200 s." in text


def test_the_truth_of_a_virtual_bench_stands_beside_the_estimate(cube_session):
    estimate = sample_result(read_session(cube_session)).estimate
    assert truth_text(estimate, Material(60e3, 0.3)) == (
        "The truth of this virtual bench: G = 23.08 kPa, nu = 0.3, E = 60 kPa; all within."
    )
    # nu is 0.3 +- 0.006.
    assert truth_text(estimate, Material(60e3, 0.32)).endswith(
        "outside its interval: Poisson's ratio nu."
    )
