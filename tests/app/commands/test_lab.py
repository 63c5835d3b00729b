"""`palpate lab`: lists, sessions, and one message for what is wrong."""

import csv
import sys
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from flow_samples import SHAPE, rig, sample
from lab.lab_configs import STAGE

from palpate.app.commands import lab as lab_command
from palpate.app.commands.lab import _config_file, reproduce
from palpate.campaign import engine as engine_file
from palpate.errors import InputError
from palpate.geometry import write_mesh
from palpate.lab import Variant, read_lab_config
from palpate.lab.config_files import built_in
from palpate.paper.budget import SourceErrors
from palpate.paper.experiments import EXPERIMENTS
from palpate.paper.sessions import METHODS, PaperSession
from palpate.pipeline import MeasuredMotion, SessionFlow
from palpate.records import read_session

# Pictures of a sixteenth of the pixels: rendering them is most of the work.
SMALL = STAGE.replace("columns = 200", "columns = 50").replace("rows = 160", "rows = 40")
STEP = np.array([2.5e-3, 0.0, 0.0])
# What each method measures, in true ways.
TIMES = {"lang-pai": 0.9, "joint": 1.001}
HEAD = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "m"
[support]
plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-6 }
[rig]
cameras = "rig.toml"
"""
PROBE = """\
[[probe]]
name = "ear"
contact = { point = [0.02, 0.02, 0.04], radius = 0.006, profile = "smooth" }
force = [0, 0, -1.2]
images = { rest = "r_{camera}.png", loaded = ["a_{camera}.png"] }
"""


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
    first, other = (tmp_path / f"made{seed}" / "images" / "s1_c0.png" for seed in (1, 2))
    assert first.read_bytes() != other.read_bytes()


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


def session_of(config, folder):
    """A session of the sample's cube with the instants of a configuration, and its truth."""
    write_mesh(folder / "mesh.ply", sample().mesh)
    (folder / "rig.toml").write_text("")
    if config.stage is None:
        (folder / "session.toml").write_text(HEAD + PROBE)
        _write_truth_map(folder / "truth_ear.npz")
        return read_session(folder), ["ear"]
    names = [f"s{k}" for k in range(config.stage.steps + 1)]
    steps = "".join(f'[[step]]\nname = "{n}"\nimages = "{n}_{{camera}}.png"\n' for n in names)
    (folder / "session.toml").write_text(HEAD + steps)
    turn = "R = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]"
    truth = [
        f"[[step]]\n{turn}\nt = {(k * STEP).tolist()}\nencoder = {(k * STEP).tolist()}\n"
        for k in range(len(names))
    ]
    (folder / "truth.toml").write_text("".join(truth))
    return read_session(folder), names[1:]


def _write_truth_map(file):
    """Every pixel of the sample moved by one step."""
    surface = sample().surface
    pixel = np.flatnonzero(surface.triangle.ravel() >= 0)
    point = surface.point.reshape(-1, 3)[pixel]
    np.savez(file, shape=np.array(SHAPE), pixel=pixel, X=point, U=np.tile(STEP, (len(pixel), 1)))


def moved(name, vector):
    """The sample, moved as a whole."""
    sampled = sample()
    flow = replace(sampled.flow, displacement=np.tile(vector, (len(sampled.flow.outcome), 1)))
    moved = np.tile(vector, (len(sampled.mesh.vertices), 1))
    vertices = replace(sampled.vertices, displacement=moved)
    return MeasuredMotion(name, None, True, sampled.picture, flow, vertices, None)


def MAP(*_):
    """The engine's `map`, which nothing here calls."""


@contextmanager
def workers(scheduler, count, *, insecure):
    """An engine that starts nothing."""
    yield SimpleNamespace(map=MAP)


