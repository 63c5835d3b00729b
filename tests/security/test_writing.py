"""What the viewer writes: nothing without a confirmation, and over no file of the user's."""

import numpy as np
import pytest
from security.fake_page import opened_tab

from palpate.records import read_session
from palpate.viewer import read_subject
from palpate.viewer.clicking import Draft, draft_files, write_draft
from palpate.viewer.subject import BackgroundWork


@pytest.fixture
def tab_and_page(cube_session):
    """A tab in which another support was set."""
    tab, page = opened_tab(BackgroundWork(read_subject(cube_session), None))
    tab.setting.draft = Draft().with_support(tab.stage.subject.session.held_triangles[:40])
    return tab, page


def files_of(folder):
    return {file.name: file.read_bytes() for file in folder.iterdir()}


def test_nothing_is_written_before_it_is_confirmed(tab_and_page, cube_session):
    tab, page = tab_and_page
    before = files_of(cube_session)
    page.button("write session.toml ...").click()
    (question,) = page.of_kind("modal")
    asked = page.controls[page.controls.index(question) + 1].content
    for name in ("session.toml", "support_triangles.txt"):
        assert str(cube_session / name) in asked
    assert files_of(cube_session) == before
    page.button("do not write").click()
    assert question.closed
    assert files_of(cube_session) == before
    assert tab.setting.draft.support is not None


def test_what_is_confirmed_is_written(tab_and_page, cube_session):
    tab, page = tab_and_page
    page.button("write session.toml ...").click()
    page.button("write").click()
    assert page.of_kind("modal")[0].closed
    assert len(read_session(cube_session).held_triangles) == 40
    assert "Written to" in tab.setting.text.content


def test_where_nothing_was_set_nothing_is_asked(tab_and_page):
    tab, page = tab_and_page
    tab.setting.draft = Draft()
    page.button("write session.toml ...").click()
    assert page.of_kind("modal") == []
    assert "nothing was set" in tab.setting.text.content


@pytest.mark.parametrize("kind", ["file", "link to nothing", "folder"])
def test_no_file_of_the_user_s_is_replaced(cube_session, kind):
    mine = cube_session / "support_triangles.txt"
    if kind == "file":
        mine.write_text("my notes")
    elif kind == "folder":
        mine.mkdir()
    else:
        mine.symlink_to(cube_session / "elsewhere")
    session = read_session(cube_session)
    held = session.held_triangles
    write_draft(session, Draft().with_support(held[:40]))
    first = (cube_session / "support_triangles_2.txt").read_bytes()
    again = read_session(cube_session)
    np.testing.assert_array_equal(again.held_triangles, held[:40])
    # Nor is the list that the session has had so far.
    write_draft(again, Draft().with_support(held[:30]))
    assert (cube_session / "support_triangles_2.txt").read_bytes() == first
    np.testing.assert_array_equal(read_session(cube_session).held_triangles, held[:30])
    assert draft_files(again, Draft().with_support(held))[0].name == "support_triangles_4.txt"
    assert kind != "file" or mine.read_text() == "my notes"
    assert kind != "link to nothing" or not (cube_session / "elsewhere").exists()
