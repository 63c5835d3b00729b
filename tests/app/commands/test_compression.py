"""`palpate compression`: the printed modulus, and bad input."""

import json

import numpy as np
import pytest


@pytest.fixture
def record(tmp_path):
    """A cylinder of 50 mm by 30 mm and 100 kPa: displacement in mm, force in N."""
    shortening = np.linspace(0.0, 4.0, 200)
    force = 1e5 * np.pi * 0.025**2 * shortening / 30.0
    path = tmp_path / "a.csv"
    np.savetxt(path, np.stack([shortening, force], axis=1), delimiter=",")
    return path


def test_modulus_is_printed_with_its_unit(palpate, record):
    code, out, _ = palpate("compression", record, "--diameter", "50mm", "--height", "3cm")
    assert code == 0
    assert "100.0" in out
    assert "(kPa)" in out


def test_several_files_give_their_mean(palpate, record, tmp_path):
    table = np.loadtxt(record, delimiter=",")
    np.savetxt(tmp_path / "b.csv", table * [1.0, 1.2], delimiter=",")
    options = ("--diameter", "50mm", "--height", "30mm")
    code, out, _ = palpate("compression", record, tmp_path / "b.csv", *options)
    assert code == 0
    assert "mean and spread of 2" in " ".join(out.split())
    # Mean of 100 and 120, standard deviation 20 / sqrt(2).
    assert "110 ± 14" in out


def test_repeats_of_one_specimen_count_once(palpate, record, tmp_path):
    table = np.loadtxt(record, delimiter=",")
    files = [record]
    for name, factor in (("b1", 1.2), ("b2", 1.4)):
        files.append(tmp_path / f"{name}.csv")
        np.savetxt(files[-1], table * [1.0, factor], delimiter=",")
    options = ("--diameter", "50mm", "--height", "30mm", "--plot", "curves.png")
    code, out, _ = palpate("compression", *files, *options, "--group", record.stem, "b")
    assert code == 0
    # Mean of 100 and 130, standard deviation 30 / sqrt(2).
    assert "mean and spread of 2" in " ".join(out.split())
    assert "115 ± 21" in out
    assert (tmp_path / "curves.png").stat().st_size > 5000
    code, _, err = palpate("compression", *files, *options[:4], "--group", "b1", "b")
    assert (code, "its name holds 0 of --group b1 b" in err) == (2, True)
    # Of one specimen nothing is known of how others differ.
    code, out, _ = palpate("compression", *files, *options[:4], "--group", ".csv")
    assert "mean and spread of 1" in " ".join(out.split())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--diameter", "50mm"), "does not say the height; give it, e.g. --height 50mm"),
        (("--diameter", "50", "--height", "30mm"), "did you mean 50mm?"),
    ],
)
def test_missing_or_wrong_sizes_end_with_two(palpate, record, options, message):
    code, _, err = palpate("compression", record, *options)
    assert code == 2
    assert message in err


def test_missing_file_ends_with_two(palpate):
    options = ("--diameter", "50mm", "--height", "30mm")
    code, _, err = palpate("compression", "none.csv", *options)
    assert code == 2
    assert "none.csv" in err


SIZES = ("--diameter", "50mm", "--height", "30mm")


@pytest.mark.parametrize("text", ["0..10%", "0%..10%", "0..0.1", " 0 .. 10 % "])
def test_result_as_json(palpate, record, tmp_path, text):
    target = tmp_path / "result.json"
    code, _, _ = palpate("compression", record, *SIZES, "--strain", text, "--out", target)
    assert code == 0
    written = json.loads(target.read_text())
    assert written["format"] == "palpate-compression/1"
    # The file holds 18 digits of an exact line.
    assert written["young_modulus"]["value"] == pytest.approx(1e5, rel=1e-9)
    assert written["young_modulus"]["spread"] is None
    assert written["specimens"][0]["strain_range"] == [0.0, 0.1]


@pytest.mark.parametrize("text", ["10", "0-10%", "1%..5", "..10%", "1.2.3..4%"])
def test_strain_that_is_no_range(palpate, record, text):
    code, _, err = palpate("compression", record, *SIZES, "--strain", text)
    assert code == 2
    assert "0..10%" in err


def test_output_that_cannot_be_written_leaves_nothing(palpate, record, tmp_path):
    target = tmp_path / "none" / "result.json"
    code, _, err = palpate("compression", record, *SIZES, "--out", target)
    assert code == 2
    assert "cannot be written" in err
    assert not target.parent.exists()


def test_units_are_passed_on(palpate, record):
    # No cylinder is pressed by more than its height.
    rows = np.loadtxt(record, delimiter=",")
    np.savetxt(record, rows[rows[:, 0] < 2.0], delimiter=",")
    options = ("--displacement-unit", "cm", "--force-unit", "kN", "--strain", "0..50%")
    code, out, _ = palpate("compression", record, *SIZES, *options)
    # Ten times the shortening and a thousand times the force: 100 times the modulus, 10 MPa.
    assert code == 0
    assert "(MPa)" in out
    assert "10.00" in out
