"""The viewer's server: one port, with independent controls for each browser tab.

Only who has the address that was printed may connect: every user of this computer can reach its
ports, and every web page can have a browser on it do so.
"""

import hmac
import io
import re
import secrets
import socket
import threading
from contextlib import redirect_stdout
from dataclasses import replace
from http import HTTPStatus
from pathlib import Path
from typing import Any

import numpy as np

from palpate.errors import InputError, PalpateError
from palpate.geometry import ray_intersection
from palpate.optional_imports import late_import
from palpate.records import verdict_text
from palpate.viewer.panels import (
    InsidePanel,
    LookPanel,
    MaterialPanel,
    PicturesPanel,
    SettingPanel,
    TouchPanel,
)
from palpate.viewer.stage import Stage, text_html
from palpate.viewer.subject import BackgroundWork, Subject

# Accept connections from this computer only.
_HOST = "127.0.0.1"
# Names that a browser has for this computer, also at the near end of an ssh tunnel. Any other may
# be that of a web page, whose owner has it lead here (DNS rebinding).
_THIS_COMPUTER = re.compile(r"(localhost|127\.0\.0\.1|\[::1\])(:\d+)?", re.IGNORECASE)
_REFUSAL = "Open the whole address that the viewer printed.\n"


class Tab:
    """One browser tab: its controls and its scene.

    Parameters
    ----------
    client : ClientHandle of viser
    background : BackgroundWork     shared by all tabs
    """

    def __init__(self, client: Any, background: BackgroundWork) -> None:
        subject, gui = background.subject, client.gui
        self._background = background
        self._fitted = background.fitted
        self._drag_start = np.zeros(3)
        # `update` is called both by the background thread and by the one that opens the tab.
        self._updating = threading.Lock()
        self.stage = Stage(client, subject)
        gui.add_html(text_html(f"\n{heading(subject)}", bold=subject.session.name))
        tabs = gui.add_tab_group()
        with tabs.add_tab("Look"):
            self.look = LookPanel(gui, background, self.stage)
            if subject.modulus is not None:
                self.inside = InsidePanel(gui, self.stage, subject.modulus)
        with tabs.add_tab("Material"):
            self.material = MaterialPanel(gui, background, self.look)
            self._material_folder = gui.add_folder("constants")
        with tabs.add_tab("Touch"):
            self.touching = TouchPanel(gui, background, self.stage, self.look)
        with tabs.add_tab("Pictures"):
            self.pictures = PicturesPanel(gui, self.stage, self.look)
        with tabs.add_tab("Set up"):
            self.setting = SettingPanel(gui, self.stage, self.look)
        # Clicks are taken from the whole scene, not from the body: while a browser loads the
        # deformed body there is none to click on, and the ray is intersected here anyway.
        self.stage.scene.on_click()(self._clicked)
        self.stage.body.on_drag(self._dragged)
        self.look.draw()
        self._end_watch = background.on_change(self.update)
        self.update()

    def update(self) -> None:
        """Update the controls after the background work has completed something."""
        with self._updating:
            with self._material_folder:
                self.material.update()
            self.touching.update()
            if self._background.fitted is not self._fitted:
                self._fitted = self._background.fitted
                if self.touching.pressed is None:
                    self.look.draw()

    def _clicked(self, event: Any) -> None:
        """Handle a click on the object."""
        mesh = self.stage.shown_mesh
        point = ray_intersection(
            mesh, 1e-3 * np.array(event.ray_origin), np.array(event.ray_direction)
        )
        if point is None:
            return
        if self.setting.presses:
            self.touching.put(self.stage.at_rest(point))
        else:
            self.setting.clicked(self.stage.at_rest(point))

    async def _dragged(self, event: Any) -> None:
        """Handle dragging: the depth of the ball is the distance dragged."""
        if not self.setting.presses:
            return
        start, end = 1e-3 * np.array(event.start_position), 1e-3 * np.array(event.end_position)
        if event.phase == "start":
            self.touching.put(self.stage.at_rest(start))
            self._drag_start = start
        elif self.touching.pressed is not None:
            self.touching.deepen(float(np.linalg.norm(end - self._drag_start)))

    def close(self) -> None:
        """Release the tab's resources after it was closed."""
        self._end_watch()
        self.pictures.close()


