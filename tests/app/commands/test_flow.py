"""`palpate flow` around the measurement: what it prints, writes, refuses and returns.

The measurement itself is replaced here; its own tests say whether its numbers are right.
"""

import gc
import json
from types import SimpleNamespace

import numpy as np
import pytest
from flow_samples import SHAPE, rig, sample

from palpate.app.commands import flow as flow_command
from palpate.errors import RecordError
from palpate.geometry import TriangleMesh, write_mesh
from palpate.pipeline import MeasuredMotion, result_files
from palpate.records import read_session
from palpate.records.files.displacement import read_displacement
from palpate.vision import JointFlow, LangPaiFlow, Outcome, RangeFlow

SESSION = """\
format = "palpate-session/1"
name = "a [bold] cube"
[object]
mesh = "mesh.ply"
length_unit = "mm"
[support]
plane = { point = [0, 0, 0], normal = [0, 0, 1], tolerance = 1e-3 }
[rig]
cameras = "rig.toml"
[[probe]]
name = "n01"
contact = { point = [20, 20, 40], radius = 6, profile = "smooth" }
force = [0, 0, -1.2]
images = { rest = "rest_{camera}.png", loaded = ["a_{camera}.png", "b_{camera}.png"] }
[[probe]]
name = "n02"
contact = { point = [10, 20, 40], radius = 6, profile = "smooth" }
force = [0, 0, -1.2]
images = { rest = "rest_{camera}.png", loaded = ["c_{camera}.png"] }
"""
STEPS = """\
format = "palpate-session/1"
[object]
mesh = "mesh.ply"
length_unit = "mm"
[rig]
cameras = "rig.toml"
[[step]]
name = "s0"
images = "s0_{camera}.png"
[[step]]
name = "s1"
images = "s1_{camera}.png"
"""


def motion(name, sampled, *, probing=None, last=True):
    measured_motion = (sampled.flow, sampled.vertices, None)
    return MeasuredMotion(name, probing, last, sampled.picture, *measured_motion)


def lost(name, failure):
    return MeasuredMotion(name, "n02", True, np.zeros(SHAPE, np.float32), None, None, failure)


@pytest.fixture
def session(tmp_path):
    """A session of pictures that nobody reads."""
    folder = tmp_path / "cube"
    folder.mkdir()
    mesh = sample().mesh
    write_mesh(folder / "mesh.ply", TriangleMesh(1e3 * mesh.vertices, mesh.triangles))
    (folder / "rig.toml").write_text("")
    (folder / "session.toml").write_text(SESSION)
    return folder


@pytest.fixture
def measured(monkeypatch):
    """The measurement replaced: what it gives, and what it was asked for."""
    sampled = sample(reject={Outcome.SCORE: [5, 6]})
    measurement = SimpleNamespace(
        asked=[],
        motions=[
            motion("n01_1", sampled, probing="n01", last=False),
            motion("n01", sampled, probing="n01"),
            motion("n02", sampled, probing="n02"),
        ],
        notes=("rest_c1.png: 16 bit a pixel, made 8.",),
    )

    def measured_motions(session, *, method, pose, progress, parts):
        measurement.asked.append((session, method, pose))
        wanted = {None, *(probing.name for probing in session.probings)}
        for sampled_motion in measurement.motions:
            progress("points [a]", 0.5)
            if sampled_motion.probing in wanted:
                yield rig(), sampled_motion, measurement.notes

    monkeypatch.setattr(flow_command, "measured_motions", measured_motions)
    return measurement


def test_the_table_is_printed_and_the_folder_written(palpate, measured, session, tmp_path):
    code, out, err = palpate("flow", session)
    assert (code, err) == (0, f"palpate: note: {measured.notes[0]}\n")
    assert "n01: points followed through the instant before: 1, drift 3 µm" in out
    for word in ("n01_1", "score:2", "25/49", "1.5 1.8", "points/s", "Result in cube-flow"):
        assert word in out
    folder = tmp_path / "cube-flow"
    names = {path.name for path in folder.iterdir()}
    ends = (".csv", "_flow.npz", "_flow.vtp", ".png", "_quality.png")
    assert names == {"flow.json", "contents.txt", "inputs.txt"} | {
        name + end for name in ("n01", "n01_1", "n02") for end in ends
    }


