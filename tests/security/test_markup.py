"""Names that are markup, in the viewer and in the report: they are shown, and do nothing."""

import ast
import json
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from estimate_samples import sample_result
from security.conftest import NAMES, write_hostile_session
from security.fake_page import opened_tab

import palpate.bench
import palpate.viewer
from palpate.api import Result
from palpate.bench.page_parts import question_html, said_html, state_html, verdicts_html
from palpate.errors import InputError
from palpate.records import read_session
from palpate.viewer import read_subject
from palpate.viewer.clicking import Draft
from palpate.viewer.stage import text_html
from palpate.viewer.subject import BackgroundWork


class Shown(HTMLParser):
    """Tags with their attributes, and the text that a reader sees."""

    def __init__(self, html):
        super().__init__()
        self.tags, self.attributes, self.text = set(), set(), ""
        self.feed(html)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}

    def handle_data(self, data):
        self.text += data


@pytest.mark.parametrize("name", NAMES)
def test_the_viewer_shows_a_name_as_it_is(tmp_path, monkeypatch, name):
    def refuse(*_):
        raise InputError(name)

    monkeypatch.setattr("palpate.viewer.panels.write_draft", refuse)
    background = BackgroundWork(read_subject(write_hostile_session(tmp_path / "cube", name)), None)
    background.model_text = background.touch_text = name
    tab, page = opened_tab(background)
    tab.setting.draft = Draft().with_contact("n01", tab.stage.subject.session.mesh.vertices[0])
    tab.setting._show()
    shown = [Shown(html.content) for html in page.of_kind("html")]
    # Heading, model, touch.
    assert sum(name in text.text for text in shown) == 3
    page.button("write session.toml ...").click()
    page.button("write").click()
    shown += [Shown(html.content) for html in page.of_kind("html")]
    assert f"not written: {InputError(name)}" in Shown(tab.setting.text.content).text
    assert set().union(*(text.tags for text in shown)) <= {"div", "span", "b", "i"}
    assert set().union(*(text.attributes for text in shown)) == {"style"}


def test_every_text_of_a_page_is_made_by_few_functions():
    """viser takes Markdown and HTML unchecked: neither may come from anywhere else."""

    def is_safe(node):
        if isinstance(node, ast.IfExp):
            return is_safe(node.body) and is_safe(node.orelse)
        if isinstance(node, ast.Call):
            return getattr(node.func, "id", "").endswith(("_html", "_svg"))
        return isinstance(node, ast.Constant) and node.value == ""

    count = 0
    viewer, page = Path(palpate.viewer.__file__).parent, Path(palpate.bench.page.__file__)
    for file in (*viewer.rglob("*.py"), page):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            name = getattr(getattr(node, "func", None), "attr", "")
            assert name not in ("add_markdown", "add_notification"), file
            values = node.args if name == "add_html" else []
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "attr", "") == "content":
                values = [node.value]
            count += len(values)
            assert all(map(is_safe, values)), f"{file}: line {node.lineno}"
    assert count > 20


@pytest.mark.parametrize("name", NAMES)
def test_the_page_of_a_measurement_shows_a_name_as_it_is(name):
    picture = np.zeros((8, 8), dtype=np.uint8)
    for html in (
        question_html(name), said_html(["", name]), state_html(name),
        verdicts_html([name], (picture,)),
    ):  # fmt: skip
        shown = Shown(html)
        assert name in shown.text
        assert shown.tags <= {"div", "span", "b"}
        assert shown.attributes == {"style"}


def test_line_breaks_and_emphasis_are_ours():
    assert "<b>a&amp;b</b>\nc" in text_html("\nc", bold="a&b")
    assert "<i>c</i>" in text_html("c", italic=True)


@pytest.mark.parametrize("name", NAMES)
def test_the_report_shows_a_name_as_it_is(tmp_path, name):
    session = read_session(write_hostile_session(tmp_path / "cube", name))
    result = sample_result(session)
    result = replace(result, estimate=replace(result.estimate, notes=(name,)))
    folder = Result(session, result).save(tmp_path / "saved")
    text = (folder / "report.html").read_text(encoding="utf-8")
    # A browser reads `<!--<script>` in a script as the begin of another one, which never ends.
    island = text.partition('<script type="application/json" id="scene">')[2]
    island = island.partition("</script>")[0]
    assert "<" not in island
    assert [probing["name"] for probing in json.loads(island)["probings"]] == ["n01"]
    page = Shown(text.replace(island, ""))
    # Title, heading, note.
    assert page.text.count(name) == 3
    assert "b" not in page.tags
    assert "onerror" not in page.attributes
    assert text.count("<script") == 2
