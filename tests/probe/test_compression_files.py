"""Compression records: machine files, plain columns, units, bad files."""

import numpy as np
import pytest

from palpate.errors import InputError, RecordError
from palpate.probe import metres_from_text, read_compression

MACHINE = """Sample 1
Compression test;
Cylinder Diameter: 50mm;
Cylinder Height: 3cm;

Time (s),Compression (mm),Load (N),Engineering Strain [-]
0.0,0.0,0.01,0.0
0.1,0.5,2.5,0.017
0.2,1.0,5.1,0.033
"""


def write(tmp_path, text, *, encoding="utf-8"):
    path = tmp_path / "record.csv"
    path.write_bytes(text.encode(encoding))
    return path


def test_machine_file(tmp_path):
    record = read_compression(write(tmp_path, MACHINE))
    np.testing.assert_allclose(record.displacement, [0.0, 5e-4, 1e-3])
    np.testing.assert_allclose(record.force, [0.01, 2.5, 5.1])
    assert (record.diameter, record.height) == (0.05, 0.03)
    assert record.notes == ()


@pytest.mark.parametrize(
    "text",
    [
        "0,0\n1,10\n2,20\n",
        "0 0\n1 10\n2 20\n",
        "0\t0\n\n1\t10\n2\t20\n",
        "0;0\n1,0;10,0\n2,0;20,0\n",
        "displacement,force\n0,0\n1,10\n2,20,\n",
    ],
)
def test_plain_columns_are_millimetres_and_newtons(tmp_path, text):
    record = read_compression(write(tmp_path, text))
    np.testing.assert_allclose(record.displacement, [0, 1e-3, 2e-3])
    np.testing.assert_allclose(record.force, [0, 10, 20])
    assert "mm is taken" in record.notes[0]


def test_units_and_columns_can_be_told(tmp_path):
    path = write(tmp_path, "a,b,c\n1,2,3\n4,5,6\n")
    record = read_compression(
        path, displacement_column="c", force_column="a", displacement_unit="cm", force_unit="kN"
    )
    np.testing.assert_allclose(record.displacement, [0.03, 0.06])
    np.testing.assert_allclose(record.force, [1000, 4000])


def test_units_in_the_header_count(tmp_path):
    record = read_compression(
        write(tmp_path, "Force [kN];Crosshead (µm)\n1;2\n", encoding="latin-1")
    )
    np.testing.assert_allclose(record.displacement, [2e-6])
    np.testing.assert_allclose(record.force, [1000])


def test_negative_columns_are_turned_and_said(tmp_path):
    record = read_compression(write(tmp_path, "0,0\n-1,-10\n-2,-20\n"))
    np.testing.assert_allclose(record.force, [0, 10, 20])
    assert sum("sign was turned" in note for note in record.notes) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("nothing\nhere\n", "no line with two numbers in 2 lines"),
        ("0,0\n1,one\n", "line 2: column 2 holds 'one'; must be a number"),
        ("0,0\n1\n", "line 2: has 1 cells; the header has 2 columns"),
        ("0,0\n1,nan\n", "line 2: displacement or force is not a finite number"),
        ("0,0,0\n1,1,1\n", "3 columns without names"),
        ("time,load\n0,0\n", "no column for the displacement"),
        ("compression,time\n0,0\n", "no column for the force"),
        ("load a,load b,stroke\n0,0,0\n", "2 columns match force"),
        ("stroke (furlong),load\n0,0\n", '"furlong" is not known'),
    ],
)
def test_bad_files_are_refused(tmp_path, text, message):
    with pytest.raises(RecordError, match=message):
        read_compression(write(tmp_path, text))


def test_a_column_cannot_be_both(tmp_path):
    with pytest.raises(RecordError, match="both be column 1"):
        read_compression(write(tmp_path, "a,b\n0,0\n"), displacement_column="a", force_column="a")


def test_missing_file_and_unknown_unit(tmp_path):
    with pytest.raises(RecordError, match=r"none\.csv: cannot be read \(No such file"):
        read_compression(tmp_path / "none.csv")
    with pytest.raises(RecordError, match="cannot be read"):
        read_compression(tmp_path)
    with pytest.raises(InputError, match="force_unit"):
        read_compression(write(tmp_path, "0,0\n"), force_unit="stone")


@pytest.mark.parametrize(
    ("text", "metres"),
    [("50mm", 0.05), ("5 cm", 0.05), ("0.05m", 0.05), ("0.05", 0.05), ("2in", 0.0508)],
)
def test_lengths_carry_their_unit(text, metres):
    assert metres_from_text(text) == pytest.approx(metres, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("50", "did you mean 50mm"),
        ("wide", "write a number with its unit"),
        ("5 ells", "write a number with its unit"),
        ("-5mm", "must be from 0.1 mm to 2 m"),
        ("3m", "that is 3 m; must be from 0.1 mm to 2 m: check the unit"),
    ],
)
def test_lengths_that_no_specimen_has(text, message):
    with pytest.raises(InputError, match=message):
        metres_from_text(text, name="diameter")
