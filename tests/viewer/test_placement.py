import numpy as np
import pytest
from surfaces import box

from palpate.errors import InputError, PalpateError
from palpate.records import read_session
from palpate.viewer.placement import Draft, flat_face, triangles_near, write_draft


@pytest.fixture
def opened(cube_session):
    return read_session(cube_session)


def bottom(mesh):
    return np.flatnonzero((mesh.vertices[mesh.triangles][:, :, 2] == 0.0).all(axis=1))


def test_a_face_of_a_box_ends_at_its_edges():
    mesh = box(size=(0.04, 0.04, 0.04), cells=6)
    for triangle in (0, 100, 300):
        face = flat_face(mesh, triangle)
        corners = mesh.vertices[mesh.triangles[face]].reshape(-1, 3)
        # Six by six squares of two triangles, in one plane.
        assert len(face) == 72
        assert np.ptp(corners, axis=0).min() == 0.0


def test_near_is_a_ball():
    mesh = box(size=(0.04, 0.04, 0.04), cells=6)
    found = triangles_near(mesh, np.array([0.02, 0.02, 0.04]), 0.01)
    middle = mesh.vertices[mesh.triangles].mean(axis=1)
    inside = np.linalg.norm(middle - [0.02, 0.02, 0.04], axis=1) <= 0.01
    assert 0 < len(found) == inside.sum()


def test_what_was_set_is_read_back_and_the_rest_stays(opened):
    text = opened.path.read_text().replace("[support]", "# a comment of a person\n[support]")
    opened.path.write_text(text)
    held = bottom(opened.mesh)[:40]
    draft = Draft().with_support(held).with_contact("n01", np.array([0.01, 0.02, 0.04]))
    write_draft(opened, draft)
    again = read_session(opened.path)
    assert again.held_triangles.tolist() == held.tolist()
    np.testing.assert_allclose(again.probings[0].contact.point, [0.01, 0.02, 0.04])
    assert again.probings[0].contact.radius == opened.probings[0].contact.radius
    written = opened.path.read_text()
    assert "# a comment of a person" in written
    kept = [line for line in text.splitlines() if "plane" not in line and "contact" not in line]
    assert [line for line in kept if line not in written.splitlines()] == []


def test_lengths_are_written_in_the_session_s_unit(opened):
    # The same numbers in millimetres: a cube of 40 micrometres, its contact scaled along.
    opened.path.write_text(opened.path.read_text().replace('"m"', '"mm"').replace("1e-6", "1e-4"))
    small = read_session(opened.path, observations=False)
    write_draft(small, Draft().with_contact("n01", np.array([1e-5, 2e-5, 4e-5])))
    assert "point = [0.01, 0.02, 0.04]" in opened.path.read_text()


def test_a_session_that_could_not_be_read_is_not_written(opened):
    before = opened.path.read_text()
    whole = np.arange(len(opened.mesh.triangles))
    with pytest.raises(PalpateError, match="whole surface"):
        write_draft(opened, Draft().with_support(whole))
    assert opened.path.read_text() == before
    assert not (opened.path.parent / "support_triangles.txt").exists()


def test_nothing_set_is_said(opened):
    with pytest.raises(InputError, match="nothing was set"):
        write_draft(opened, Draft())


def test_several_supports_are_left_to_their_author(opened):
    text = opened.path.read_text().replace("[support]", "[[support]]")
    again = text[text.index("[[support]]") : text.index("[[probe]]")]
    opened.path.write_text(text.replace("[[probe]]", again + "[[probe]]", 1))
    with pytest.raises(InputError, match="2 supports"):
        write_draft(opened, Draft().with_support(bottom(opened.mesh)))