@pytest.fixture
def bench(monkeypatch, tmp_path):
    """An empty folder and no facility: sessions come at once. Gives what was asked for."""
    asked = []
    # An estimate needs more than motions: see test_paper_constants.
    for name in ("table3", "budget", "figure4"):
        monkeypatch.delitem(EXPERIMENTS, name)

    def measured_session(config, folder, *, variant, progress, parts, distribute):
        asked.append(config)
        assert distribute is MAP
        progress("doing [it]", 0.5)
        session, names = session_of(config, folder)
        flows = {
            method: SessionFlow(
                rig(),
                tuple(moved(n, TIMES[method] * k * STEP) for k, n in enumerate(names, start=1)),
                (),
            )
            for method in METHODS
        }
        return PaperSession(session, flows)

    monkeypatch.setattr("palpate.paper.experiments.measured_session", measured_session)
    monkeypatch.setattr(lab_command, "choose_variant", lambda: Variant("none", "no [bench]", None))
    monkeypatch.setattr(lab_command, "started_engine", workers)
    monkeypatch.setattr("palpate.paper.motion.surface_map", lambda *_: sample().surface)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "120")
    return asked


def rows_of(folder):
    """Tables of table.csv as lists of dictionaries."""
    parts = (folder / "table.csv").read_text().split("\n\n")
    return [list(csv.reader(part.splitlines())) for part in parts]


def test_every_experiment_needs_configurations_that_are_there():
    for sessions, _ in EXPERIMENTS.values():
        for name in sessions:
            read_lab_config(built_in()[name])


def test_table_one_has_the_paper_beside_both_methods(bench, tmp_path, capsys):
    assert reproduce("table1", out=tmp_path / "t1") == 0
    shown = capsys.readouterr()
    assert "no [bench]" in shown.err
    assert "Result in" in shown.out
    summary, along_x, along_y = rows_of(tmp_path / "t1")
    # A tenth of 20 mm too short, and a thousandth too long.
    assert [float(row[2]) for row in summary[2:4]] == pytest.approx([-2.0, 0.02])
    assert [row[1] for row in along_x[1:4]] == ["paper", "lang-pai", "joint"]
    assert float(along_x[1][2]) == pytest.approx(67.0081)
    assert float(along_y[1][2]) == pytest.approx(48.8813)
    assert len(along_x) == len(along_y) == 1 + 3 * 8
    assert (tmp_path / "t1" / "table1.png").is_file()
    assert (tmp_path / "t1" / "sessions" / "translation-y" / "truth.toml").is_file()


def test_table_two_tells_directions(bench, tmp_path):
    reproduce("table2", out=tmp_path / "t2")
    summary, *rows = rows_of(tmp_path / "t2")
    assert [row[0] for row in summary[1::3]] == ["translation-x", "translation-y", "rotation-z"]
    assert float(summary[1][2]) == pytest.approx(10.9142)
    # Too long or too short, but all in the true direction.
    assert [float(row[2]) for row in summary[2:4]] == pytest.approx([0.0, 0.0], abs=1e-9)
    assert len(rows) == 3
    assert rows[2][3][0:2] == ["1", "joint"]


@pytest.mark.parametrize(("name", "rows"), [("figure2", 4), ("figure3", 2)])
def test_figures_are_of_both_methods(bench, tmp_path, name, rows):
    reproduce(name, out=tmp_path / "f")
    for method in METHODS:
        assert (tmp_path / "f" / f"{name}_{method}.png").is_file()
    (table,) = rows_of(tmp_path / "f")
    assert len(table) == 1 + rows
    joint = table[2]
    assert joint[2] == "joint"
    assert joint[3] == joint[4] == str(len(sample().flow.outcome))
    steps = 2 if name == "figure2" else 1
    assert float(joint[5]) == pytest.approx(2.5 * steps)
    # A thousandth too long, and a tenth too short.
    assert float(joint[6]) == pytest.approx(1e-3 * 2.5 * steps)
    assert float(table[1][6]) == pytest.approx(0.1 * 2.5 * steps)


def test_all_measures_every_session_once_and_makes_the_page(bench, tmp_path, capsys):
    page = tmp_path / "paper.md"
    assert reproduce("all", out=tmp_path / "whole", page=page) == 0
    names = [config.name for config in bench]
    assert len(names) == len(set(names)) == 4
    for name in EXPERIMENTS:
        assert (tmp_path / "whole" / name / "table.md").is_file()
        assert any((tmp_path / "images" / "paper").glob(f"{name}*.png"))
    text = page.read_text()
    assert "`palpate reproduce all --page" in text
    assert text.count("\n## ") == len(EXPERIMENTS)
    assert "page" in capsys.readouterr().out