def test_the_csv_is_in_the_unit_of_the_session(palpate, measured, session, tmp_path):
    palpate("flow", session, "--no-pictures")
    path = tmp_path / "cube-flow" / "n01.csv"
    mesh = read_session(session).mesh
    field, notes = read_displacement(path, mesh, metres_per_unit=1e-3)
    assert notes == ()
    known = np.isfinite(measured.motions[1].vertices.displacement[:, 0])
    displacement = field.displacement[np.isfinite(field.displacement[:, 0])]
    # The mesh file and the unit cost a few roundings.
    expected = measured.motions[1].vertices.displacement[known]
    np.testing.assert_allclose(np.sort(displacement[:, 0]), np.sort(expected[:, 0]), rtol=1e-12)
    assert np.genfromtxt(path, delimiter=",", names=True)["z"].max() == pytest.approx(40.0)


def test_the_document_holds_settings_figures_and_files(palpate, measured, session, tmp_path):
    palpate("flow", session)
    content = json.loads((tmp_path / "cube-flow" / "flow.json").read_text())
    assert content["format"] == "palpate-flow/1"
    assert content["session"] == "a [bold] cube"
    assert content["settings"]["joint"]["subset"] == 21
    assert (content["settings"]["method"], content["settings"]["pose"]) == ("joint", "auto")
    assert content["csv_metres_per_unit"] == 1e-3
    assert content["notes"] == list(measured.notes)
    first, second, _ = content["motions"]
    assert (first["name"], first["probing"], first["last"]) == ("n01_1", "n01", False)
    assert second["last"] is True
    for kind, file in second["files"].items():
        assert (tmp_path / "cube-flow" / file).is_file(), kind
    assert len(second["files"]) == 5


def test_the_range_flow_is_there_at_every_pixel_too(palpate, measured, session, tmp_path):
    palpate("flow", session, "--no-pictures")
    flow = measured.motions[1].flow
    with np.load(tmp_path / "cube-flow" / "n01_flow.npz") as stored:
        dense = stored["dense_displacement"]
    assert dense.shape == (*SHAPE, 3)
    column, row = flow.pixel[[200, 5]].astype(int).T
    # Single precision; the second point was rejected.
    np.testing.assert_allclose(dense[row[0], column[0]], flow.displacement[200], rtol=1e-6)
    assert np.isnan(dense[row[1], column[1]]).all()


def test_options_reach_the_measurement(palpate, measured, session, tmp_path):
    options = ("--out", tmp_path / "mine", "--method", "joint", "--pose", "given", "--probe", "n01")
    options += ("--no-pictures",)
    assert palpate("flow", session, *options, "--subset", "31", "--step", "8")[0] == 0
    given, method, pose = measured.asked[0]
    assert [probing.name for probing in given.probings] == ["n01"]
    assert (method, pose) == (JointFlow(subset=31, step=8), "given")
    assert (tmp_path / "mine" / "n01.csv").is_file()


def test_defaults_are_those_of_the_method(palpate, measured, session):
    palpate("flow", session, "--method", "lang-pai", "--no-pictures")
    _, method, pose = measured.asked[0]
    assert (method, pose) == (LangPaiFlow(), "auto")


def test_no_pictures_leaves_them_out(palpate, measured, session, tmp_path):
    assert palpate("flow", session, "--no-pictures")[0] == 0
    assert not list((tmp_path / "cube-flow").glob("*.png"))
    assert (tmp_path / "cube-flow" / "n01_flow.vtp").is_file()


def test_a_step_that_failed_is_said_and_the_others_are_kept(palpate, measured, session, tmp_path):
    measured.motions[2] = lost("n02", "c_c1.png: is cut off")
    code, out, err = palpate("flow", session, "--no-pictures")
    assert code == 3
    assert "palpate: n02: c_c1.png: is cut off\n" in err
    assert "failed" in out
    folder = tmp_path / "cube-flow"
    assert (folder / "n01.csv").is_file()
    assert not (folder / "n02.csv").exists()
    content = json.loads((folder / "flow.json").read_text())
    assert content["motions"][2]["failure"] == "c_c1.png: is cut off"
    assert content["motions"][2]["files"] == {}


