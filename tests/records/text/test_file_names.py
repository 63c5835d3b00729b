"""Each probing or motion has files of its own, whatever its name is."""

import pytest

from palpate.records import file_stems


def test_a_motion_has_its_own_name_where_that_is_a_file_name():
    names = ["n01", "n05_1", "0.5-N"]
    assert file_stems(names, kind="motion") == names


# A file system counts bytes, two for each of these letters.
_LONG = 190 * "\N{GREEK SMALL LETTER PI}"


@pytest.mark.parametrize("name", ["a/b", "..", ".hidden", "", "a b", "[bold]", "contents", _LONG])
def test_other_names_are_replaced_by_a_number(name):
    assert file_stems(["n01", name], kind="motion") == ["n01", "motion-2"]


@pytest.mark.parametrize("names", [["a", "a_flow"], ["a_quality", "a"], ["a", "A"], ["a", "a"]])
def test_no_two_motions_write_the_same_file(names):
    stems = file_stems(names, kind="motion")
    files = [stem + end for stem in stems for end in ("", "_flow", "_quality")]
    assert len({file.lower() for file in files}) == 6


@pytest.mark.parametrize("names", [["motion-2", "?", "motion-2"], ["a/b", "motion-1"]])
def test_a_name_that_is_another_ones_number_is_no_trap(names):
    assert len(set(file_stems(names, kind="motion"))) == len(names)
