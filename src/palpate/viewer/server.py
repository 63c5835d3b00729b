"""The viewer's server: one port, with independent controls for each browser tab."""

import io
import secrets
import socket
import threading
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from palpate.errors import InputError
from palpate.records import verdict_text
from palpate.viewer.background_work import BackgroundWork
from palpate.viewer.gate import guarded_server
from palpate.viewer.markup import text_html
from palpate.viewer.panels.look import LookPanel
from palpate.viewer.panels.material import MaterialPanel
from palpate.viewer.panels.pictures import PicturesPanel
from palpate.viewer.panels.setting import SettingPanel
from palpate.viewer.panels.touching import TouchPanel
from palpate.viewer.stage import Stage
from palpate.viewer.subject import Subject
from palpate.viewer.touch import ray_intersection

# Accept connections from this computer only.
_HOST = "127.0.0.1"


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
        self._token = secrets.token_hex(16)
        chosen = free_port(port)
        # Suppress the server's greeting in the command's output.
        with redirect_stdout(io.StringIO()):
            self._server = guarded_server(
                self._token, host=_HOST, port=chosen, label=subject.session.name, verbose=False
            )
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.scene.set_up_direction("+z")
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._gone)
        self.background.start()

    @property
    def address(self) -> str:
        """URL of the page, with the secret that lets in whoever has it."""
        return f"http://{_HOST}:{self._server.get_port()}/{self._token}/"

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
        with redirect_stdout(io.StringIO()):
            self._server.stop()


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
        measured = [one.displacement is not None for one in subject.session.probings]
        return "session, fitted while you look" if measured and all(measured) else "session"
    return f"result: {verdict_text(estimate)}"
