"""`palpate verify`: what it says of a result as it was written; `tests/faults` has the others."""

from estimate_samples import sample_result

from palpate.records import (
    read_session,
    record_inputs,
    result_folder,
    session_files,
    write_estimate,
)


def test_a_result_as_it_was_written(palpate, cube_session, tmp_path):
    with result_folder(tmp_path / "result", kind="fit") as folder:
        record_inputs(folder, session_files(cube_session))
        estimate = sample_result(read_session(cube_session)).estimate
        write_estimate(folder / "estimate.json", estimate)
    code, out, err = palpate("verify", "result")
    assert (code, err) == (0, "")
    assert "its 2 files are as they were written, the 3 files that it was made from as" in out


def test_what_changed_is_in_the_table_and_in_one_line(palpate, cube_session, tmp_path):
    with result_folder(tmp_path / "result", kind="fit") as folder:
        record_inputs(folder, session_files(cube_session))
        for number in range(5):
            (folder / f"table{number}").write_text("1")
    for number in range(5):
        (tmp_path / "result" / f"table{number}").write_text("2")
    (cube_session / "n01.csv").write_text("")
    code, out, err = palpate("verify", "result")
    assert code == 3
    assert [line.split() for line in out.splitlines() if "n01.csv" in line] == [
        ["../cube/n01.csv", "input", "changed"]
    ]
    assert "table2 (changed) and 3 more" in err
