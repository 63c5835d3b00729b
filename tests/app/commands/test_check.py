"""`palpate check`: the figures it prints, and the refusals of bad sessions."""

import pytest

from palpate.app.commands.check import ProbingFigures, expectation, probing_figures
from palpate.records import read_session


def test_figures_of_the_surface_and_the_support_are_printed(palpate, cube_session):
    code, out, err = palpate("check", cube_session)
    assert (code, err) == (0, "")
    assert "a [bold] cube" in out
    for text in ("218, 432", "40 x 40 x 40 mm", "64 cm^3", "96 cm^2", "72 triangles, 16 cm^2"):
        assert text in out
    assert "palpate fit` decides" in out


def test_figures_of_a_probing_have_their_closed_forms(cube_session):
    session = read_session(cube_session)
    figures = probing_figures(session, session.probings[0])
    # 218 vertices, 49 of them on the floor; one row is NaN.
    assert (figures.observed, figures.missing) == (218 - 49 - 1, 1)
    assert figures.median_displacement == pytest.approx(5e-4)
    assert figures.signal_to_noise == pytest.approx(5.0)
    # Two legs and a hypotenuse a triangle.
    assert figures.elements_per_radius == pytest.approx(0.006 / (0.04 / 6 * (2 + 2**0.5) / 3))
    # The four squares of 6.67 mm around a grid vertex: their diagonals pass it at 4.7 mm.
    assert figures.patch_triangles == 8
    # Everything free lies within eight radii (48 mm) of the top's centre.
    assert figures.near == figures.observed


def test_far_observations_promise_no_poisson_ratio():
    far = ProbingFigures("a", 9, 2.0, 5, 0, 0.01, 20.0, 19.0, 4)
    assert "next to nothing about Poisson's ratio" in expectation([far])
    near = ProbingFigures("a", 9, 0.5, 500, 0, 0.01, 2.0, 1.0, 400)
    text = expectation([near])
    assert "400 measured vectors lie within 8 contact radii" in text
    assert "below 3 sigma in 1 of 1 probings (a)" in text
    assert "smaller than an element in 1 probings" in text
    silent = ProbingFigures("a", 9, 2.0, 500, 0, 0.01, float("nan"), float("nan"), 400)
    assert "No standard deviations are given" in expectation([silent])


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
