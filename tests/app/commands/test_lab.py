"""`palpate lab`: lists, sessions, and one message for what is wrong."""

from pathlib import Path

import pytest
from lab.lab_configs import STAGE

from palpate.app.commands.lab import _config_file
from palpate.campaign import engine as engine_file
from palpate.lab.config_files import built_in
from palpate.records import read_session

# Pictures of a sixteenth of the pixels: rendering them is most of the work.
SMALL = STAGE.replace("columns = 200", "columns = 50").replace("rows = 160", "rows = 40")


def test_the_list_names_what_can_be_chosen(palpate):
    code, out, _ = palpate("lab", "--list")
    assert code == 0
    assert all(name in out for name in built_in())
    assert all(word in out for word in ("half-ball", "toy", "speckle", "punch", "neo-hookean"))
    assert "[material] law" in out


def test_a_configuration_becomes_a_session_that_passes_its_check(palpate, tmp_path):
    (tmp_path / "toy.toml").write_text(SMALL)
    code, out, err = palpate("lab", "toy.toml", "made")
    assert code == 0
    assert "2 steps of a rigid motion in made; next: palpate flow made" in out
    assert "Mitsuba renders with" in err
    assert len(read_session(tmp_path / "made").steps) == 3
    assert (tmp_path / "made" / "contents.txt").is_file()


def test_another_seed_makes_other_pictures(palpate, tmp_path):
    (tmp_path / "toy.toml").write_text(SMALL.replace("steps = 2", "steps = 1"))
    for seed in (1, 2):
        assert palpate("lab", "toy.toml", f"made{seed}", "--seed", seed)[0] == 0
    one, other = (tmp_path / f"made{seed}" / "images" / "s1_c0.png" for seed in (1, 2))
    assert one.read_bytes() != other.read_bytes()


def test_unknown_names_and_missing_folders_get_one_message(palpate, tmp_path):
    code, out, err = palpate("lab", "half-bal", "made")
    assert (code, out) == (2, "")
    assert (
        "half-bal: no such file, and no built-in configuration; there are: demo, half-ball" in err
    )
    code, _, err = palpate("lab", "make")
    assert code == 2
    assert "give a configuration and a folder" in err


def test_a_folder_hides_no_built_in_configuration(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("demo", "mine"):
        (tmp_path / name).mkdir()
    assert _config_file("demo") == built_in()["demo"]
    assert _config_file("mine") == Path("mine")


def test_nothing_is_left_where_a_probe_misses(palpate, tmp_path):
    text = built_in()["demo"].read_text().replace("[0.000000, 0.000000, 0.040000]", "[0, 0, 0.09]")
    (tmp_path / "off.toml").write_text(text)
    code, _, err = palpate("lab", "off.toml", "made")
    assert code == 2
    assert "probe 'n01': its point is 50 mm away from the body" in err
    assert not (tmp_path / "made").exists()


@pytest.mark.slow
def test_workers_make_the_same_session(palpate, tmp_path):
    (tmp_path / "toy.toml").write_text(SMALL)
    assert palpate("lab", "toy.toml", "here")[0] == 0
    assert palpate("lab", "toy.toml", "there", "--workers", 1)[0] == 0
    here, there = tmp_path / "here", tmp_path / "there"
    names = {path.relative_to(here) for path in here.rglob("*") if path.is_file()}
    assert names == {path.relative_to(there) for path in there.rglob("*") if path.is_file()}
    assert {
        name for name in names if (here / name).read_bytes() != (there / name).read_bytes()
    } == set()


def test_a_wrong_number_of_workers_is_refused(palpate, tmp_path):
    code, _, err = palpate("lab", "demo", "made", "--workers", 0)
    assert code == 2
    assert "--workers is 0; must be 1 to" in err
    assert not (tmp_path / "made").exists()


def test_a_scheduler_that_is_not_there_is_no_error_of_the_configuration(
    palpate, tmp_path, monkeypatch
):
    monkeypatch.setattr(engine_file, "_CONNECT_TIMEOUT", 1)
    (tmp_path / "toy.toml").write_text(SMALL)
    code, _, err = palpate(
        "lab", "toy.toml", "made", "--scheduler", "tcp://127.0.0.1:9", "--insecure"
    )
    assert code == 2
    assert "palpate: no scheduler answers at tcp://127.0.0.1:9" in err
    assert not (tmp_path / "made").exists()
