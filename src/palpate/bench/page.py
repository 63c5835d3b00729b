"""The guided way in the browser: one page, the same in every tab, that asks and shows.

Closing a tab loses nothing: all that is shown belongs to the server, and a new tab gets it.
"""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from queue import Empty, SimpleQueue
from threading import Event
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.bench.live_motion import LiveMotion
from palpate.bench.page_parts import (
    constants_html,
    intervals_svg,
    montage,
    question_html,
    said_html,
    state_html,
    steps_html,
    trace_svg,
    verdicts_html,
)
from palpate.bench.questions import (
    AT_REST,
    DEVICES,
    Dots,
    Pictures,
    Pose,
    Questions,
    Stopped,
    motion_about,
)
from palpate.errors import InputError
from palpate.figures import BLUE, HELD, ORANGE, best_direction
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    closest_points,
    ray_intersection,
    unit_normals,
)
from palpate.progress import Progress
from palpate.records import Estimate, Rig
from palpate.shapes import Indices, Vector3
from palpate.viewer import (
    draw_arrows,
    draw_camera,
    flat_face,
    light,
    look,
    open_server,
    rgb,
    stop_server,
    text_html,
)

# Time between two live pictures, and between two verdicts on them [s]; sentences that are kept.
_PAUSE, _JUDGED, _KEPT = 0.3, 1.0, 3
# Width of a column of the page [px]; length of the arrow over the object's size.
_COLUMN, _ARROW = 340, 0.15
_LIVE = "live"
_BODY, _AMBIENT = "#c9ccd2", 0.8


