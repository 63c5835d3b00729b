"""OpenCorr's tables."""

import numpy as np
import pytest
from program_files import (
    GOOD,
    MOVE,
    PLACE,
    check_four_points,
    write_table,
)

from palpate.errors import RecordError
from palpate.records import measured_rows
from palpate.records.programs.registry import read_measured

OPENCORR = (
    "x,y,u,v,w,r1r2 ZNCC,r1t1 ZNCC,r1t2 ZNCC,r2_x,r2_y,t1_x,t1_y,t2_x,t2_y,"
    "ref_x,ref_y,ref_z,tar_x,tar_y,tar_z"
)


def _opencorr_rows():
    score = np.where(GOOD, 0.97, -3.0)
    scores = np.column_stack([np.full(4, 0.98), score, np.full(4, 0.96)])
    return np.column_stack([np.zeros((4, 2)), MOVE, scores, np.zeros((4, 6)), PLACE, PLACE + MOVE])


def test_opencorr_with_and_without_trailing_commas(tmp_path):
    for header, end in ((OPENCORR, ""), (OPENCORR + ",", ",")):
        path = write_table(tmp_path / "a.csv", header, _opencorr_rows(), end=end)
        check_four_points(read_measured("opencorr", path))


@pytest.mark.parametrize("column", [5, 6, 7])
def test_opencorr_any_score_of_zero_is_a_failure(tmp_path, column):
    rows = _opencorr_rows()
    rows[~GOOD, 5:8] = 0.9
    rows[~GOOD, column] = 0.0
    check_four_points(read_measured("opencorr", write_table(tmp_path / "a.csv", OPENCORR, rows)))


def test_opencorr_without_scores_says_so(tmp_path):
    rows = np.column_stack([MOVE, PLACE])[GOOD]
    path = write_table(tmp_path / "a.csv", "u,v,w,ref_x,ref_y,ref_z", rows)
    measured = read_measured("opencorr", path, length_unit="mm")
    assert measured.notes == ("It has no columns ZNCC, so failed points cannot be recognised.",)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("x,y,u0,v0,u,v,exx,eyy,exy,zncc", "'w' is missing; it is a 2-D table"),
        ("x,y,z,u,v,w,u0,v0,w0,ZNCC", "'ref_x' is missing; it is a volume table"),
        ("x,y,u,v,w,r1r2 ZNCC,r2_x,r2_y", "table of a reconstruction alone or of an old version"),
    ],
)
def test_opencorr_other_tables(tmp_path, header, message):
    path = write_table(tmp_path / "a.csv", header, np.ones((2, len(header.split(",")))))
    with pytest.raises(RecordError, match=message):
        read_measured("opencorr", path)


def test_opencorr_matches_that_hardly_correlate_are_no_measurements(tmp_path):
    """A correlation of 0.07 is chance: 0.75 is asked for, or what the caller says."""
    rows = _opencorr_rows()
    rows[0, 7] = 0.07
    rows[1, 5] = 0.74
    path = write_table(tmp_path / "a.csv", OPENCORR, rows)
    for least, kept in ((None, [2]), (0.5, [1, 2]), (0.0, [0, 1, 2]), (0.965, [])):
        if not kept:
            with pytest.raises(RecordError, match=r"3 correlate by less than 0.965 \(--min-score"):
                read_measured("opencorr", path, min_score=least)
            continue
        measured = read_measured("opencorr", path, min_score=least)
        assert list(np.flatnonzero(measured_rows(measured.displacement))) == kept
        assert measured.poorly_correlated == 3 - len(kept)
    with pytest.raises(RecordError, match="--min-score is 75; must be a correlation"):
        read_measured("opencorr", path, min_score=75.0)
    bare = write_table(tmp_path / "b.csv", "u,v,w,ref_x,ref_y,ref_z", np.ones((2, 6)))
    with pytest.raises(RecordError, match="has no correlation of its points"):
        read_measured("opencorr", bare, min_score=0.5)
