"""What is computed of a body before anything is measured on it: its fits find it."""

from pathlib import Path

import numpy as np
import pytest
from cube_session import cube_session as cube_session
from surfaces import box

from palpate.bem import CentredSystem, reduced_model
from palpate.bem.compressed import choice
from palpate.geometry import write_mesh
from palpate.pipeline import fit_session, prepare_body
from palpate.records import Session, read_session

KINDS = {
    "radius": ("", ""),
    "tool": (
        'radius = 0.006, profile = "smooth"',
        'tool = "sphere", tool_radius = 0.006, friction = "slides"',
    ),
    "springs": ("tolerance = 1e-6 }", "tolerance = 1e-6 }\nstiffness = 1e9"),
}


@pytest.fixture
def session(cube_session: Path, request: pytest.FixtureRequest) -> Session:
    """A coarse cube with the contact, and on the support, of this kind."""
    write_mesh(cube_session / "mesh.ply", box(size=(0.04, 0.04, 0.04), cells=4))
    file = cube_session / "session.toml"
    file.write_text(file.read_text().replace(*KINDS[request.param]))
    points = read_session(cube_session).mesh.vertices
    rows = points[points[:, 2] > 0.0]
    # Under the tool it goes down, and the more so, the higher above the support.
    near = np.exp(-(((rows - [0.02, 0.02, 0.04]) / 0.02) ** 2).sum(axis=1))
    moved = np.outer(-4e-4 * rows[:, 2] / 0.04 - 1e-3 * near, [0.0, 0.0, 1.0])
    table = np.hstack([rows, moved, np.full((len(rows), 1), 1e-4)])
    np.savetxt(
        cube_session / "n01.csv", table, delimiter=",", header="x,y,z,ux,uy,uz,sigma", comments=""
    )
    return read_session(cube_session)


@pytest.fixture
def factorised(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Sizes of the systems that are factorised."""
    sizes: list[int] = []

    def seen(self, compute=CentredSystem._compute):
        sizes.append(self.system.size)
        return compute(self)

    monkeypatch.setattr(CentredSystem, "_compute", seen)
    return sizes


@pytest.mark.slow
@pytest.mark.parametrize("session", ["radius"], indirect=True)
def test_reduced_models_are_found_as_well(session, tmp_path, monkeypatch):
    def computed(*_):
        raise AssertionError("computed again")

    prepare_body(session, cache=tmp_path / "cache")
    monkeypatch.setattr(reduced_model, "_krylov_model", computed)
    assert fit_session(session, cache=tmp_path / "cache").estimate.shear_modulus.value > 0.0


# The graded mesh alone is left where its loads are not known before the fit.
@pytest.mark.parametrize(
    ("session", "left"),
    [
        ("radius", 0),
        pytest.param("tool", 1, marks=pytest.mark.slow),
        pytest.param("springs", 0, marks=pytest.mark.slow),
    ],
    indirect=["session"],
)
def test_a_fit_finds_all_that_does_not_depend_on_what_was_measured(
    session, left, factorised, tmp_path
):
    plain = fit_session(session).estimate
    expected = list(factorised)
    factorised.clear()
    prepare_body(session, cache=tmp_path / "cache")
    assert factorised == expected[: len(expected) - left]
    factorised.clear()
    found = fit_session(session, cache=tmp_path / "cache").estimate
    assert factorised == expected[len(expected) - left :]
    assert found.shear_modulus == plain.shear_modulus
    assert found.poisson_ratio == plain.poisson_ratio


@pytest.mark.slow
@pytest.mark.parametrize("session", ["radius"], indirect=True)
def test_nothing_is_kept_of_a_body_that_is_solved_compressed(session, tmp_path, monkeypatch):
    def solved(*_, **__):
        raise AssertionError("solved in vain")

    monkeypatch.setattr(choice, "LARGEST_DENSE", 0)
    monkeypatch.setattr(reduced_model, "reduced_basis", solved)
    prepare_body(session, cache=tmp_path / "cache")
    assert not (tmp_path / "cache").exists()
