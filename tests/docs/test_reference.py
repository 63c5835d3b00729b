"""Pages that are made from the code that reads the files."""

import re
from pathlib import Path

import make_reference
import pytest

from palpate.records.files.session import _PROBE_KEYS, _ROOT_KEYS

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def maker():
    return make_reference


def test_pages_are_current(maker):
    for path, make in maker.PAGES.items():
        assert path.read_text(encoding="utf-8") == make().rstrip() + "\n", "run `make reference`"


def test_every_check_of_keys_is_a_table_of_the_page(maker):
    assert maker.unlisted() == []


def test_a_table_that_nobody_named_is_found(maker, monkeypatch):
    monkeypatch.setattr(maker, "RIG", maker.RIG[:1])
    assert maker.unlisted() == ["palpate.records.programs.registry._camera"]


def test_the_page_has_every_key_of_a_session(maker):
    text = maker.session_page()
    for key in (*_ROOT_KEYS, *_PROBE_KEYS):
        assert f"| `{key}` |" in text
    # Where a key is read it says as what: units and words come from the reader itself.
    assert "| `force_direction` | number, or text with its unit (`deg`, `rad`) |" in text
    assert "default 0.00873 rad" in text


def test_a_key_without_words_is_no_page(maker, monkeypatch):
    words = {key: text for key, text in maker.WORDS.items() if key != "tolerance"}
    monkeypatch.setattr(maker, "WORDS", words)
    with pytest.raises(SystemExit, match="tolerance"):
        maker.session_page()


def test_every_program_is_there(maker):
    text = maker.programs_page()
    for program in maker.PROGRAMS:
        for kind in program.kinds:
            assert f"`{kind}`" in text


def test_the_site_lists_every_page():
    index = (ROOT / "docs" / "index.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^([a-z_]+(?:/[a-z_]+)*)$", index, flags=re.MULTILINE))
    rooms = {f"reference/{name}" for name in re.findall(
        r"^   (rooms/\w+)$", (ROOT / "docs/reference/api.md").read_text(), flags=re.MULTILINE
    )}  # fmt: skip
    pages = {
        path.relative_to(ROOT / "docs").with_suffix("").as_posix()
        for path in (ROOT / "docs").rglob("*.md")
    }
    assert pages - {"index"} == listed | rooms
    rooms_of_code = {
        path.name
        for path in (ROOT / "src" / "palpate").iterdir()
        if (path / "__init__.py").exists() and path.name != "app"
    }
    assert {name.rpartition("/")[2] for name in rooms} == rooms_of_code
