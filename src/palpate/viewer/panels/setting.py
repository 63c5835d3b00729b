"""Controls for setting support and contacts by clicking, and writing them to session.toml."""

from typing import Any

import numpy as np

from palpate.errors import PalpateError
from palpate.geometry import closest_points
from palpate.shapes import Vector3
from palpate.viewer.markup import text_html
from palpate.viewer.panels.look import LookPanel
from palpate.viewer.placement import Draft, draft_files, flat_face, triangles_near, write_draft
from palpate.viewer.stage import Stage

PRESS, CONTACT, FACE, HOLD, FREE = WHAT = (
    "presses the object", "sets the contact of the probing", "holds the flat face",
    "holds what is near", "frees what is near",
)  # fmt: skip
# Initial radius of "near", as a fraction of the object's size.
_NEAR = 0.06


class SettingPanel:
    """Choice of what a click does, and buttons to write or discard the changes.

    Parameters
    ----------
    gui : GuiApi of viser           of the tab
    stage : Stage
    look : LookPanel                selects the probing whose contact is set
    """

    def __init__(self, gui: Any, stage: Stage, look: LookPanel) -> None:
        self._gui, self._stage, self._look = gui, stage, look
        self.draft = Draft()
        self.click = gui.add_dropdown("a click", WHAT)
        size = stage.size
        self.near = gui.add_slider(
            "near is, mm", float(f"{0.01 * size:.2g}"), float(f"{0.3 * size:.2g}"),
            float(f"{0.005 * size:.2g}"), float(f"{_NEAR * size:.2g}"),
        )  # fmt: skip
        self.text = gui.add_html("")
        write = gui.add_button("write session.toml ...")
        forget = gui.add_button("forget what was set")
        write.on_click(lambda _: self.ask_to_write())
        forget.on_click(lambda _: self._forget())

    @property
    def presses(self) -> bool:
        """Whether a click presses the object."""
        return bool(self.click.value == PRESS)

    def clicked(self, point: Vector3) -> None:
        """Apply a click at a point of the surface at rest [m]."""
        session, what = self._stage.subject.session, self.click.value
        place = closest_points(session.mesh, point[None])
        if what == CONTACT:
            self.draft = self.draft.with_contact(self._look.probing.value, place.position[0])
        else:
            held = self.draft.support
            held = session.held_triangles if held is None else held
            near = triangles_near(session.mesh, place.position[0], 1e-3 * float(self.near.value))
            near = np.append(near, place.triangle[0])
            if what == FACE:
                held = flat_face(session.mesh, int(place.triangle[0]))
            elif what == HOLD:
                held = np.union1d(held, near)
            else:
                held = np.setdiff1d(held, near)
            self.draft = self.draft.with_support(held)
        self._show()

    def _show(self) -> None:
        session, draft = self._stage.subject.session, self.draft
        with self._stage.lock:
            self._stage.mark_support(draft.support)
            self._stage.draw_marks(draft.contacts)
            self._look.draw()
        lines = []
        if draft.support is not None:
            count = len(session.mesh.triangles)
            lines.append(f"support: {len(draft.support)} of {count} triangles")
        for name, point in draft.contacts.items():
            here = ", ".join(f"{x / session.metres_per_unit:.4g}" for x in point)
            lines.append(f"contact of {name}: [{here}]")
        self.text.content = text_html("\n".join(lines)) if lines else ""

    def ask_to_write(self) -> None:
        """Ask whether the changes are to be written, naming the files."""
        try:
            *new, changed = draft_files(self._stage.subject.session, self.draft)
        except PalpateError as error:
            self.text.content = text_html(str(error), italic=True)
            return
        with self._gui.add_modal("Write what was set?") as question:
            what = [f"{changed} is changed.", *(f"{file} is new." for file in new)]
            self._gui.add_html(text_html("\n".join(what)))
            yes, no = self._gui.add_button("write"), self._gui.add_button("do not write")

        def write() -> None:
            question.close()
            self._write()

        yes.on_click(lambda _: write())
        no.on_click(lambda _: question.close())

    def _write(self) -> None:
        try:
            written = write_draft(self._stage.subject.session, self.draft)
        except PalpateError as error:
            self.text.content = text_html(f"not written: {error}", italic=True)
            return
        self.draft = Draft()
        self.text.content = text_html(
            f"Written to {written.path}. Fit the session again, and open it anew."
        )

    def _forget(self) -> None:
        self.draft = Draft()
        self._show()
