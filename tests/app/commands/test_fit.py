"""`palpate fit` around the estimation: what it prints, writes, refuses and returns.

The estimation itself is replaced here; its own tests say whether its numbers are right.
"""

import dataclasses
import json

import cv2
import numba
import numpy as np
import pytest
from flow_samples import SHAPE, rig
from pipeline.picture_session import measured_motion, with_pictures

from palpate.app import process
from palpate.app.commands import fit as fit_command
from palpate.errors import NotConvergedError, SingularSystemError
from palpate.estimation import FitResult, LikelihoodMap, Prediction, ProbeFit
from palpate.records import Constant, Estimate, ProbeEstimate, Status, read_estimate, write_rig
from palpate.report import report

G = Constant(2.1e4, 150.0, (2.07e4, 2.13e4))
NU = Constant(0.21, 0.006, (0.198, 0.222))
E = Constant(5.1e4, 300.0, (5.04e4, 5.16e4))
ALL_TOLD = {"shear_modulus": True, "poisson_ratio": True, "young_modulus": True}


def _result(session):
    """A made-up outcome for a session of one probing."""
    field = session.probings[0].displacement
    probe = ProbeFit(
        name="n01",
        predicted=0.9 * field.displacement,
        residual=0.1 * field.displacement,
        weight=np.ones_like(field.points),
        left_out_predicted=None,
    )
    ratios, moduli = np.linspace(0.0, 0.49, 5), np.linspace(2.0e4, 2.2e4, 4)
    deviance = (ratios[:, None] - 0.21) ** 2 + (moduli[None, :] / 2.1e4 - 1.0) ** 2
    estimate = Estimate(
        status=Status.OK,
        shear_modulus=G,
        poisson_ratio=NU,
        young_modulus=E,
        identifiable=ALL_TOLD,
        probes=(ProbeEstimate("n01", G, NU, E, 168, 1, 0, 2.1e-5, None),),
        seconds={"total": 1.25},
        method="reduced",
        settings={},
        notes=("Told by the estimation.",),
    )
    return FitResult(
        estimate=estimate,
        likelihood=LikelihoodMap(ratios, moduli, deviance - deviance.min()),
        probes=(probe,),
    )


@pytest.fixture
def calls(monkeypatch):
    """The estimation and the plots replaced; what they were asked for is collected."""
    asked = []

    def fit_session(session, *, settings, cache, finite_strain, material, progress):
        asked.append((session, settings, material))
        if progress is not None:
            progress("fit", 1.0)
        return _result(session)

    def write_plots(folder, session, result):
        (folder / "likelihood.png").write_bytes(b"png")

    monkeypatch.setattr(fit_command, "fit_session", fit_session)
    monkeypatch.setattr(report, "write_plots", write_plots)
    return asked


def test_constants_are_printed_and_the_folder_is_written(palpate, calls, cube_session, tmp_path):
    code, out, err = palpate("fit", cube_session)
    assert (code, err) == (0, "")
    for text in ("21.00 ± 0.15", "20.70 to 21.30", "0.2100 ± 0.0060", "51.00 ± 0.30", "kPa"):
        assert text in out
    assert "Note: Told by the estimation." in out
    folder = tmp_path / "cube-result"
    written, expected = read_estimate(folder / "estimate.json"), _result(calls[0][0]).estimate
    # Added are the time of the whole and what repeats it.
    assert written.seconds["total"] < 60.0
    assert written.settings["command"].startswith(f"palpate fit {cube_session} --method reduced")
    assert dataclasses.replace(written, seconds={}, settings={}) == dataclasses.replace(
        expected, seconds={}, settings={}
    )
    assert (folder / "likelihood.png").exists()


def test_residuals_are_written_with_their_points(palpate, calls, cube_session, tmp_path):
    palpate("fit", cube_session)
    path = tmp_path / "cube-result" / "residuals" / "n01.csv"
    table = np.genfromtxt(path, delimiter=",", names=True)
    assert table.dtype.names[:6] == ("x", "y", "z", "ux", "uy", "uz")
    assert np.isnan(table["ux"][0])
    # Nine digits are written.
    np.testing.assert_allclose(table["predicted_uz"][1:], 0.9 * table["uz"][1:], rtol=1e-8)


