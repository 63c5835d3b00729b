"""Tables in text files: separators, locales, encodings, and what is wrong where."""

import numpy as np
import pytest

from palpate.errors import RecordError
from palpate.records.text.csv_table import read_text_table


def _read(tmp_path, content):
    path = tmp_path / "a.csv"
    path.write_bytes(content if isinstance(content, bytes) else content.encode("utf-8"))
    return read_text_table(path, cure="CURE")


@pytest.mark.parametrize(
    "content",
    [
        "a,b [mm]\n1,2.5\n3,-4e-3\n",
        '"a","b [mm]"\r\n"1","2.5"\r\n3,-4e-3\r\n',
        "a;b [mm];\n1;2,5;\n3;-4,0e-3;\n",
        "a;b [mm]\n1;2,5;\n3;-4e-3\n",
        "a\tb[mm]\n1\t2.5\n\n3\t-4e-3\n\n",
        "sep=,\n# made today\n\na, b [mm] \n 1, 2.5\n 3, -4e-3\n",
        "a,b [mm]\na,b [mm]\n1,2.5\n3,-4e-3\n",
        b"\xef\xbb\xbfa,b [mm]\n1,2.5\n3,-4e-3",
        "\ufeffa,b [mm]\n1,2.5\n3,-4e-3".encode("utf-16-le"),
    ],
)
def test_the_same_numbers_however_they_are_written(tmp_path, content):
    table = _read(tmp_path, content)
    assert [(column.name, column.unit) for column in table.columns] == [("a", None), ("b", "mm")]
    np.testing.assert_array_equal(table.values(table.columns), [[1.0, 2.5], [3.0, -4e-3]])


def test_western_code_page(tmp_path):
    table = _read(tmp_path, b"X [\xb5m],Y\n1,2\n")
    assert table.columns[0].unit == "\u00b5m"


def test_blanks_separate_where_nothing_else_does(tmp_path):
    table = _read(tmp_path, "a   b\n 1 2.5\n3    4\n")
    np.testing.assert_array_equal(table.values(table.columns[1:]), [[2.5], [4.0]])


def test_a_unit_stays_with_its_quantity(tmp_path):
    table = _read(tmp_path, "time [ms]  force [N] [a] [b]\n 1 2.5 3 4\n")
    assert [column.name for column in table.columns[:2]] == ["time", "force"]
    assert [column.unit for column in table.columns[:2]] == ["ms", "N"]
    np.testing.assert_array_equal(table.values(table.columns), [[1.0, 2.5, 3.0, 4.0]])


@pytest.mark.parametrize(
    "word", ["", "nan", "NaN", "-nan(ind)", "NeuN", "n. def.", "1.#QNAN", "1.#INF", "#N/A", "-"]
)
def test_no_number(tmp_path, word):
    table = _read(tmp_path, f"a,b\n1,{word}\n2,3\n")
    np.testing.assert_array_equal(table.values(table.columns), [[1.0, np.nan], [2.0, 3.0]])


@pytest.mark.parametrize("word", ["inf", "-Infinity", "+Infinito"])
def test_infinity_is_for_the_caller_to_judge(tmp_path, word):
    table = _read(tmp_path, f"a,b\n1,{word}\n")
    assert np.isinf(table.values(table.columns)).tolist() == [[False, True]]


def test_words_in_columns_that_are_not_wanted(tmp_path):
    table = _read(tmp_path, "a,b\nfirst,1\nsecond,2\n")
    np.testing.assert_array_equal(table.values(table.columns[1:]), [[1.0], [2.0]])


@pytest.mark.parametrize("row", ["1,2", "1,2,3,4", "1,2,3,4,", "1"])
def test_a_row_of_another_length(tmp_path, row):
    table = _read(tmp_path, f"a,b,c\n1,2,3\n{row}\n")
    count = len(row.split(","))
    with pytest.raises(RecordError, match=f"line 3: has {count} cells; the header has 3 columns"):
        table.values(table.columns[:1])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("", "is empty; CURE"),
        ("*** only\n\n# this\n", "is empty"),
        ("a,b\n\n", "has a header and no rows"),
        (b"II*\0\1\2", "is not a text file; CURE"),
        ("a,b\n1,2\n\n3,4\na,b\n5,6\n", "line 5: the header again.*each a file of its own"),
    ],
)
def test_nothing_to_read(tmp_path, content, message):
    with pytest.raises(RecordError, match=message):
        _read(tmp_path, content)
