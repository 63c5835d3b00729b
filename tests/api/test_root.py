"""`import palpate`: few names, loaded late; objects that print themselves in a line or a few."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from estimate_samples import sample_result
from matplotlib.figure import Figure

import palpate
from palpate.api import Result
from palpate.errors import InputError, RecordError


@pytest.fixture
def result(cube_session):
    session = palpate.read_session(cube_session)
    return Result(session, sample_result(session))


def test_the_root_has_few_names_and_all_of_them_are_there():
    names = dir(palpate)
    assert {"read_session", "fit", "Result", "Session", "read_estimate"} <= set(names)
    assert len(names) <= 30
    assert all(getattr(palpate, name) is not None for name in names)


def test_a_name_that_is_not_there_is_an_error():
    with pytest.raises(AttributeError, match="no attribute 'colour'"):
        palpate.colour  # noqa: B018


def test_importing_the_root_loads_nothing():
    script = (
        "import sys, palpate; dir(palpate);"
        "sys.exit(', '.join({'numpy', 'scipy', 'matplotlib', 'numba'} & set(sys.modules)) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_objects_print_themselves_in_a_few_lines(result):
    session = result.session
    for shown in (session, session.mesh, session.probings[0], session.probings[0].displacement,
                result, result.estimate, result.fitted):  # fmt: skip
        text = repr(shown)
        assert 20 < len(text) < 600, type(shown)
        assert text.count("\n") <= 4
    assert "1 probing (n01)" in repr(session)
    assert "169 points, 168 measured" in repr(session.probings[0])
    assert "60.0 ± 1.2  57.6 to 62.4  kPa" in repr(result)


def test_a_notebook_shows_a_table(result):
    shown = result._repr_html_()
    assert shown.count("<tr>") == 4
    assert "<td>60.0 ± 1.2</td>" in shown
    assert "<b>a [bold] cube</b>" in shown
    assert result.session._repr_html_().count("<li>") == 1


@pytest.mark.parametrize("what", ["likelihood", "probings", "n01"])
def test_a_result_draws_itself(result, what):
    assert isinstance(result.plot(what), Figure)


def test_what_cannot_be_drawn_is_said(result):
    with pytest.raises(InputError, match=r"there is no picture 'n02'; there are: likelihood.*n01"):
        result.plot("n02")
    with pytest.raises(InputError, match="nothing to draw of 'predictions'"):
        result.plot("predictions")


def test_a_report_is_one_file(result, tmp_path):
    file = result.report(tmp_path / "cube.html")
    assert "All three constants are determined" in file.read_text(encoding="utf-8")
    assert {path.name for path in tmp_path.iterdir()} == {"cube", "cube.html"}


def test_a_report_replaces_nothing_but_pages(result, cube_session):
    file = cube_session / "session.toml"
    before = file.read_text(encoding="utf-8")
    with pytest.raises(InputError, match=r"session.toml: a report is an HTML file"):
        result.report(file)
    assert file.read_text(encoding="utf-8") == before


def test_a_result_is_exported(result, tmp_path):
    folder = result.export(tmp_path / "obj", "obj")
    assert {"README.txt", "palpate.json"} <= {path.name for path in folder.iterdir()}
    with pytest.raises(InputError, match=r"no simulator 'blender'; there are: .*mujoco"):
        result.export(tmp_path / "other", "blender")
    assert not (tmp_path / "other").exists()


def test_pokes_take_units(result):
    in_metres = result.poke((0.02, 0.02, 0.04), (0.0, 0.0, -1.0), radius=0.006)
    as_text = result.poke(("20 mm", "2cm", "40mm"), (0, 0, "-1000 mN"), radius="6 mm")
    assert as_text.displacement == pytest.approx(in_metres.displacement, rel=1e-12)
    assert in_metres.displacement[2] < 0.0
    with pytest.raises(InputError, match=r"at is '20 miles'; must be a finite number.*mm"):
        result.poke(("20 miles", 0, 0), (0, 0, -1))
    with pytest.raises(InputError, match="force is 1; must be three numbers"):
        result.poke((0.02, 0.02, 0.04), 1)
    with pytest.raises(InputError, match="force is None; must be a finite number"):
        result.poke((0.02, 0.02, 0.04), (0, 0, None))


def test_the_pose_is_chosen_as_on_the_command_line(cube_session, monkeypatch):
    chosen = []

    def measured(session, *, pose, progress):
        chosen.append(pose)
        return session

    monkeypatch.setattr("palpate.api.with_pictures_measured", measured)
    palpate.fit(cube_session)
    palpate.fit(cube_session, pose="given")
    assert chosen == ["auto", "given"]


def test_options_are_those_of_the_command_line(cube_session, monkeypatch):
    """Each reaches the fit under the name that `palpate fit` gives it."""
    fitted = []

    def fit_session(session, **options):
        fitted.append((session, options))
        return sample_result(session)

    monkeypatch.setattr("palpate.api.fit_session", fit_session)
    palpate.fit(cube_session, probe="n01", surface="flat", strain="finite", material="field")
    palpate.fit(cube_session)
    (first, chosen), (second, default) = fitted
    assert [probing.name for probing in first.probings] == ["n01"]
    assert (first.smooth, second.smooth) == (False, True)
    assert (chosen["finite_strain"], chosen["material"]) == (True, "field")
    assert (default["finite_strain"], default["material"]) == (False, "auto")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"strain": "large"}, "strain is 'large'; must be one of 'small', 'finite'"),
        ({"material": "steel"}, "material is 'steel'; must be one of 'homogeneous', 'regions'"),
        ({"surface": "sharp"}, "surface is 'sharp'; must be one of 'smooth', 'flat'"),
    ],
)
def test_choices_that_there_are_not_are_refused(cube_session, options, message):
    with pytest.raises(InputError, match=message):
        palpate.fit(cube_session, **options)


def test_a_modulus_over_time_takes_a_series(cube_session):
    with pytest.raises(InputError, match="no \\[\\[probe\\]\\] has a series"):
        palpate.fit(cube_session, time=True)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ("fit(3)", "session is 3; must be the path of a session folder, or a Session"),
        ("fit('s', probe=['n01', 2])", "probe is ['n01', 2]; must be a probing's name, or a list"),
    ],
)
def test_arguments_of_wrong_types_are_refused(call, message):
    # In another process: here the types of all arguments are checked before.
    script = f"import palpate; palpate.{call}"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert message in done.stderr


def test_pushes_are_predicted_from_a_folder(result, cube_session):
    seen = []
    fitted = replace(result.fitted, predict=lambda session: tuple(seen.append(session) or ()))
    assert replace(result, fitted=fitted).predict(cube_session) == ()
    assert seen[0].path == result.session.path


def test_a_written_result_is_opened_without_fitting(result, tmp_path):
    opened = palpate.read_result(result.save(tmp_path / "kept"))
    assert repr(opened) == repr(result)
    for what in ("likelihood", "probings", "n01"):
        assert isinstance(opened.plot(what), Figure)
    push = ("20 mm", "2cm", "40mm"), (0, 0, "-1 N")
    poked = opened.poke(*push, radius="6 mm").displacement
    assert poked == pytest.approx(result.poke(*push, radius="6 mm").displacement, rel=1e-9)
    again = palpate.read_result(opened.save(tmp_path / "again"))
    (first,), (second,) = result.fitted.probes, again.fitted.probes
    for name in ("predicted", "residual", "weight"):
        np.testing.assert_array_equal(getattr(first, name), getattr(second, name))
    assert "determined" in opened.report(tmp_path / "cube.html").read_text(encoding="utf-8")
    assert (opened.export(tmp_path / "obj", "obj") / "README.txt").is_file()
    with pytest.raises(InputError, match="no model to predict with: fit the session again"):
        opened.predict(opened.session)


def test_a_result_whose_session_has_changed_says_so(result, cube_session, tmp_path):
    folder = result.save(tmp_path / "kept")
    table = cube_session / "n01.csv"
    original = table.read_text(encoding="utf-8")
    table.write_text("".join(original.splitlines(keepends=True)[:-1]), encoding="utf-8")
    with pytest.raises(RecordError, match="'n01' was fitted to other points"):
        palpate.read_result(folder)
    table.write_text(original + "\n", encoding="utf-8")
    assert "n01.csv changed" in palpate.read_result(folder).estimate.notes[0]
    with pytest.raises(RecordError, match="is no result of this version"):
        palpate.read_result(cube_session)
    with pytest.raises(RecordError, match=r"keep: no such folder; .*did you mean 'kept'\?$"):
        palpate.read_result(tmp_path / "keep")