def test_options_reach_the_estimation(palpate, calls, cube_session, tmp_path):
    options = ("--out", tmp_path / "mine", "--method", "nelder-mead", "--probe", "n01")
    more = ("--poisson-range", "-0.5", "0.4", "--surface", "flat")
    assert palpate("fit", cube_session, *options, *more)[0] == 0
    session, settings, material = calls[0]
    assert ([p.name for p in session.probings], settings.method) == (["n01"], "nelder-mead")
    assert (settings.poisson_range, session.smooth, material) == ((-0.5, 0.4), False, "auto")
    assert json.loads((tmp_path / "mine" / "estimate.json").read_text())["status"] == "ok"


def test_time_takes_a_series(palpate, calls, cube_session):
    code, _, err = palpate("fit", cube_session, "--time")
    assert (code, calls) == (2, [])
    assert "no [[probe]] has a series" in err
    rows = ["t,fx,fy,fz,tx,ty,tz", "0,0,0,0,0,0,0", "1,0,0,-1.2,0,0,-1e-4", "30,0,0,-1.2,0,0,-2e-4"]
    (cube_session / "n01_series.csv").write_text("\n".join(rows))
    with (cube_session / "session.toml").open("a") as file:
        file.write('series = "n01_series.csv"\n')
    assert palpate("fit", cube_session, "--time")[0] == 0


@pytest.fixture
def two_probings(cube_session):
    """The cube with a second probing, of twice the displacements."""
    file = cube_session / "session.toml"
    text = file.read_text()
    file.write_text(text + text[text.index("[[probe]]") :].replace("n01", "n02"))
    rows = np.loadtxt(cube_session / "n01.csv", delimiter=",", skiprows=1)
    rows[:, 3:6] *= 2.0
    head = "x,y,z,ux,uy,uz,sigma"
    np.savetxt(cube_session / "n02.csv", rows, delimiter=",", header=head, comments="")
    return cube_session


def test_probings_held_out_are_predicted_not_fitted(
    palpate, calls, two_probings, tmp_path, monkeypatch
):
    def predict(session):
        (probing,) = session.probings
        moved = probing.displacement.displacement
        std = np.full_like(moved, 1e-4)
        points = probing.displacement.points
        return (Prediction(probing.name, points, moved, 0.9 * moved, std, 0.0 * std),)

    made = fit_command.fit_session
    monkeypatch.setattr(
        fit_command,
        "fit_session",
        lambda session, **given: dataclasses.replace(made(session, **given), predict=predict),
    )
    code, out, _ = palpate("fit", two_probings, "--hold-out", "n02", "--out", tmp_path / "mine")
    assert code == 0
    assert [probing.name for probing in calls[0][0].probings] == ["n01"]
    # A tenth too little everywhere, 0.03 and 0.04 mm with a sigma of 0.1 mm.
    assert "n02" in out
    assert "10.00" in out
    assert "100" in out
    rows = np.genfromtxt(tmp_path / "mine" / "held_out" / "n02.csv", delimiter=",", names=True)
    head = "x y z ux uy uz px py pz sx sy sz"
    assert " ".join(rows.dtype.names) == head
    # The row that was not measured is not there.
    assert len(rows) == len(np.loadtxt(two_probings / "n01.csv", delimiter=",", skiprows=1)) - 1
    np.testing.assert_allclose(rows["pz"], 0.9 * rows["uz"], rtol=1e-8)
    repeated = json.loads((tmp_path / "mine" / "estimate.json").read_text())
    assert "--hold-out n02" in repeated["settings"]["command"]


@pytest.mark.parametrize(
    ("names", "message"),
    [(["n03"], "names 'n03', but the session's probings are n01, n02"),
     (["n01", "n02"], "names every probing")],
)  # fmt: skip
def test_what_cannot_be_held_out_is_refused(palpate, calls, two_probings, names, message):
    code, _, err = palpate("fit", two_probings, "--hold-out", *names)
    assert code == 2
    assert message in err
    assert not calls


def test_a_ratio_out_of_range_is_said(palpate, calls, cube_session):
    code, _, err = palpate("fit", cube_session, "--poisson-range", "0", "0.7")
    assert code == 2
    assert "poisson_range is (0.0, 0.7)" in err
    assert not calls


