"""The cameras' pictures over time, with the measured flow drawn on them."""

import threading
from typing import Any

import numpy as np

from palpate.viewer.drawings import camera_picture, frames
from palpate.viewer.markup import text_html
from palpate.viewer.panels.look import LookPanel
from palpate.viewer.stage import Stage

# Duration of each picture when played [s].
_PACE = 0.4
_MAX_MAGNIFICATION = 30


class PicturesPanel:
    """Controls of the picture sequence.

    Parameters
    ----------
    gui : GuiApi of viser           of the tab
    stage : Stage
    look : LookPanel                selects the probing
    """

    def __init__(self, gui: Any, stage: Stage, look: LookPanel) -> None:
        self._subject, self._look = stage.subject, look
        self._stop = threading.Event()
        rig = self._subject.rig
        if rig is None:
            self.text = gui.add_html(text_html("This session has no pictures.", italic=True))
            return
        self._cameras = [camera.name for camera in rig.cameras]
        self.camera = gui.add_dropdown("camera", self._cameras)
        self.frame = gui.add_slider("picture", 0, 1, 1, 0)
        self.magnification = gui.add_slider("flow drawn, times", 1, _MAX_MAGNIFICATION, 1, 5)
        self.play = gui.add_button("play")
        self.image: Any = None
        self._gui = gui
        self.text = gui.add_html("")
        for control in (self.camera, self.frame, self.magnification):
            control.on_update(lambda _: self.draw())
        self.play.on_click(lambda _: self._play())
        look.probing.on_update(lambda _: self._begin())
        self._begin()

    def _begin(self) -> None:
        """Reset the sequence after another probing was selected."""
        count = len(frames(self._subject.session, self._look.probing.value))
        self.frame.max = max(1, count - 1)
        self.frame.value = max(0, count - 1)
        self.draw()

    def draw(self) -> None:
        """Show the selected picture."""
        rig, probing = self._subject.rig, self._look.shown
        if rig is None or probing is None:
            return
        patterns = frames(self._subject.session, probing.name)
        if not patterns:
            self.text.content = text_html(f"{probing.name} has no pictures.", italic=True)
            return
        number = min(int(self.frame.value), len(patterns) - 1)
        last = number == len(patterns) - 1
        seen = camera_picture(
            self._subject.session, rig, self._cameras.index(self.camera.value), patterns[number],
            flow=probing if last else None, magnification=float(self.magnification.value),
        )  # fmt: skip
        if seen is None:
            self.text.content = text_html(f"{patterns[number]} cannot be read.", italic=True)
        elif self.image is None:
            self.image = self._gui.add_image(seen, format="jpeg")
        else:
            self.image.image = seen
        when = "at rest" if number == 0 else f"{number} of {len(patterns) - 1} under load"
        if seen is not None:
            drawn = last and np.isfinite(probing.displacement).all(axis=1).any()
            self.text.content = text_html(
                when + ("; arrows: measured displacement" if drawn else "")
            )

    def _play(self) -> None:
        """Play the pictures once."""
        for number in range(int(self.frame.max) + 1):
            if self._stop.wait(_PACE if number else 0.0):
                return
            self.frame.value = number
            self.draw()

    def close(self) -> None:
        """Stop playing after the tab was closed."""
        self._stop.set()
