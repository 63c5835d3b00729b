"""`palpate check`: the figures it prints, and the refusals of bad sessions."""


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
