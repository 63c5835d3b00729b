"""What is said about sessions that are possible but more likely a mistake."""

from pathlib import Path

import numpy as np
import pytest
from cube_session import write_cube_session
from surfaces import box

from palpate.geometry import closest_points
from palpate.records import Contact, DisplacementField, Probing, Session, read_session
from palpate.records.plausibility import plausibility_notes


def _notes(thickness: float) -> str:
    mesh = box((0.1, thickness, 0.05), (20, 1, 10))
    held = np.flatnonzero(np.isclose(mesh.vertices[mesh.triangles][:, :, 2], 0.0).all(axis=1))
    points = np.array([[0.05, 0.0, 0.05]])
    surface = closest_points(mesh, points)
    field = DisplacementField(points, np.full((1, 3), 1e-4), None, None, surface, "")
    contact = Contact(np.array([0.05, 0.0, 0.03]), 0.005, "smooth")
    probing = Probing("n", contact, np.array([0.0, 1.0, 0.0]), None, None, None, field, None)
    session = Session("s", Path(), mesh, held, (probing,), None, None, None, ())
    return " ".join(plausibility_notes(session))


def test_a_plate_too_thin_for_its_triangles_is_noted() -> None:
    """Edges of 5 to 7 mm."""
    text = _notes(0.002)
    assert "2 mm thin" in text
    assert "bending" in text
    # 5.7 mm on average: (5.7 / (1.7 * 2))^2 times as many triangles.
    wanted = float(text.split("about ")[1].split(" vertices")[0])
    assert wanted == pytest.approx(21 * 11 * 2 * (5.7 / 3.4) ** 2, rel=0.2)


def test_a_plate_as_thick_as_its_triangles_is_not() -> None:
    assert "bending" not in _notes(0.005)


def _cube_notes(folder: Path, change=lambda rows: rows, **said: str) -> str:
    """Notes on the cube of `cube_session`, its session and its displacements changed."""
    session = write_cube_session(folder / "cube") / "session.toml"
    text = session.read_text()
    for old, new in said.items():
        assert f"{old} = " in text
        text = text.replace(f"{old} = ", f"{new}{old} = ", 1)
    session.write_text(text)
    file = folder / "cube" / "n01.csv"
    head = file.read_text().splitlines()[0]
    rows = change(np.loadtxt(file, delimiter=",", skiprows=1))
    np.savetxt(file, rows, delimiter=",", header=head, comments="")
    return " ".join(read_session(session).notes)


def test_a_good_cube_is_not_doubted(tmp_path: Path) -> None:
    assert _cube_notes(tmp_path) == ""


def test_a_surface_that_moves_against_the_force_is_noted(tmp_path: Path) -> None:
    notes = _cube_notes(tmp_path, lambda rows: rows * [1, 1, 1, -1, -1, -1, 1])
    assert "moved against the force" in notes


def test_a_motion_within_its_noise_is_not_against_the_force(tmp_path: Path) -> None:
    notes = _cube_notes(tmp_path, lambda rows: rows * [1, 1, 1, -0.01, -0.01, -0.01, 1])
    assert "against the force" not in notes


def test_a_support_that_slips_is_noted(tmp_path: Path) -> None:
    def change(rows: np.ndarray) -> np.ndarray:
        foot = rows[1:20].copy()
        foot[:, 2] = 0.0
        return np.vstack([rows, foot])

    assert "points on the support moved by 0.0005 m" in _cube_notes(tmp_path, change)


def test_a_support_that_is_most_of_the_surface_is_noted(tmp_path: Path) -> None:
    said = "box = { min = [-1, -1, -1], max = [1, 1, 0.035] }\n"
    assert "The support is 72.2 % of the surface" in _cube_notes(tmp_path, plane=said)


def test_a_contact_point_off_the_surface_is_noted(tmp_path: Path) -> None:
    session = write_cube_session(tmp_path / "cube") / "session.toml"
    session.write_text(session.read_text().replace("0.02, 0.04]", "0.02, 0.045]"))
    assert "the contact point is 0.005 m off the surface" in " ".join(read_session(session).notes)
