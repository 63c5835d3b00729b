"""Contacts of tools that are consistent with the constants that a fit with them gives."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.errors import NotConvergedError
from palpate.estimation import FitSettings, ProbeObservations, best_constants_of, predicted_surface
from palpate.pipeline.model.contacts.contact_radii import largest_change, with_contact_radii
from palpate.pipeline.model.contacts.sideways import displaced_contacts
from palpate.pipeline.observations.mesh_errors import ungraded_observations
from palpate.progress import Progress, part_of
from palpate.records import Session
from palpate.shapes import Vertices

# Contact radii vary only with the cube root of the modulus, so they converge with the constants.
# The relative tolerance is a tenth of the prior standard deviation of such a radius.
_MOST_CONTACT_ROUNDS, _CONTACT_TOLERANCE = 8, 0.005
# Slopes of the fitted modulus over the one that radii were computed for, beyond which a secant step
# is no longer trusted.
_SECANT_SLOPES = (-1.0, 0.8)
# At one half the formulae of the contact have a removable singularity.
_LARGEST_RATIO = 0.4999


def with_consistent_contacts(
    session: Session,
    *,
    settings: FitSettings,
    cache: Path | None,
    displaced: bool,
    progress: Progress,
) -> tuple[Session, list[ProbeObservations]]:
    """A session with contacts of its tools that are consistent with the constants fitted to it.

    Parameters
    ----------
    session : Session
    settings : FitSettings
    cache : Path or None            folder in which what is computed of the body is kept for reuse
    displaced : bool                True: contacts move sideways with the object
    progress : callable             called with the current step (text) and the fraction done

    Returns
    -------
    Session
    list of ProbeObservations       with the model of the mesh before grading

    Raises
    ------
    NotConvergedError               force and displacements do not belong together
    """
    model, fitted, taken = None, list[float](), list[float]()
    for iteration in range(_MOST_CONTACT_ROUNDS):
        # The number of iterations is not known: each takes half of the remaining progress.
        model, observations = ungraded_observations(
            session, settings=settings, cache=cache, like=model,
            with_surface=displaced,
            progress=part_of(progress, 1.0 - 0.5**iteration, 1.0 - 0.5 ** (iteration + 1)),
        )  # fmt: skip
        ratio, modulus = best_constants_of(observations, settings=settings)
        fitted.append(float(np.log(modulus)))
        taken.append(_consistent_modulus(taken, fitted))
        constants = {
            "shear_modulus": float(np.exp(taken[-1])),
            "poisson_ratio": min(ratio, _LARGEST_RATIO),
        }
        updated = session
        if displaced:
            moved = [_displacement_of_vertices(probe, ratio, modulus) for probe in observations]
            updated = displaced_contacts(session, model.system.surface, moved, **constants)
        updated = with_contact_radii(updated, **constants)
        change = largest_change(session, updated)
        # Responses of all vertices are large, and not needed any more.
        observations = [replace(probe, vertices=None) for probe in observations]
        if change < _CONTACT_TOLERANCE:
            return session, observations
        previous, session = session, updated
    # What Poisson's ratio that hardly counts leaves of a change is within the error of the radii.
    if change < previous.errors.touched_radius:
        return previous, observations
    raise NotConvergedError(
        f"what the tools touch still changes after {_MOST_CONTACT_ROUNDS} fits: the"
        " force and the displacements do not belong together; check tool_radius and the unit of"
        " the force"
    )


def _displacement_of_vertices(probe: ProbeObservations, ratio: float, modulus: float) -> Vertices:
    """Displacement of all vertices under the measured force, (v, 3) [m]."""
    load = np.concatenate([np.append(probe.force, 1.0) / modulus, probe.motion])
    moved = predicted_surface(probe, ratio, load)
    return np.zeros((0, 3)) if moved is None else moved


def _consistent_modulus(taken: Sequence[float], fitted: Sequence[float]) -> float:
    """Logarithm of the modulus for which radii are to be computed next: the last one fitted, from
    the third on a step of the secant method.

    Parameters
    ----------
    taken : sequence of n float         those that radii have been computed for
    fitted : sequence of n + 1 float    fitted with the initial radii, then with each of these
    """
    if len(taken) < 2 or taken[-1] == taken[-2]:
        return fitted[-1]
    slope = (fitted[-1] - fitted[-2]) / (taken[-1] - taken[-2])
    return taken[-1] + (fitted[-1] - taken[-1]) / (1.0 - float(np.clip(slope, *_SECANT_SLOPES)))
