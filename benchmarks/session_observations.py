"""What a session's probings contribute to the estimation, without the estimation itself."""

from dataclasses import replace

from palpate import pipeline
from palpate.estimation import ProbeObservations
from palpate.records import Session


def session_observations(session: Session) -> list[ProbeObservations]:
    """Measured displacements of every probing with the model's response."""
    model = pipeline.make_object_model(session)
    return pipeline.session_observations(session, model)


def exact(
    probe: ProbeObservations, *, poisson_ratio: float, shear_modulus: float
) -> ProbeObservations:
    """The same probing as the model sees it: no noise, no error of the model.

    Parameters
    ----------
    probe : ProbeObservations
    poisson_ratio : float [-]
    shear_modulus : float [Pa]
    """
    response = probe.response.value(poisson_ratio)
    moved = ((response[:, :3] @ probe.force + response[:, 3]) / shear_modulus).reshape(-1, 3)
    count = len(probe.position)
    tip = None if probe.tip_displacement is None else moved[count]
    return replace(probe, displacement=moved[:count], tip_displacement=tip)


def thinned(session: Session, step: int) -> Session:
    """The session with every `step`-th observed point."""
    probings = []
    for probing in session.probings:
        field = probing.displacement
        chosen = slice(None, None, step)
        surface = replace(
            field.surface,
            triangle=field.surface.triangle[chosen],
            barycentric=field.surface.barycentric[chosen],
            position=field.surface.position[chosen],
            distance=field.surface.distance[chosen],
        )
        fewer = replace(
            field,
            points=field.points[chosen],
            displacement=field.displacement[chosen],
            std=None if field.std is None else field.std[chosen],
            vertex=None if field.vertex is None else field.vertex[chosen],
            surface=surface,
        )
        probings.append(replace(probing, displacement=fewer))
    return replace(session, probings=tuple(probings))