@pytest.mark.slow
def test_a_quick_run_is_smaller_and_says_so_on_its_page(bench, tmp_path):
    page = tmp_path / "paper.md"
    reproduce("all", quick=True, page=page)
    assert all(config.head.columns == 320 for config in bench)
    assert "`palpate reproduce all --quick --page" in page.read_text()
    _, along_x, _ = rows_of(tmp_path / "paper-all" / "table1")
    # The paper's steps beyond those of this run are left out.
    assert len(along_x) == 1 + 3 * 3


def test_what_there_is_not_is_refused_with_what_there_is(bench, tmp_path):
    with pytest.raises(InputError, match=r"no experiment 'table9'; there are: table1, .*, all"):
        reproduce("table9")
    with pytest.raises(InputError, match="--page with 'table1' alone"):
        reproduce("table1", page=tmp_path / "paper.md")
    (tmp_path / "mine.md").write_text("mine")
    with pytest.raises(InputError, match="was not generated by Palpate"):
        reproduce("all", page=tmp_path / "mine.md")
    assert bench == []
    assert list(tmp_path.iterdir()) == [tmp_path / "mine.md"]


def test_without_dask_the_work_is_done_here(monkeypatch):
    monkeypatch.setattr(lab_command, "find_spec", lambda name: None)
    with lab_command.distribution(None, None, by_default=True) as distribute:
        assert distribute is map
    monkeypatch.setitem(sys.modules, "distributed", None)
    # Where workers were asked for, they are not left out in silence.
    with (
        pytest.raises(InputError, match=r"pip install 'palpate\[batch\]'"),
        lab_command.distribution(None, 2),
    ):
        pass


def test_workers_that_cannot_be_are_refused_first(bench, tmp_path):
    with pytest.raises(InputError, match="--workers is 0; must be 1 to"):
        reproduce("table1", workers=0)
    with pytest.raises(InputError, match="not for one with --scheduler"):
        reproduce("table1", scheduler="tcp://127.0.0.1:9", workers=2)
    with pytest.raises(InputError, match="has no TLS: anybody who reaches it can run code"):
        reproduce("table1", scheduler="tcp://127.0.0.1:9")
    assert list(tmp_path.iterdir()) == []


def test_nothing_is_left_of_a_run_that_fails(bench, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device", "table.md")

    monkeypatch.setattr(lab_command, "write_result", full)
    with pytest.raises(InputError, match=r"paper-table1: cannot be written \(No space"):
        reproduce("table1")
    assert list(tmp_path.iterdir()) == []


def test_the_budget_makes_its_own_sessions(monkeypatch, tmp_path, capsys):
    asked = []

    def budget(config, folder, *, variant, draws, progress, parts, distribute):
        assert list(folder.iterdir()) == []
        assert distribute is MAP
        progress("making", 0.5)
        asked.append((config, folder.name, draws))
        errors = np.full((1, 3), 0.01)
        return tuple(SourceErrors(name, "much", errors, errors) for name in ("none", "all of it"))

    monkeypatch.setattr("palpate.paper.experiments.error_budget", budget)
    monkeypatch.setattr(lab_command, "choose_variant", lambda: Variant("none", "no", None))
    monkeypatch.setattr(lab_command, "started_engine", workers)
    reproduce("budget", out=tmp_path / "b")
    reproduce("budget", out=tmp_path / "q", quick=True)
    (full, name, draws), (quick, _, few) = asked
    assert (len(full.probes), len(quick.probes)) == (17, 3)
    assert (name, draws, few) == ("budget", 5, 1)
    table, sizes = rows_of(tmp_path / "b")
    assert [row[0] for row in table] == ["source", "none", "all of it"]
    assert sizes[2] == ["all of it", "much"]
    assert (tmp_path / "b" / "budget.png").is_file()
    assert (tmp_path / "b" / "sessions" / "budget").is_dir()
