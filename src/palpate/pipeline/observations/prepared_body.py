"""What the fits of one body have in common, computed before anything is measured on it."""

from pathlib import Path

from palpate.bem import CENTRE, DENSE_RESIDUAL, CentredSystem, CompressedSystem
from palpate.estimation import FitSettings
from palpate.pipeline.model.contacts.contact_radii import has_tools
from palpate.pipeline.model.grading import graded_session, refined_session
from palpate.pipeline.model.object_model import ObjectModel, make_object_model
from palpate.pipeline.observations.mesh_errors import (
    UNGRADED_RESIDUAL,
    compared_meshes,
    ungraded_model,
)
from palpate.pipeline.observations.session_observations import reduced_model_of
from palpate.records import Session


def prepare_body(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    cache: Path,
) -> None:
    """Compute what `fit_session` needs of a body, and keep it in the cache where it finds it.

    These are the reduced models of all contacts, with the factors that other contacts on the same
    body need as well. Where a contact follows from a tool and the fitted constants, only the
    factors are computed. Nothing is kept of a body that is too large for dense matrices.

    Parameters
    ----------
    session : Session                     displacements are not needed
    settings : FitSettings                with the method reduced
    cache : Path                          folder, created if absent

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `session_observations`
    """
    refined = refined_session(session)
    with_loads = not has_tools(session)
    compared = [(each, rings) for _, each, rings in compared_meshes(refined)]
    for each, rings in [(refined, 1), *compared]:
        model = ungraded_model(each, settings=settings, rings=rings, cache=cache)
        _keep(model, settings, UNGRADED_RESIDUAL, with_loads=with_loads)
    if with_loads:
        graded = graded_session(refined)
        model = make_object_model(graded, cache=cache)
        _keep(model, settings, DENSE_RESIDUAL, with_loads=True)


def _keep(model: ObjectModel, settings: FitSettings, residual: float, *, with_loads: bool) -> None:
    """Have a model's factors computed, and its reduced model with its loads."""
    if isinstance(model.system, CompressedSystem):
        return
    # On springs, a reduced model depends on the shear modulus.
    if with_loads and model.springs is None:
        reduced_model_of(model, settings=settings, residual=residual)
    else:
        _ = (model.centred or CentredSystem(model.system, CENTRE)).factorised
