"""Subject of the viewer: a session, or a result of `palpate fit` with its session."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from palpate.errors import RecordError
from palpate.estimation import FitResult, PredictedProbing
from palpate.pipeline import (
    SURFACE_FILE,
    FittedProbing,
    FittedSurface,
    kept_motion,
    read_fitted_surface,
    with_motions,
)
from palpate.records import Estimate, Probing, Rig, Session, read_rig, read_session
from palpate.simulation import read_fit


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """An object with its probings, and the result of a fit, if there is one.

    Attributes
    ----------
    session : Session               with the measured displacements, if known
    estimate : Estimate or None
    surface : FittedSurface or None
    rig : Rig or None               its cameras, if it has pictures
    """

    session: Session
    estimate: Estimate | None
    surface: FittedSurface | None
    rig: Rig | None


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
        found = read_session(path)
        return Subject(found, None, None, _rig(found))
    source, surface = read_fit(path, session), read_fitted_surface(path)
    found = source.session
    same = np.array_equal(found.mesh.vertices, surface.vertices)
    if not same or not np.array_equal(found.mesh.triangles, surface.triangles):
        raise RecordError(
            f"{path}: was fitted to another mesh than {found.path} names now; fit the session again"
        )
    found = with_motions(found, kept_motion(found, path))
    return Subject(found, source.estimate, surface, _rig(found))


def shown_probings(subject: Subject) -> tuple[FittedProbing, ...]:
    """All probings, with fitted quantities if known, else NaN.

    Parameters
    ----------
    subject : Subject

    Returns
    -------
    tuple of FittedProbing          in the session's order
    """
    fitted = {one.name: one for one in subject.surface.probings} if subject.surface else {}
    return tuple(
        fitted.get(one.name) or _measured(one, subject.session) for one in subject.session.probings
    )


def fitted_probings(session: Session, result: FitResult) -> tuple[FittedProbing, ...]:
    """All probings with the quantities of a fit.

    Parameters
    ----------
    session : Session               the fitted session
    result : FitResult

    Returns
    -------
    tuple of FittedProbing          in the session's order
    """
    found = []
    for probing, fit in zip(session.probings, result.probes, strict=True):
        plain = _measured(probing, session)
        sigma = plain.sigma if fit.sigma is None else fit.sigma
        found.append(
            replace(
                plain, predicted=fit.predicted, left_out=fit.left_out_predicted, sigma=sigma,
                weight=fit.weight, surface=fit.surface,
            )
        )  # fmt: skip
    return tuple(found)


def with_prediction(shown: FittedProbing, predicted: PredictedProbing) -> FittedProbing:
    """A probing with the model's prediction at other constants.

    Parameters
    ----------
    shown : FittedProbing
    predicted : PredictedProbing    of this probing; its mesh may have additional vertices after
                                    those of the session

    Returns
    -------
    FittedProbing
    """
    surface = predicted.surface
    if surface is not None and shown.surface is not None:
        surface = surface[: len(shown.surface)]
    return replace(shown, predicted=predicted.predicted, surface=surface)


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
