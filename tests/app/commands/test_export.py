"""`palpate export`: the folder it leaves, and what it refuses."""

from typing import get_args

import pytest
from exported_result import written_result

from palpate.app.commands.use.export import Simulator
from palpate.records import folder_changes
from palpate.simulation import FORMATS


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    return written_result(tmp_path_factory.mktemp("exported"))


def test_the_folder_holds_the_simulators_files(palpate, result, tmp_path):
    code, out, err = palpate("export", result, "--to", "obj")
    assert code == 0
    folder = tmp_path / "result-obj"
    names = {path.name for path in folder.iterdir()}
    assert names == {"surface.obj", "palpate.json", "README.txt", "contents.txt", "inputs.txt"}
    assert "Push written along: probing n02, left out of the estimate" in out
    assert "no density: 1000 kg/m^3 was written" in err
    assert folder_changes(folder)[1] == {}


def test_a_folder_that_holds_something_else_is_left_alone(palpate, result, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes.txt").write_text("mine")
    code, _, err = palpate("export", result, "--to", "obj", "--out", "mine")
    assert code == 2
    assert "holds files that are no result of Palpate's" in err
    assert [path.name for path in (tmp_path / "mine").iterdir()] == ["notes.txt"]


def test_an_export_to_another_simulator_is_left_alone(palpate, result):
    assert palpate("export", result, "--to", "obj", "--out", "made")[0] == 0
    assert palpate("export", result, "--to", "obj", "--out", "made")[0] == 0
    code, _, err = palpate("export", result, "--to", "genesis", "--out", "made")
    assert code == 2
    assert "is a result of `palpate export --to obj`" in err


def test_the_edge_may_have_a_unit(palpate, result):
    code, _, err = palpate("export", result, "--to", "vtu", "--edge", "900000 mm")
    assert (code, "0.0693 m across" in err) == (2, True)


def test_the_command_knows_every_format():
    assert set(get_args(Simulator)) == set(FORMATS)


def test_an_unknown_simulator_is_refused(palpate, result):
    code, _, err = palpate("export", result, "--to", "blender")
    assert code == 2
    assert "mujoco" in err