def test_nothing_that_can_be_followed_ends_with_three(palpate, measured, session, tmp_path):
    count = len(sample().flow.point)
    blind = sample(reject={Outcome.TEXTURE: np.arange(count)})
    blind.vertices.displacement[:] = np.nan
    blind.vertices.covariance[:] = np.nan
    measured.motions = [motion("n02", blind, probing="n02")]
    code, out, err = palpate("flow", session, "--probe", "n02")
    assert code == 3
    assert f"palpate: n02: not one vertex could be followed (0 of {count} points valid)" in err
    assert f"texture:{count}" in out
    assert (tmp_path / "cube-flow" / "n02.csv").is_file()


def test_steps_of_a_rigid_motion_are_measured_too(palpate, measured, session, tmp_path):
    (session / "steps.toml").write_text(STEPS)
    measured.motions = [motion("s1", sample())]
    code, _, err = palpate("flow", session / "steps.toml", "--no-pictures")
    assert code == 0, err
    assert (tmp_path / "cube-steps-flow" / "s1.csv").is_file()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--probe", "n1"), "no probing 'n1'; did you mean 'n01'"),
        (("--method", "dic"), "dic"),
        (("--pose", "mine"), "mine"),
        (("--subset", "20"), "subset is 20; must be an odd number"),
        (("--step", "0"), "step is 0; must be 1 pixel or more"),
        (("--out", "none/result"), "cannot be written"),
    ],
)
def test_bad_input_ends_with_two_before_any_work(palpate, measured, session, options, message):
    code, out, err = palpate("flow", session, *options)
    assert (code, out, measured.asked) == (2, "", [])
    assert message in " ".join(err.split())
    assert "Traceback" not in err


def test_a_failure_leaves_nothing(palpate, measured, session, tmp_path, monkeypatch):
    def measured_motions(session, **options):
        yield rig(), measured.motions[0], ()
        raise RecordError("rest_c0.png: is missing")

    monkeypatch.setattr(flow_command, "measured_motions", measured_motions)
    code, out, err = palpate("flow", session)
    assert (code, out, err) == (2, "", "palpate: rest_c0.png: is missing\n")
    assert [path.name for path in tmp_path.iterdir()] == ["cube"]


@pytest.mark.slow
def test_motions_are_let_go_once_they_are_written(palpate, session, tmp_path, monkeypatch):
    """A video is long: its files are there, and its flows gone, as it goes."""
    alive, there = [], []

    def flows():
        gc.collect()
        # By type: to ask a weak proxy for its class fails where its object is gone.
        return sum(type(item) is RangeFlow for item in gc.get_objects())

    def measured_motions(session, **options):
        (folder,) = (path for path in tmp_path.glob(".long*") if path.is_dir())
        before = flows()
        for k in range(1, 6):
            there.append(len(list(folder.glob("*.csv"))))
            yield rig(), motion(f"s{k}", sample()), ()
            alive.append(flows() - before)

    monkeypatch.setattr(flow_command, "measured_motions", measured_motions)
    steps = "".join(f'[[step]]\nname = "s{k}"\nimages = "s{k}_{{camera}}.png"\n' for k in range(6))
    (session / "steps.toml").write_text(STEPS.partition("[[step]]")[0] + steps)
    code, _, err = palpate("flow", session / "steps.toml", "--no-pictures", "--out", "long")
    assert code == 0, err
    assert there == [0, 1, 2, 3, 4]
    # The command holds the motion that it has just written, and no earlier one.
    assert alive == [1] * 5


def test_a_disk_that_fills_up_leaves_nothing(palpate, measured, session, tmp_path, monkeypatch):
    def write_flow_npz(path, flow, **options):
        raise OSError(28, "No space left on device", "n01_flow.npz")

    monkeypatch.setattr(result_files, "write_flow_npz", write_flow_npz)
    code, _, err = palpate("flow", session)
    assert code == 2
    assert "cube-flow: cannot be written (No space left on device); nothing was changed" in err
    assert [path.name for path in tmp_path.iterdir()] == ["cube"]
