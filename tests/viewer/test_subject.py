import socket
from dataclasses import replace

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from estimate_samples import sample_result
from pipeline.picture_session import given_and_measured, measured_motion
from surfaces import box

from palpate.api import Result
from palpate.errors import InputError, PalpateError, RecordError
from palpate.geometry import write_mesh
from palpate.pipeline import keep_motion
from palpate.records import (
    Status,
    read_session,
    record_inputs,
    result_folder,
    session_files,
)
from palpate.viewer import read_subject
from palpate.viewer.server import free_port, heading
from palpate.viewer.stage import FIELDS, RESIDUAL, coloured_field, colours_of, linear_light
from palpate.viewer.subject import Subject, shown_probings


def test_a_session_shows_what_was_measured_and_no_more(cube_session):
    subject = read_subject(cube_session)
    (shown,) = shown_probings(subject)
    known = [coloured_field(shown, what) is not None for what in FIELDS]
    # Measured, its strain and its sigmas; nothing was fitted.
    assert known == [True, False, False, True, True, False]
    field = coloured_field(shown, FIELDS[0])
    # Every measured point of the cube moves by 0.5 mm: 3, 4, 5.
    np.testing.assert_allclose(field.values, 0.5, rtol=1e-12)
    assert len(field.values) == np.isfinite(shown.displacement).all(axis=1).sum()


def test_a_result_shows_residuals_in_sigmas(cube_session, tmp_path):
    session = read_session(cube_session)
    folder = Result(session, sample_result(session)).save(tmp_path / "result")
    subject = read_subject(folder)
    (shown,) = shown_probings(subject)
    shown = replace(shown, sigma=np.full(shown.points.shape, 1e-4))
    # Half of (3, 0, -4) tenths of a millimetre is left, sigma is one tenth.
    expected = np.sqrt((1.5**2 + 2.0**2) / 3.0)
    np.testing.assert_allclose(coloured_field(shown, RESIDUAL).values, expected, rtol=1e-9)


def test_a_result_shows_the_motion_that_it_keeps_of_the_same_pictures(cube_session, tmp_path):
    given, measured = given_and_measured(cube_session)
    saved = Result(measured, sample_result(measured)).save(tmp_path / "saved")
    with result_folder(tmp_path / "kept", kind="fit") as folder:
        for name in ("estimate.json", "surface.npz"):
            (folder / name).write_bytes((saved / name).read_bytes())
        record_inputs(folder, session_files(cube_session))
        keep_motion(folder, given, {"n01": measured_motion(given, given.probings[0])})
    (seen,) = read_subject(tmp_path / "kept").session.probings
    (expected,) = measured.probings
    np.testing.assert_array_equal(
        seen.displacement.displacement, expected.displacement.displacement
    )
    (cube_session / "loaded_c0.png").write_bytes(b"another picture")
    (seen,) = read_subject(tmp_path / "kept").session.probings
    assert seen.displacement is None


def test_the_heading_has_no_number_of_what_the_data_do_not_determine(cube_session):
    session = read_session(cube_session)
    plain = sample_result(session).estimate
    known = {"shear_modulus": False, "poisson_ratio": False, "young_modulus": True}
    estimate = replace(plain, identifiable=known, status=Status.from_identifiable(known))
    text = heading(Subject(session, estimate, None, None))
    assert text.startswith("result: Only Young's modulus is determined")
    assert "E = " in text
    assert "nu = " not in text
    assert estimate.status.value not in text
    assert "nu = " in heading(Subject(session, plain, None, None))


def test_a_result_whose_session_changed_is_refused(cube_session, tmp_path):
    session = read_session(cube_session)
    folder = Result(session, sample_result(session)).save(tmp_path / "result")
    write_mesh(cube_session / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=4))
    with pytest.raises(PalpateError, match="another mesh"):
        read_subject(folder)
    (cube_session / "session.toml").unlink()
    with pytest.raises(RecordError, match="--session"):
        read_subject(folder)


def test_colours_end_where_the_scale_ends():
    colours = colours_of(np.array([0.0, 0.5, 1.0, 7.0, np.nan]), 1.0, "viridis")
    assert colours[2].tolist() == colours[3].tolist() == [253, 231, 37]
    assert colours[0].tolist() == colours[4].tolist() == [68, 1, 84]


def test_light_is_that_of_the_standard():
    # IEC 61966-2-1: middle grey of the screen is 21.4 % of the light.
    light = linear_light(np.array([[0.0, 0.5, 1.0]]))
    np.testing.assert_allclose(light, [[0.0, 0.21404, 1.0]], atol=1e-5)


def test_a_port_that_is_taken_is_said():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(InputError, match="--port"):
            free_port(port)
        assert free_port(None) != port