def test_status_that_is_not_ok_ends_with_three_and_its_cure(
    palpate, calls, cube_session, tmp_path, monkeypatch
):
    def fit_session(session, **options):
        determined = ALL_TOLD | {"poisson_ratio": False}
        status = Status.from_identifiable(determined)
        result = _result(session)
        estimate = dataclasses.replace(result.estimate, status=status, identifiable=determined)
        return dataclasses.replace(result, estimate=estimate)

    monkeypatch.setattr(fit_command, "fit_session", fit_session)
    code, out, err = palpate("fit", cube_session)
    assert code == 3
    assert "Poisson's ratio nu not determined" in " ".join(out.split())
    # Once, as a sentence, with what would determine it.
    assert err.count("not determined") == 1
    assert "Poisson's ratio is not determined by the data: measure displacement vectors" in err
    assert "_identifiable" not in out + err
    assert (tmp_path / "cube-result" / "estimate.json").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--probe", "n1"), "no probing 'n1'; did you mean 'n01'"),
        (("--method", "newton"), "newton"),
        (("--out", "none/result"), "cannot be written"),
    ],
)
def test_bad_input_ends_with_two_before_any_work(palpate, calls, cube_session, options, message):
    code, out, err = palpate("fit", cube_session, *options)
    assert (code, out, calls) == (2, "", [])
    assert message in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (SingularSystemError("the support is a single triangle"), 2),
        (NotConvergedError("1000 steps"), 3),
    ],
)
def test_failures_leave_nothing(palpate, calls, cube_session, tmp_path, monkeypatch, error, code):
    def fit_session(session, **options):
        raise error

    monkeypatch.setattr(fit_command, "fit_session", fit_session)
    actual, out, err = palpate("fit", cube_session)
    assert (actual, out) == (code, "")
    assert err == f"palpate: {error}\n"
    assert [path.name for path in tmp_path.iterdir()] == ["cube"]


def test_a_disk_that_fills_up_leaves_nothing(palpate, calls, cube_session, tmp_path, monkeypatch):
    def write_plots(folder, session, result):
        raise OSError(28, "No space left on device", "likelihood.png")

    monkeypatch.setattr(report, "write_plots", write_plots)
    code, _, err = palpate("fit", cube_session)
    assert code == 2
    assert "cube-result: cannot be written (No space left on device); nothing was changed" in err
    assert [path.name for path in tmp_path.iterdir()] == ["cube"]


def test_notes_of_the_session_are_said(palpate, calls, cube_session):
    file = cube_session / "session.toml"
    file.write_text(file.read_text().replace("[0, 0, -1.2]", "[0, 0, 1.2]"))
    _, _, err = palpate("fit", cube_session)
    assert "palpate: note: Probing n01: the force points out of the surface" in err


def test_default_folder_is_named_after_the_session(palpate, calls, cube_session, tmp_path):
    (cube_session / "session.toml").rename(cube_session / "noisy.toml")
    assert palpate("fit", cube_session / "noisy.toml")[0] == 0
    assert (tmp_path / "cube-noisy-result").is_dir()


def test_motion_is_measured_once(palpate, calls, cube_session, tmp_path, monkeypatch):
    asked = []

    def measure_pictures(session, *, known, **_):
        """Each probing's made-up motion, unless it is known."""
        new = [probing for probing in session.probings if probing.name not in known]
        asked.append([probing.name for probing in new])
        return dict(known) | {probing.name: measured_motion(session, probing) for probing in new}

    monkeypatch.setattr(fit_command, "measure_pictures", measure_pictures)
    with_pictures(cube_session)
    _, first, _ = palpate("fit", cube_session)
    _, second, err = palpate("fit", cube_session)
    assert asked == [["n01"], []]
    assert "the motion in the pictures" not in first
    second = " ".join(second.split())
    assert "Note: the motion in the pictures of 1 of 1 probings is the one that cube-res" in second
    # Its notes are said again.
    assert "note: the pictures are dark" in err
    # One more push is measured alone, and kept beside the other.
    file = cube_session / "session.toml"
    text = file.read_text()
    probe = text[text.index("[[probe]]") :].replace("n01", "n02").replace("loaded_", "more_")
    file.write_text(f"{text}\n{probe}")
    for camera in ("c0", "c1"):
        (cube_session / f"more_{camera}.png").write_bytes(camera.encode())
    _, third, _ = palpate("fit", cube_session)
    assert "pictures of 1 of 2 probings is the one that cube-result" in " ".join(third.split())
    (cube_session / "loaded_c0.png").write_bytes(b"another picture")
    assert palpate("fit", cube_session)[0] == 0
    assert asked == [["n01"], [], ["n02"], ["n01"]]


