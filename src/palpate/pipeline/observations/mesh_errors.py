"""The same probings beside models of several meshes: what the mesh that is fitted may be off by."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from palpate.bem import LARGEST_DENSE, SurfaceSettings
from palpate.estimation import FitMethod, FitSettings, ModelStep, ProbeObservations
from palpate.pipeline.model import (
    ObjectModel,
    edge_refined_session,
    graded_session,
    make_object_model,
)
from palpate.pipeline.observations.settled_observations import settled_observations
from palpate.progress import Progress, part_of, silent
from palpate.records import EXACT, Session

# Relative residual of a compressed model that shows the step to a finer mesh only: a thousandth of
# the displacement or more, so that the step is known to a hundredth.
_COARSER_RESIDUAL = 1e-5
# Fraction of the work that is done when the integrals are.
_SOLVED = 0.5


def coarser_observations(
    session: Session,
    *,
    settings: FitSettings = FitSettings(),
    surface: SurfaceSettings = SurfaceSettings(),
    cache: Path | None = None,
    like: ObjectModel | None = None,
    progress: Progress = silent,
) -> tuple[ObjectModel, list[ProbeObservations]]:
    """The model of the mesh as it is, nothing else being wrong, and what was seen beside it.

    Beside the same on the graded mesh it shows how much the mesh is off.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    settings : FitSettings
    surface : SurfaceSettings
    cache : Path or None                  folder that keeps the integrals
    like : ObjectModel or None            as `make_object_model`
    progress : callable                   told what is done (text) and how far it is (0 to 1)

    Returns
    -------
    ObjectModel
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `settled_observations`
    """
    plain = replace(session, errors=EXACT)
    progress("integrals", 0.0)
    model = make_object_model(
        plain, surface=surface, cache=cache, nominal=True, like=like,
        progress=part_of(progress, 0.0, _SOLVED),
    )  # fmt: skip
    progress("reduced model", _SOLVED)
    return model, settled_observations(
        plain, model, settings=settings, snapshot_residual=_COARSER_RESIDUAL
    )


def with_considered_errors(
    session: Session,
    observations: Sequence[ProbeObservations],
    *,
    settings: FitSettings = FitSettings(),
    surface: SurfaceSettings = SurfaceSettings(),
    cache: Path | None = None,
    progress: Progress = silent,
) -> list[ProbeObservations]:
    """What was seen beside the given mesh's model, with what that model may be off by between the
    vertices and along sharp edges.

    Parameters
    ----------
    session : Session                     k probings, each with displacements
    observations : sequence of k ProbeObservations    `coarser_observations` of it, likewise
    settings : FitSettings
    surface : SurfaceSettings
    cache : Path or None                  folder that keeps the integrals
    progress : callable                   told what is done (text) and how far it is (0 to 1)

    Returns
    -------
    list of k ProbeObservations           as they are where elements are linear, and where the mesh
                                          is so large that its integrals are compressed: four times
                                          as many vertices leave a seventh of these errors or less

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `settled_observations`
    """
    if not surface.quadratic:
        return list(observations)
    wider, refined = replace(surface, rings=2), edge_refined_session(session, surface=surface)
    count, found = len(session.mesh.vertices), list(observations)
    for name, beside, understood, say in (
        ("fields between the vertices (in steps to wider fits)", session, wider,
         part_of(progress, 0.0, 0.5, prefix="wider fits, ")),
        ("sharp edges (in steps to finer ones)", refined, surface,
         part_of(progress, 0.5, 1.0, prefix="finer edges, ")),
    ):  # fmt: skip
        size = len(beside.mesh.vertices)
        if size > LARGEST_DENSE or (beside is refined and size == count):
            continue
        _, others = coarser_observations(
            beside,
            settings=replace(settings, method=FitMethod.REDUCED.value),
            surface=understood,
            cache=cache,
            progress=say,
        )
        found = [
            replace(
                one,
                considered=(*one.considered, ModelStep(name, one.response_at, other.response_at)),
            )
            for one, other in zip(found, others, strict=True)
        ]
    return found


def graded_observations(session: Session) -> list[ProbeObservations]:
    """What a fit would see: beside the graded mesh's model, with the error that its mesh has.

    Parameters
    ----------
    session : Session                     k probings, each with displacements

    Returns
    -------
    list of k ProbeObservations

    Raises
    ------
    InputError, SingularSystemError, NotConvergedError    as `settled_observations`
    """
    _, coarser = coarser_observations(session)
    coarser = with_considered_errors(session, coarser)
    graded = graded_session(session)
    return settled_observations(graded, make_object_model(graded), coarser=coarser)