class Page(Questions):
    """A person in the browser.

    Parameters
    ----------
    name : str                      title of the page
    port : int or None              None: 8080, or the next free one
    say : callable                  what is told is said to it, too

    Raises
    ------
    InputError                      viser is not installed; no such port is free
    PalpateError                    this version of viser cannot be guarded
    """

    def __init__(self, name: str, *, port: int | None, on_message: Callable[[str], object]) -> None:
        self._server, self.address = open_server(name, port)
        self._on_message, self._messages = on_message, list[str]()
        self._stopped, self._estimates = Event(), list[Estimate]()
        self._rig: Rig | None = None
        self._look: Callable[[], Pictures] | None = None
        self._names: Sequence[str] = ()
        self._place: tuple[Vector3, Vector3] | None = None
        self._way: Sequence[Vector3] = ()
        self._outline: TriangleMesh | None = None
        self._rest: Pictures = ()
        self._motion: LiveMotion | None = None
        self._mesh: TriangleMesh | None = None
        self._toward = np.array([0.8, -0.5, 0.4])
        self._clicked: Callable[[int, bool], object] | None = None
        self._shown = self._judged = 0.0
        self._drawn: dict[str, Any] = {}
        self._lay_out(self._server.gui)
        light(self._server.scene)
        # From below, too: what holds an object is there.
        self._server.scene.add_light_ambient("/from below", intensity=_AMBIENT)
        self._server.on_client_connect(self._aim)
        self._server.scene.on_click()(lambda event: self._click(event, more=False))
        self._server.scene.on_click(modifier="shift")(lambda event: self._click(event, more=True))

    def _lay_out(self, gui: Any) -> None:
        """The columns: what is asked and found at the right, what the cameras see at the left."""
        gui.main_panel.set_width(_COLUMN)
        self._steps = gui.add_html(steps_html(DEVICES))
        self._question = gui.add_html("")
        self._answers = gui.add_folder(None)
        self._bar = gui.add_progress_bar(0.0, visible=False, animated=True)
        self._log = gui.add_html("")
        self._table = gui.add_html("")
        self._plots = gui.add_html("")
        self._stop = gui.add_button("Stop measuring", color="gray", hint="what is taken is kept")
        self._stop.on_click(lambda _: self._stopped.set())
        self._cameras = gui.add_panel()
        self._cameras.dock_left()
        self._cameras.set_width(_COLUMN)
        with self._cameras.add_tab("Cameras"):
            self._picture = gui.add_image(np.full((480, 640, 3), 240, np.uint8), format="jpeg")
            self._state = gui.add_html(text_html("No picture yet.", italic=True))
            self._verdicts = gui.add_html("")
            self._trace = gui.add_html("")

    def close(self) -> None:
        """End the page; open tabs lose their connection."""
        self._forget_motion()
        stop_server(self._server)

    def tell(self, text: str) -> None:
        """As in `Questions`."""
        self._on_message(text)
        self._messages = [*self._messages, text][-_KEPT:]
        self._log.content = said_html(self._messages)

    def choose(self, text: str, options: list[str]) -> str:
        """As in `Questions`; a button for each."""
        return self._answer(text, options)

    def wait(self, text: str) -> None:
        """As in `Questions`."""
        self._answer(text, ["Ready"])

    def ask(self, text: str, usual: str) -> str:
        """As in `Questions`; Enter answers, too."""
        with self._answers, self._server.gui.add_form(None) as form:
            field = self._server.gui.add_text("answer", usual)
        try:
            self._answer(text, ["OK"], form)
            return str(field.value).strip() or usual
        finally:
            form.remove()

    def face(
        self, mesh: TriangleMesh, faces: Mapping[str, Indices], ways: Sequence[str]
    ) -> tuple[Indices, str]:
        """As in `Questions`: a click chooses the flat face there, with the shift key one more; a
        button for each way."""
        held = next(iter(faces.values()), np.zeros(0, dtype=np.int64))

        def click(triangle: int, more: bool) -> None:
            nonlocal held
            face = flat_face(mesh, triangle)
            held = np.union1d(held, face) if more else face
            self.body(mesh, held)

        self._clicked = click
        self.body(mesh, held)
        if len(held):
            self._turn(_aslant(unit_normals(mesh)[held[0]]))
        try:
            while True:
                way = self._answer(
                    "How does it stand on the orange side? If it stands on another, click on that;"
                    " with shift on one more.",
                    ways,
                )
                if len(held):
                    return held, way
                self.tell("Nothing is marked yet: click on what is held")
        finally:
            self._clicked = None

    @contextmanager
    def working(self) -> Iterator[Progress]:
        """As in `Questions`."""

        def show_progress(text: str, share: float) -> None:
            self._question.content = text_html(f"{text} ...")
            self._bar.value = 100.0 * share

        self._bar.value, self._bar.visible = 0.0, True
        try:
            yield show_progress
        finally:
            self._question.content, self._bar.visible = "", False

    def step(self, name: str) -> None:
        """As in `Questions`."""
        self._steps.content = steps_html(name)

    def over(self, rig: Rig, mesh: TriangleMesh, drawing: Path) -> Pose | None:
        """As in `Questions`; its outline is over the pictures while it is dragged."""
        self.known(rig)
        self.body(mesh, np.zeros(0, dtype=np.int64))
        middle = 500.0 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
        handle = self._server.scene.add_transform_controls(
            "/handle", 0.6e3 * bounding_diagonal(mesh), position=tuple(middle), depth_test=False
        )

        def motion() -> Pose:
            turn = Rotation.from_quat(handle.wxyz, scalar_first=True).as_matrix()
            return motion_about(mesh, 1e-3 * (np.array(handle.position) - middle), turn)

        def drag(_: object) -> None:
            pose = motion()
            moved = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
            self._outline = TriangleMesh(moved, mesh.triangles)
            body = self._drawn["/body"]
            body.wxyz, body.position = handle.wxyz, tuple(1e3 * pose[:3, 3])

        self._outline = mesh
        handle.on_update(drag)
        try:
            question = "Does the outline lie on the object in the pictures? If not, drag it there."
            self._answer(question, ["It lies there"])
            live = motion()
            return None if np.allclose(live, np.eye(4), atol=1e-9) else live
        finally:
            self._outline = None
            handle.remove()

    def watch(self, cameras: Sequence[str], look: Callable[[], Pictures]) -> None:
        """As in `Questions`."""
        self._names, self._look = cameras, look

    def known(self, rig: Rig) -> None:
        """As in `Questions`."""
        self._rig, self._mesh = rig, None

    def see(
        self, pictures: Pictures, time: list[float], force: list[float], state: str, dots: Dots = ()
    ) -> None:
        """As in `Questions`, some times a second."""
        if self._stopped.is_set():
            raise Stopped
        self._follow(pictures, time, state)
        if self._show(pictures, state, dots):
            self._question.content = question_html(state.capitalize())
            moved = [] if self._motion is None else list(self._motion.trace)
            self._trace.content = trace_svg(time, force, moved)

    def _follow(self, pictures: Pictures, time: list[float], state: str) -> None:
        """Follow the motion near the tool, from the last pictures at rest."""
        if state == AT_REST:
            self._rest = pictures
            self._forget_motion()
        elif self._rest and self._place and self._rig is not None and self._mesh is not None:
            if self._motion is None:
                self._motion = LiveMotion(self._rig, self._mesh, self._rest, self._place)
            if time:
                self._motion.look(time[-1], pictures)

    def _forget_motion(self) -> None:
        if self._motion is not None:
            self._motion.close()
            self._motion = None

    def body(self, mesh: TriangleMesh, held: Indices) -> None:
        """As in `Questions`."""
        new = self._mesh is None or not np.array_equal(self._mesh.vertices, mesh.vertices)
        self._mesh = mesh
        marked = np.isin(np.arange(len(mesh.triangles)), held)
        for name, faces, colour in (
            ("/body", mesh.triangles[~marked], _BODY),
            ("/held", mesh.triangles[marked], HELD if self._clicked is None else ORANGE),
        ):
            self._forget(name)
            if len(faces):
                self._drawn[name] = self._server.scene.add_mesh_simple(
                    name, 1e3 * mesh.vertices, faces, color=rgb(colour), flat_shading=True
                )
        if new:
            if self._rig is not None:
                for camera in self._rig.cameras:
                    draw_camera(self._server.scene, camera, 1e3 * bounding_diagonal(mesh))
            self._turn(best_direction(unit_normals(mesh), np.array([0.0, 0.0, 1.0])))

    def place(self, point: Vector3, inward: Vector3, way: Sequence[Vector3] = ()) -> None:
        """As in `Questions`: an arrow at the object, a mark in the pictures, the way in both."""
        self._place, self._way = (point, inward), way
        self._forget("way")
        if self._mesh is None:
            return
        if way:
            points = 1e3 * np.stack([way[:-1], way[1:]], axis=1)
            self._drawn["way"] = self._server.scene.add_line_segments("/way", points, rgb(BLUE))
        size, end = 1e3 * bounding_diagonal(self._mesh), 1e3 * point
        start = end - _ARROW * size * inward
        scene = self._server.scene
        self._forget("arrow", "label")
        arrow = draw_arrows(scene, "/press", start[None], end[None], rgb(ORANGE), 1.2 * size)
        label = scene.add_label(
            "/press here", "press here", position=tuple(start), anchor="bottom-center"
        )
        self._drawn |= {"arrow": arrow, "label": label}
        self._turn(best_direction(unit_normals(self._mesh), -inward))

    def judged(self, estimate: Estimate) -> None:
        """As in `Questions`: a table, and the intervals over the pushes."""
        self._estimates.append(estimate)
        self._table.content = constants_html(estimate)
        self._plots.content = intervals_svg(self._estimates)

    def finish(self, text: str) -> None:
        """Show what was found until the person has seen it."""
        self._look, self._stop.visible = None, False
        self._stopped.clear()
        self._steps.content = steps_html("")
        self._forget("arrow", "label")
        self._answer(text, ["Close"])

    def _answer(self, text: str, labels: Sequence[str], form: Any = None) -> str:
        """Which button is pressed in any tab, or none where a form is sent off; until then there
        are live pictures."""
        answers: SimpleQueue[str] = SimpleQueue()
        self._question.content = question_html(text)
        shown: list[Any] = []
        with self._answers:
            for label in labels:
                colour = "gray" if shown else None
                shown.append(self._server.gui.add_button(label, color=colour))
                shown[-1].on_click(lambda _, label=label: answers.put(label))
        if form is not None:
            form.on_submit(lambda _: answers.put(""))
        try:
            while not self._stopped.is_set():
                with suppress(Empty):
                    return answers.get(timeout=_PAUSE)
                self._live()
            raise Stopped
        finally:
            self._question.content = ""
            for element in shown:
                element.remove()

    def _live(self) -> None:
        """Show what the cameras see just now; one that fails is asked for by who needs it."""
        if self._look is None:
            return
        try:
            self._show(self._look(), _LIVE)
        except InputError as error:
            self._state.content = text_html(str(error), italic=True)

    def _show(self, pictures: Pictures, state: str, dots: Dots = ()) -> bool:
        """Show pictures, if it is time for new ones."""
        now = time.monotonic()
        if not self._names or now < self._shown + _PAUSE:
            return False
        self._shown = now
        self._picture.image = montage(
            self._names,
            pictures,
            self._rig,
            target=self._place,
            way=self._way,
            outline=self._outline,
            dots=dots,
        )
        ring = "" if self._place is None else "; the ring is where to press"
        self._state.content = state_html(state + ring)
        # Without the tool, and with time to spare.
        if state in (_LIVE, AT_REST) and now > self._judged + _JUDGED:
            self._judged = now
            self._verdicts.content = verdicts_html(self._names, pictures)
        return True

    def _forget(self, *names: str) -> None:
        for name in names:
            if name in self._drawn:
                self._drawn.pop(name).remove()

    def _turn(self, toward: Vector3) -> None:
        """Turn the view of all tabs to one side of the object."""
        self._toward = toward
        for client in self._server.get_clients().values():
            self._aim(client)

    def _aim(self, client: Any) -> None:
        if self._mesh is not None:
            look(client, self._mesh, self._toward)

    def _click(self, event: Any, *, more: bool) -> None:
        """A click on the object, while that is an answer."""
        if self._clicked is None or self._mesh is None:
            return
        origin, direction = 1e-3 * np.array(event.ray_origin), np.array(event.ray_direction)
        point = ray_intersection(self._mesh, origin, direction)
        if point is not None:
            self._clicked(int(closest_points(self._mesh, point[None]).triangle[0]), more)


def _aslant(normal: Vector3) -> Vector3:
    """A direction from which a face with this normal, and which way is up, can be seen."""
    toward = normal + np.array([0.6, -0.6, 0.2])
    return np.asarray(toward / np.linalg.norm(toward))