def test_the_log_and_the_report_lie_in_the_result(palpate, calls, cube_session, tmp_path):
    _, out, err = palpate("fit", cube_session, "-v")
    folder = tmp_path / "cube-result"
    log = (folder / "log.txt").read_text(encoding="utf-8").splitlines()
    assert [line.split("  ")[-1] for line in log] == [
        "reading",
        "fit",
        "tables and pictures",
        "report",
    ]
    # Loading is a part of the whole, and so is the drawing.
    seconds = read_estimate(folder / "estimate.json").seconds
    assert list(seconds) == ["loading", "reading_and_motion", "drawing", "total"]
    assert sum(seconds.values()) == pytest.approx(2 * seconds["total"], abs=0.1)
    assert float(log[-1].split()[0]) == pytest.approx(seconds["total"], abs=0.3)
    assert f"report.html ({seconds['total']:.1f} s)" in " ".join(out.split())
    assert "tables and pictures" in err
    assert "report in cube-result/report.html" in out
    code, out, _ = palpate("report", "cube-result")
    assert (code, out[:35]) == (0, "Report in cube-result-report.html (")
    assert (tmp_path / "cube-result-report.html").read_bytes() == (
        folder / "report.html"
    ).read_bytes()
    # Nothing is replaced unasked.
    code, _, err = palpate("report", "cube-result")
    assert code == 2
    assert "is there already" in err
    assert palpate("report", "cube-result", "--force")[0] == 0
    code, _, err = palpate("report", cube_session)
    assert code == 2
    assert "no result of this version of Palpate" in err


def test_figures_of_the_surface_and_the_support_are_printed(palpate, cube_session):
    code, out, err = palpate("check", cube_session)
    assert (code, err) == (0, "")
    assert "a [bold] cube" in out
    for text in ("218, 432", "40 x 40 x 40 mm", "64 cm^3", "96 cm^2", "72 triangles, 16 cm^2"):
        assert text in out
    assert "palpate fit` decides" in out


def test_bad_session_ends_with_two(palpate, cube_session):
    file = cube_session / "session.toml"
    file.write_text(file.read_text().replace("force =", "forse ="))
    code, _, err = palpate("check", cube_session)
    assert code == 2
    assert "unknown key 'forse'; did you mean 'force'" in err
    assert err.count("\n") == 1


def test_shared_beam_promises_no_poisson_ratio(palpate, shared_data):
    """Needs ../shared."""
    code, out, _ = palpate("check", shared_data / "real" / "dragonskin_beam")
    assert code == 0
    assert "outside small deformation" in " ".join(out.split())
    assert "next to nothing about Poisson's ratio" in " ".join(out.split())


def test_a_rigid_motion_is_checked_with_its_cameras_and_pictures(palpate, cube_session):
    rng = np.random.default_rng(1)
    for name in ("a_c0", "a_c1", "b_c0", "b_c1"):
        grey = rng.integers(20, 230, SHAPE, dtype=np.uint8)
        cv2.imwrite(str(cube_session / f"{name}.png"), grey)
    write_rig(cube_session / "rig.toml", rig())
    file = cube_session / "session.toml"
    head = file.read_text().split("[support]")[0]
    steps = [f'[[step]]\nname = "{k}"\nimages = "{k}_{{camera}}.png"\n' for k in "ab"]
    file.write_text(f'{head}[rig]\ncameras = "rig.toml"\n{"".join(steps)}')
    code, out, err = palpate("check", cube_session)
    assert (code, err) == (0, "")
    for text in ("2 cameras", "160 x 120", "2 steps of a rigid motion"):
        assert text in out
    (cube_session / "b_c1.png").unlink()
    code, _, err = palpate("check", cube_session)
    assert code == 2
    assert "step 'b', camera 'c1'" in err


@pytest.mark.parametrize("command", ["check", "fit"])
def test_a_model_that_memory_cannot_hold_is_refused_at_once(
    palpate, cube_session, monkeypatch, command
):
    # 218 vertices need 9 MB beside the program's 0.3 GB.
    monkeypatch.setattr("palpate.machine.machine_memory", lambda: 0.34e9)
    code, _, err = palpate(command, cube_session)
    assert code == 2
    assert "mesh.ply: the mesh has 218 vertices" in err
    assert "decimate" in err


def test_what_is_compiled_is_counted(palpate, monkeypatch):
    double = numba.njit(lambda x: 2 * x)
    monkeypatch.setattr(fit_command, "warm_up", lambda _: (double(1), double(1.0)))
    code, out, _ = palpate("compile")
    assert code == 0
    assert out.startswith("2 kernels compiled in ")
    code, out, _ = palpate("compile")
    assert code == 0
    assert "were up to date" in out


def test_kernels_that_would_not_stay_are_not_compiled(palpate, monkeypatch):
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setattr(process, "_is_writable", lambda folder: False)
    monkeypatch.setattr(fit_command, "warm_up", None)
    code, out, err = palpate("compile")
    assert (code, out) == (2, "")
    assert "set NUMBA_CACHE_DIR to a folder that can" in err