class Viewer:
    """A running viewer; only who has its address can connect.

    Parameters
    ----------
    subject : Subject
    port : int or None              None: 8080, or the next free one
    cache : Path or None            folder in which what is computed of the body is kept

    Raises
    ------
    InputError                      viser is not installed; no such port is free
    PalpateError                    this version of viser cannot be guarded
    """

    def __init__(
        self, subject: Subject, *, port: int | None = None, cache: Path | None = None
    ) -> None:
        self.background = BackgroundWork(subject, cache)
        self.tabs: dict[int, Tab] = {}
        self._lock = threading.Lock()
        self._server, self.address = open_server(subject.session.name, port)
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._gone)
        self.background.start()

    def _connected(self, client: Any) -> None:
        tab = Tab(client, self.background)
        with self._lock:
            self.tabs[client.client_id] = tab

    def _gone(self, client: Any) -> None:
        with self._lock:
            tab = self.tabs.pop(client.client_id, None)
        if tab is not None:
            tab.close()

    def stop(self) -> None:
        """Stop the server; open tabs lose their connection."""
        stop_server(self._server)


def open_server(label: str, port: int | None) -> tuple[Any, str]:
    """Start a page on this computer, for who has its address.

    Parameters
    ----------
    label : str                     title of the page
    port : int or None              None: 8080, or the next free one

    Returns
    -------
    ViserServer
    str                             URL of the page, with the secret that lets in whoever has it

    Raises
    ------
    InputError                      viser is not installed; no such port is free
    PalpateError                    this version of viser cannot be guarded
    """
    token, chosen = secrets.token_hex(16), free_port(port)
    # Suppress the server's greeting in the command's output.
    with redirect_stdout(io.StringIO()):
        server = guarded_server(token, host=_HOST, port=chosen, label=label, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    server.scene.set_up_direction("+z")
    return server, f"http://{_HOST}:{server.get_port()}/{token}/"


def stop_server(server: Any) -> None:
    """Stop a server; open tabs lose their connection."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def free_port(wanted: int | None) -> int:
    """Find a free port.

    Parameters
    ----------
    wanted : int or None            None: the first free one from 8080 to 8179

    Returns
    -------
    int

    Raises
    ------
    InputError                      the port is in use or not permitted; none is free
    """
    first = 8080
    for port in [wanted] if wanted is not None else range(first, first + 100):
        with socket.socket() as trial:
            trial.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                trial.bind((_HOST, port))
                return port
            except (OSError, OverflowError) as error:
                why = error
    what = f"port {wanted}" if wanted is not None else f"any port from {first} to {first + 99}"
    raise InputError(f"{what} cannot be had ({why}); choose another with --port")


def heading(subject: Subject) -> str:
    """Heading of the page: "session", or the verdict of an estimate.

    Parameters
    ----------
    subject : Subject

    Returns
    -------
    str
    """
    estimate = subject.estimate
    if estimate is None:
        measured = [probing.displacement is not None for probing in subject.session.probings]
        return "session, fitted while you look" if measured and all(measured) else "session"
    return f"result: {verdict_text(estimate)}"


def is_admitted(request: Any, token: str) -> bool:
    """Whether a request is that of a person who was given the address.

    Parameters
    ----------
    request : Request of websockets     for a file or for a websocket
    token : str                         first part of the path of every admitted request

    Returns
    -------
    bool                                False also if the request is for a host that is not this
                                        computer, or comes from a page of another host or port
    """
    hosts, origins = (request.headers.get_all(name) for name in ("Host", "Origin"))
    given = request.path.partition("?")[0].removeprefix("/").partition("/")[0]
    return (
        len(hosts) == 1
        and _THIS_COMPUTER.fullmatch(hosts[0]) is not None
        and set(origins) <= {f"http://{hosts[0]}"}
        and hmac.compare_digest(given.encode(errors="surrogateescape"), token.encode())
    )


def guarded_server(token: str, **options: Any) -> Any:
    """Start a server of viser that answers 403 to every request that is not admitted.

    Parameters
    ----------
    token : str                     see `is_admitted`
    options                         of `viser.ViserServer`

    Returns
    -------
    ViserServer

    Raises
    ------
    InputError                      viser is not installed
    PalpateError                    this version of viser starts its server in another way
    """
    viser = late_import("viser", extra="view", purpose="the viewer")
    library: Any = late_import("websockets.asyncio.server", extra="view", purpose="the viewer")
    guarded = []
    # viser offers no check of requests, but hands one of its own to `serve`, before it listens.
    plain = library.serve

    def serve(*arguments: Any, process_request: Any, **others: Any) -> Any:
        def checked(connection: Any, request: Any) -> Any:
            if not is_admitted(request, token):
                return connection.respond(HTTPStatus.FORBIDDEN, _REFUSAL)
            path = request.path.removeprefix(f"/{token}")
            return process_request(connection, replace(request, path=path))

        guarded.append(checked)
        return plain(*arguments, process_request=checked, **others)

    library.serve = serve
    try:
        server = viser.ViserServer(**options)
    finally:
        library.serve = plain
    if not guarded:
        server.stop()
        raise PalpateError(
            f"viser {viser.__version__} does not let Palpate check who connects, so the viewer was"
            " not started; install viser 1.1"
        )
    return server
