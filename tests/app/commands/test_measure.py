"""Who answers `palpate measure`: a person in the browser, or at the terminal."""

from types import SimpleNamespace
from typing import ClassVar

import pytest

from palpate.app.commands import measure as command


class Page:
    """Stands for the page; remembers its port, and what it was told in the end."""

    address = "http://127.0.0.1:8080/token/"
    made: ClassVar[list["Page"]] = []

    def __init__(self, _name, *, port, on_message):
        self.port, self.ending, self.closed = port, "", False
        self.made.append(self)

    def finish(self, text):
        self.ending = text

    def close(self):
        self.closed = True


@pytest.fixture
def persons(monkeypatch):
    """Who was asked; nothing is measured."""
    asked = []
    monkeypatch.setattr(command, "Page", Page)
    monkeypatch.setattr(command, "read_bench", lambda _: SimpleNamespace(name="ball"))
    monkeypatch.setattr(command, "measure_live", lambda _, person, *a, **b: asked.append(person))
    monkeypatch.setattr(Page, "made", [])
    return asked


@pytest.mark.parametrize(
    ("options", "shown", "port"),
    [((), True, None), (("--port", 9000), True, 9000), (("--port", 9000), False, 9000)],
)
def test_the_page_is_asked_and_its_address_printed(
    palpate, persons, monkeypatch, options, shown, port
):
    monkeypatch.setattr(command, "_has_browser", lambda: shown)
    code, out, _ = palpate("measure", "bench", "--out", "ball", *options)
    assert (code, persons) == (0, Page.made)
    assert f"Open {Page.address} in a browser" in out
    assert [(person.port, person.ending, person.closed) for person in persons] == [
        (port, "Nothing was measured", True)
    ]


@pytest.mark.parametrize(("options", "shown"), [((), False), (("--terminal",), True)])
def test_the_terminal_is_asked(palpate, persons, monkeypatch, options, shown):
    monkeypatch.setattr(command, "_has_browser", lambda: shown)
    code, out, _ = palpate("measure", "bench", "--out", "ball", *options)
    assert (code, Page.made, "Open" in out) == (0, [], False)
    assert [type(person) for person in persons] == [command._Terminal]


def test_a_port_at_the_terminal_is_refused(palpate, persons):
    code, _, err = palpate("measure", "bench", "--out", "ball", "--terminal", "--port", 80)
    assert (code, persons) == (2, [])
    assert "leave it or --terminal out" in " ".join(err.split())


def test_nobody_sits_where_there_is_no_terminal(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: False))
    assert not command._has_browser()
    monkeypatch.setattr("sys.stdin", SimpleNamespace(isatty=lambda: True))
    assert command._has_browser()
    monkeypatch.delenv("DISPLAY")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    assert not command._has_browser()
