"""The viewer's server: one port, a tab of a browser for everyone who looks."""

import io
import socket
import threading
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from palpate.errors import InputError
from palpate.optional_imports import late_import
from palpate.records import verdict_text
from palpate.viewer.panels import (
    LookPanel,
    MaterialPanel,
    PicturesPanel,
    SettingPanel,
    TouchPanel,
)
from palpate.viewer.stage import Stage
from palpate.viewer.subject import Subject
from palpate.viewer.touch import place_on_ray
from palpate.viewer.workshop import Workshop

# Nobody but this computer may look.
_HOST = "127.0.0.1"


class Tab:
    """One browser tab: its controls, and what they show.

    Parameters
    ----------
    client : ClientHandle of viser
    workshop : Workshop             which all tabs share
    """

    def __init__(self, client: Any, workshop: Workshop) -> None:
        subject, gui = workshop.subject, client.gui
        self._workshop = workshop
        self._fitted = workshop.fitted
        self._drag_start = np.zeros(3)
        # The workshop's thread and the one that opens the tab both say that something is ready.
        self._updating = threading.Lock()
        self.stage = Stage(client, subject)
        gui.add_markdown(f"**{subject.session.name}**  \n{heading(subject)}")
        tabs = gui.add_tab_group()
        with tabs.add_tab("Look"):
            self.look = LookPanel(gui, workshop, self.stage)
        with tabs.add_tab("Material"):
            self.material = MaterialPanel(gui, workshop, self.look)
            self._material_folder = gui.add_folder("constants")
        with tabs.add_tab("Touch"):
            self.touching = TouchPanel(gui, workshop, self.stage, self.look)
        with tabs.add_tab("Pictures"):
            self.pictures = PicturesPanel(gui, self.stage, self.look)
        with tabs.add_tab("Set up"):
            self.setting = SettingPanel(gui, self.stage, self.look)
        # Of the whole scene, not of the body: while a browser takes in how the body is deformed, it
        # has none that could be clicked, and the ray is followed here anyway.
        self.stage.scene.on_click()(self._clicked)
        self.stage.body.on_drag(self._dragged)
        self.look.draw()
        self._end_watch = workshop.on_change(self.update)
        self.update()

    def update(self) -> None:
        """Something is ready that was not."""
        with self._updating:
            with self._material_folder:
                self.material.update()
            self.touching.update()
            if self._workshop.fitted is not self._fitted:
                self._fitted = self._workshop.fitted
                if self.touching.pressed is None:
                    self.look.draw()

    def _clicked(self, event: Any) -> None:
        """A place of the object was clicked."""
        moved = self.stage.shown_mesh
        place = place_on_ray(
            moved, 1e-3 * np.array(event.ray_origin), np.array(event.ray_direction)
        )
        if place is None:
            return
        if self.setting.presses:
            self.touching.put(self.stage.at_rest(place))
        else:
            self.setting.clicked(self.stage.at_rest(place))

    async def _dragged(self, event: Any) -> None:
        """The object is dragged: the further, the deeper the ball."""
        if not self.setting.presses:
            return
        start, end = 1e-3 * np.array(event.start_position), 1e-3 * np.array(event.end_position)
        if event.phase == "start":
            self.touching.put(self.stage.at_rest(start))
            self._drag_start = start
        elif self.touching.pressed is not None:
            self.touching.deepen(float(np.linalg.norm(end - self._drag_start)))

    def close(self) -> None:
        """The tab is gone."""
        self._end_watch()
        self.pictures.close()


class Viewer:
    """A running viewer.

    Parameters
    ----------
    subject : Subject
    port : int or None              None: 8080, or the next that is free
    cache : Path or None            folder that keeps the surface integrals

    Raises
    ------
    InputError                      viser is not installed; no such port is free
    """

    def __init__(
        self, subject: Subject, *, port: int | None = None, cache: Path | None = None
    ) -> None:
        viser = late_import("viser", extra="view", purpose="the viewer")
        self.workshop = Workshop(subject, cache)
        self.tabs: dict[int, Tab] = {}
        self._lock = threading.Lock()
        chosen = free_port(port)
        # Its greeting would stand among what the command says.
        with redirect_stdout(io.StringIO()):
            self._server = viser.ViserServer(
                host=_HOST, port=chosen, label=subject.session.name, verbose=False
            )
        self._server.gui.configure_theme(show_logo=False, show_share_button=False)
        self._server.scene.set_up_direction("+z")
        self._server.on_client_connect(self._connected)
        self._server.on_client_disconnect(self._gone)
        self.workshop.start()

    @property
    def address(self) -> str:
        """What a browser opens."""
        return f"http://{_HOST}:{self._server.get_port()}"

    def _connected(self, client: Any) -> None:
        tab = Tab(client, self.workshop)
        with self._lock:
            self.tabs[client.client_id] = tab

    def _gone(self, client: Any) -> None:
        with self._lock:
            tab = self.tabs.pop(client.client_id, None)
        if tab is not None:
            tab.close()

    def stop(self) -> None:
        """End it; tabs that are open are told so by their browsers."""
        with redirect_stdout(io.StringIO()):
            self._server.stop()


def free_port(wanted: int | None) -> int:
    """A port that is free.

    Parameters
    ----------
    wanted : int or None            None: 8080 or one of the hundred behind it

    Returns
    -------
    int

    Raises
    ------
    InputError                      the wanted one is taken, or may not be had; all are taken
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
    """What is looked at: a session, or what an estimate says.

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
