"""Probings with models of several meshes: how large the discretisation error is."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from palpate.bem import CENTRE, LARGEST_DENSE, CentredSystem, CompressedSystem
from palpate.estimation import FitMethod, FitSettings, ProbeObservations
from palpate.pipeline.model.grading import edge_refined_session, graded_session
from palpate.pipeline.model.object_model import ObjectModel, make_object_model
from palpate.pipeline.observations.converged_observations import converged_observations, model_step
from palpate.progress import Progress, part_of, silent
from palpate.records import EXACT, Session

# Relative residual of a model used only for the change to a finer mesh: that is at least a
# thousandth of the displacement, so it is known to a hundredth; on a plate of 5 mm a residual of
# 1e-4 changes no constant by 1e-7.
UNGRADED_RESIDUAL = 1e-5
# What an estimate calls the errors that come out of the compared meshes.
_STEPS = {
    "wider fits": "fields between the vertices (in steps to wider fits)",
    "finer edges": "sharp edges (in steps to finer ones)",
}
# Fraction of the work that the integrals take.
_SOLVED = 0.5


def ungraded_observations(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    rings: int = 1,
    cache: Path | None = None,
    like: ObjectModel | None = None,
    with_surface: bool = False,
    progress: Progress = silent,
) -> tuple[ObjectModel, list[ProbeObservations]]:
    """The model of the mesh as it is, without other errors, and the observations with it.

    The change from these to the graded mesh shows the discretisation error.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    settings : FitSettings
    rings : int                           as `bem.SurfaceSettings`
    cache : Path or None                  folder in which what is computed of the body is kept
    like : ObjectModel or None            as `make_object_model`
    with_surface : bool                   True: with responses of all vertices
    progress : callable                   called with the current step (text) and the fraction done

    Returns
    -------
    ObjectModel
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `converged_observations`
    """
    model = ungraded_model(
        session, settings=settings, rings=rings, cache=cache, like=like,
        progress=part_of(progress, 0.0, _SOLVED),
    )  # fmt: skip
    progress("reduced model", _SOLVED)
    return model, converged_observations(
        model.session,
        model,
        settings=settings,
        with_surface=with_surface,
        residual=UNGRADED_RESIDUAL,
    )


def ungraded_model(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    rings: int = 1,
    cache: Path | None = None,
    like: ObjectModel | None = None,
    progress: Progress = silent,
) -> ObjectModel:
    """The model of the mesh as it is, without other errors.

    Parameters
    ----------
    session, settings, rings, cache, like, progress    as in `ungraded_observations`

    Returns
    -------
    ObjectModel

    Raises
    ------
    InputError                            as `make_object_model`
    """
    plain = replace(session, errors=EXACT)
    progress("integrals", 0.0)
    model = make_object_model(
        plain, rings=rings, cache=cache, perturbed=False, like=like, progress=progress
    )
    if _can_be_centred(model, settings) and model.centred is None:
        # In solutions, a residual of 1e-5 allows for errors at least as large as single precision.
        model = replace(model, centred=CentredSystem(model.system, CENTRE, single=True))
    return model


def _can_be_centred(model: ObjectModel, settings: FitSettings) -> bool:
    """Whether the solutions of a model come from one factorisation."""
    compressed = isinstance(model.system, CompressedSystem)
    return settings.method == FitMethod.REDUCED and model.springs is None and not compressed


def with_mesh_steps(
    session: Session,
    observations: Sequence[ProbeObservations],
    *,
    settings: FitSettings = FitSettings(),
    cache: Path | None = None,
    progress: Progress = silent,
) -> list[ProbeObservations]:
    """Observations with the errors of the given mesh's model between vertices and along sharp
    edges, as large as the steps to other meshes.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    observations : sequence of k ProbeObservations    `ungraded_observations` of it, in this order
    settings : FitSettings
    cache : Path or None                  folder in which what is computed of the body is kept
    progress : callable                   called with the current step (text) and the fraction done

    Returns
    -------
    list of k ProbeObservations           unchanged where the mesh is so large that its integrals
                                          are compressed: four times as many vertices reduce the
                                          error between them to a tenth

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `converged_observations`
    """
    stepped = list(observations)
    meshes = compared_meshes(session)
    for number, (name, compared_session, rings) in enumerate(meshes):
        _, compared = ungraded_observations(
            compared_session,
            settings=replace(settings, method=FitMethod.REDUCED.value),
            rings=rings,
            cache=cache,
            progress=part_of(
                progress, number / len(meshes), (number + 1) / len(meshes), prefix=f"{name}, "
            ),
        )
        for k, other in enumerate(compared):
            probe = stepped[k]
            step = model_step(_STEPS[name], 1.0, probe.response_terms, other.response_terms)
            stepped[k] = replace(probe, nuisances=(*probe.nuisances, step))
    return stepped


def compared_meshes(session: Session) -> list[tuple[str, Session, int]]:
    """The meshes and fits between vertices with which the model of the given mesh is compared.

    Parameters
    ----------
    session : Session

    Returns
    -------
    list of (name, Session, int)          "wider fits" and "finer edges", each with the rings of its
                                          fits; without the latter where the mesh has no sharp
                                          edges, without those that are too large for dense matrices
    """
    refined = edge_refined_session(session)
    meshes = [("wider fits", session, 2)]
    if len(refined.mesh.vertices) > len(session.mesh.vertices):
        meshes.append(("finer edges", refined, 1))
    return [each for each in meshes if len(each[1].mesh.vertices) <= LARGEST_DENSE]


def graded_observations(session: Session) -> list[ProbeObservations]:
    """Observations as a fit takes them: with the graded mesh's model and the errors of that mesh.

    Parameters
    ----------
    session : Session                     k probings, each with displacements

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `converged_observations`
    """
    _, ungraded = ungraded_observations(session)
    ungraded = with_mesh_steps(session, ungraded)
    graded = graded_session(session)
    return converged_observations(graded, make_object_model(graded), coarser=ungraded)
