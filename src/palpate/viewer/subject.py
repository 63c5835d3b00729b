"""Subject of the viewer, a session or a result with its session, and what is computed of it.

The fit and Green's functions are computed in the background, once for all tabs.
"""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.errors import PalpateError
from palpate.estimation import Evaluation, FitResult
from palpate.pipeline import (
    SURFACE_FILE,
    FittedProbing,
    FittedSurface,
    fit_session,
)
from palpate.records import (
    Estimate,
    ModulusMap,
    Probing,
    Rig,
    Session,
    read_rig,
    read_session,
)
from palpate.simulation import (
    GreenFunctions,
    Material,
    estimated_material,
    exact_material,
    make_green_functions,
    read_fitted,
)

# Largest size of the Green's functions [bytes]: a few seconds of work on a laptop.
_LARGEST_GREEN = 3e8
# Constants assumed if nothing was fitted: a soft material.
ASSUMED = exact_material(20e3, 0.3)


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """An object with its probings, and the result of a fit, if there is one.

    Attributes
    ----------
    session : Session               with the measured displacements, if known
    estimate : Estimate or None
    surface : FittedSurface or None
    rig : Rig or None               its cameras, if it has pictures
    modulus : ModulusMap or None    None: the same everywhere
    """

    session: Session
    estimate: Estimate | None
    surface: FittedSurface | None
    rig: Rig | None
    modulus: ModulusMap | None = None


def read_subject(path: Path, session: Path | None = None) -> Subject:
    """Read a session or a result for viewing.

    Parameters
    ----------
    path : Path                     a session's folder or file, or a result folder of `palpate fit`
    session : Path or None          present location of a result's session; None: as recorded

    Returns
    -------
    Subject

    Raises
    ------
    RecordError                     neither a session nor a result; a damaged result; a result whose
                                    session now has another mesh
    """
    if not (path / SURFACE_FILE).is_file() and not (path / "estimate.json").is_file():
        opened = read_session(path)
        return Subject(opened, None, None, _rig(opened))
    source, surface = read_fitted(path, session)
    opened = source.session
    return Subject(opened, source.estimate, surface, _rig(opened), source.modulus)


def shown_probings(subject: Subject) -> tuple[FittedProbing, ...]:
    """All probings, with fitted quantities if known, else NaN.

    Parameters
    ----------
    subject : Subject

    Returns
    -------
    tuple of FittedProbing          in the session's order
    """
    fitted = (
        {probing.name: probing for probing in subject.surface.probings} if subject.surface else {}
    )
    return tuple(
        fitted.get(probing.name) or _measured(probing, subject.session)
        for probing in subject.session.probings
    )


def _fitted_probings(session: Session, result: FitResult) -> tuple[FittedProbing, ...]:
    """All probings with the quantities of a fit.

    Parameters
    ----------
    session : Session               the fitted session
    result : FitResult

    Returns
    -------
    tuple of FittedProbing          in the session's order
    """
    probings = []
    for probing, fit in zip(session.probings, result.probes, strict=True):
        plain = _measured(probing, session)
        sigma = plain.sigma if fit.sigma is None else fit.sigma
        probings.append(
            replace(
                plain, predicted=fit.predicted, left_out=fit.left_out_predicted, sigma=sigma,
                weight=fit.weight, surface=fit.surface,
            )
        )  # fmt: skip
    return tuple(probings)


def with_prediction(shown: FittedProbing, at: Evaluation, index: int) -> FittedProbing:
    """A probing with the model's prediction at other constants.

    Parameters
    ----------
    shown : FittedProbing
    at : Evaluation                 there; its mesh may have additional vertices after those of the
                                    session
    index : int                     of the probing

    Returns
    -------
    FittedProbing
    """
    predicted = at.problem.predicted_points(index, at.theta)
    surface = at.problem.predicted_surface(index, at.theta)
    if surface is not None and shown.surface is not None:
        surface = surface[: len(shown.surface)]
    return replace(shown, predicted=predicted, surface=surface)


def _measured(probing: Probing, session: Session) -> FittedProbing:
    """A probing with the measurement alone."""
    field = probing.displacement
    points = np.zeros((0, 3)) if field is None else field.points
    unknown = np.full(points.shape, np.nan)
    std = None if field is None else field.std
    return FittedProbing(
        name=probing.name,
        contact=probing.contact.point,
        force=probing.force,
        points=points,
        displacement=unknown if field is None else field.displacement,
        predicted=unknown,
        left_out=None,
        sigma=unknown if std is None else std,
        weight=np.ones(points.shape),
        surface=None,
    )


def _rig(session: Session) -> Rig | None:
    return None if session.rig is None else read_rig(session.rig)


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
        if session.probings and all(
            probing.displacement is not None for probing in session.probings
        ):
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

        def show_progress(text: str, share: float) -> None:
            self.model_text = f"{text}, {share:.0%}"
            self._changed()

        try:
            fitted = fit_session(session, cache=self.cache, progress=show_progress)
        except PalpateError as error:
            self.model_text = f"the session cannot be fitted: {error}"
            return
        if self.subject.surface is None:
            self.probings = _fitted_probings(session, fitted)
        self.model_text, self.fitted = "", fitted

    def _prepare_touch(self, session: Session) -> None:
        """Compute the Green's functions of the part that can be touched."""

        def show_progress(text: str, share: float) -> None:
            self.touch_text = f"preparing the surface: {text}, {share:.0%}"
            self._changed()

        material = self._material()
        show_progress("integrals", 0.0)
        try:
            self.green = make_green_functions(
                session,
                material,
                modulus=self.subject.modulus,
                most=_touchable(session),
                cache=self.cache,
                progress=show_progress,
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
