"""Who gets into the viewer: a real server, asked by strangers and by its owner."""

import http.client
import re
from types import SimpleNamespace

import pytest

viser = pytest.importorskip("viser", reason="needs viser, the extra `view`, which is not installed")

from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402

from palpate.bench import Page  # noqa: E402
from palpate.errors import PalpateError  # noqa: E402
from palpate.viewer.server import guarded_server  # noqa: E402


class Address:
    """The parts of a viewer's address."""

    def __init__(self, address: str) -> None:
        match = re.fullmatch(r"http://(127\.0\.0\.1):(\d+)/([0-9a-f]{32})/", address)
        assert match, address
        self.host, self.port, self.token = match[1], int(match[2]), match[3]
        self.name = f"{self.host}:{self.port}"
        self.path = f"/{self.token}/"


@pytest.fixture
def address(viewer):
    return Address(viewer.address)


def answer(address, path, headers=()):
    """Status and content of what the server answers; `headers` as they are, none besides."""
    connection = http.client.HTTPConnection(address.host, address.port, timeout=10)
    connection.putrequest("GET", path, skip_host=True, skip_accept_encoding=True)
    for name, value in headers or [("Host", address.name)]:
        connection.putheader(name, value)
    connection.endheaders()
    response = connection.getresponse()
    content = response.read()
    connection.close()
    return response.status, content


def first_message(address, path, **headers):
    """What a websocket gets first, or the status with which it is refused."""
    try:
        with connect(
            f"ws://{address.name}{path}", subprotocols=[f"viser-v{viser.__version__}"],
            additional_headers=headers, open_timeout=10, proxy=None,
        ) as connection:  # fmt: skip
            return connection.recv(timeout=10)
    except InvalidStatus as error:
        return error.response.status_code


def wrong_paths(token):
    """What strangers may try: nothing, another token, the right one where it does not belong."""
    other = token[:-1] + ("0" if token[-1] != "0" else "1")
    return (
        "/", "/index.html", f"/{other}/", f"/{token[:-1]}/", f"/{token}0/", f"//{token}/",
        f"/?token={token}", f"/x/{token}/", f"/{token.upper()}x/", "/%2e%2e/", "/\udcff/",
    )  # fmt: skip


def test_a_stranger_gets_403_and_nothing_of_the_session(address, monkeypatch):
    # As a stranger's program, which sends bytes that no browser would.
    monkeypatch.setattr(
        http.client.HTTPConnection, "_encode_request",
        lambda _, line: line.encode("utf-8", "surrogateescape"),
    )  # fmt: skip
    for path in wrong_paths(address.token):
        status, content = answer(address, path)
        assert (path, status, len(content) < 100) == (path, 403, True)


@pytest.mark.parametrize("path", ["", "index.html", "?websocket=ws://127.0.0.1:8080"])
def test_the_owner_gets_the_page(address, path):
    status, content = answer(address, address.path + path)
    assert status == 200
    assert b"<!doctype html>" in content[:100]


@pytest.mark.parametrize("file", ["nothing.js", "../../__init__.py", "%2e%2e/%2e%2e/__init__.py"])
def test_the_owner_gets_no_other_file(address, file):
    assert answer(address, address.path + file)[0] == 404


@pytest.mark.parametrize("host", ["localhost:9000", "127.0.0.1:9000", "[::1]:8080", "localhost"])
def test_an_ssh_tunnel_may_have_any_port(address, host):
    for origin in ((), (("Origin", f"http://{host}"),)):
        assert answer(address, address.path, [("Host", host), *origin])[0] == 200


@pytest.mark.parametrize(
    "host",
    [
        "rebound.example", "rebound.example:8080", "127.0.0.1.rebound.example", "localhost.example",
        "a@localhost", "localhost:8080@a", "0.0.0.0:8080", "127.0.0.1:", "[", "",
    ],
)  # fmt: skip
def test_another_host_is_refused_even_with_the_token(address, host):
    assert answer(address, address.path, [("Host", host)])[0] == 403


def test_no_host_and_two_hosts_are_refused(address):
    assert answer(address, address.path, [("Accept", "*/*")])[0] == 403
    both = [("Host", address.name), ("Host", "rebound.example")]
    assert answer(address, address.path, both)[0] == 403


def test_a_page_of_another_origin_is_refused_even_with_the_token(address):
    name = address.name
    for origin in (
        "http://evil.example",
        "null",
        f"https://{name}",
        f"http://{name}0",
        "http://localhost:1",
    ):
        assert answer(address, address.path, [("Host", name), ("Origin", origin)])[0] == 403
        assert first_message(address, address.path, Origin=origin) == 403


def test_a_websocket_needs_the_token(address):
    for path in ("/", "", f"/?token={address.token}", f"/{'0' * 32}/"):
        assert first_message(address, path) == 403
        assert first_message(address, path, Origin=f"http://{address.name}") == 403


# As viser's client asks, which leaves the last slash away.
@pytest.mark.parametrize("end", ["", "/"])
def test_the_owner_s_websocket_gets_the_scene(address, end):
    origin = f"http://{address.name}"
    message = first_message(address, f"/{address.token}{end}", Origin=origin)
    assert isinstance(message, bytes)
    assert len(message) > 16


def test_every_viewer_has_a_token_of_its_own(viewer):
    from palpate.viewer import Viewer  # noqa: PLC0415

    second = Viewer(viewer.background.subject)
    try:
        assert Address(second.address).token != Address(viewer.address).token
        assert answer(Address(second.address), Address(viewer.address).path)[0] == 403
    finally:
        second.stop()


def test_the_page_of_a_measurement_is_guarded_alike():
    page = Page("ball", port=None, on_message=lambda _: None)
    try:
        here = Address(page.address)
        assert [answer(here, path)[0] for path in ("/", f"/{'0' * 32}/")] == [403, 403]
        assert first_message(here, "/") == 403
        assert first_message(here, here.path, Origin="http://evil.example") == 403
        assert answer(here, here.path)[0] == 200
        assert isinstance(first_message(here, here.path, Origin=f"http://{here.name}"), bytes)
    finally:
        page.close()


def test_a_viser_that_cannot_be_guarded_is_stopped(monkeypatch):
    """Another version may listen in another way: then no viewer is better than an open one."""
    stopped = []
    other = SimpleNamespace(stop=lambda: stopped.append(True))
    monkeypatch.setattr(viser, "ViserServer", lambda **_: other)
    with pytest.raises(PalpateError, match="does not let Palpate check who connects"):
        guarded_server("token", port=0)
    assert stopped == [True]
