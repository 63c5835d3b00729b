"""Background computations of the viewer, shared by all tabs: the fit and Green's functions."""

import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from palpate.errors import PalpateError
from palpate.estimation import FitResult
from palpate.pipeline import FittedProbing, fit_session
from palpate.records import Session
from palpate.simulation import (
    GreenFunctions,
    Material,
    estimated_material,
    exact_material,
    make_green_functions,
)
from palpate.viewer.subject import Subject, fitted_probings, shown_probings

# Largest size of the Green's functions [bytes]: a few seconds of work on a laptop.
_LARGEST_GREEN = 3e8
# Constants assumed if nothing was fitted: a soft material.
ASSUMED = exact_material(20e3, 0.3)


class BackgroundWork:
    """Background computations in a thread of their own.

    Results that are not ready yet are None; watchers set by `on_change` are called on changes.

    Parameters
    ----------
    subject : Subject
    cache : Path or None            folder in which what is computed of the body is kept
    """

    def __init__(self, subject: Subject, cache: Path | None) -> None:
        self.subject = subject
        self.cache = cache
        self.probings: tuple[FittedProbing, ...] = shown_probings(subject)
        self.fitted: FitResult | None = None
        self.green: GreenFunctions | None = None
        self.assumed = subject.estimate is None
        self.model_text = "starting"
        self.touch_text = "after the model"
        self._watchers: list[Callable[[], None]] = []
        self._thread = threading.Thread(target=self._work, daemon=True)

    def start(self) -> None:
        """Start the computations."""
        self._thread.start()

    def on_change(self, watcher: Callable[[], None]) -> Callable[[], None]:
        """Register a function that is called whenever something is ready.

        Parameters
        ----------
        watcher : callable          without arguments

        Returns
        -------
        callable                    cancels the registration
        """
        self._watchers.append(watcher)

        def end() -> None:
            with suppress(ValueError):
                self._watchers.remove(watcher)

        return end

    def _changed(self) -> None:
        for watcher in tuple(self._watchers):
            watcher()

    def _work(self) -> None:
        session = self.subject.session
        if session.probings and all(one.displacement is not None for one in session.probings):
            self._fit(session)
        else:
            self.model_text = (
                "nothing is measured yet in some probing; `palpate fit` measures the pictures,"
                " then look at its result"
            )
        self._changed()
        self._prepare_touch(session)
        self._changed()

    def _fit(self, session: Session) -> None:
        """Fit the session, for the model that the sliders query."""

        def say(text: str, share: float) -> None:
            self.model_text = f"{text}, {share:.0%}"
            self._changed()

        try:
            fitted = fit_session(session, cache=self.cache, progress=say)
        except PalpateError as error:
            self.model_text = f"the session cannot be fitted: {error}"
            return
        if self.subject.surface is None:
            self.probings = fitted_probings(session, fitted)
        self.model_text, self.fitted = "", fitted

    def _prepare_touch(self, session: Session) -> None:
        """Compute the Green's functions of the part that can be touched."""
        material = self._material()
        self.touch_text = "preparing the surface"
        self._changed()
        try:
            self.green = make_green_functions(
                session, material, most=_touchable(session), cache=self.cache
            )
            self.touch_text = self.green.left_out_text
        except PalpateError as error:
            self.touch_text = f"the object cannot be touched: {error}"

    def _material(self) -> Material:
        """Material of the estimate; `ASSUMED` if there is none."""
        estimate = self.subject.estimate or (self.fitted.estimate if self.fitted else None)
        if estimate is not None:
            with suppress(PalpateError):
                material = estimated_material(estimate)
                self.assumed = False
                return material
        self.assumed = True
        return ASSUMED


def _touchable(session: Session) -> int:
    """Largest number of vertices whose Green's functions fit into `_LARGEST_GREEN`."""
    count = len(session.mesh.vertices)
    nodes = count
    while 72.0 * nodes * (count + 4 * nodes) > _LARGEST_GREEN:
        nodes = int(0.9 * nodes)
    return nodes
