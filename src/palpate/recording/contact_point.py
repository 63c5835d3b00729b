"""Where the tool touched, from how the surface around it moved.

Near the contact a surface moves as a half space does under a point force: as 1/r from it, along the
force and away from the line of sight to it. The point of the surface from which the measured field
spreads like that is sought; the constants of the law are free, so that none of the object's are
assumed.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares

from palpate.errors import RecordError
from palpate.geometry import TriangleMesh, closest_points, unit_normals
from palpate.shapes import Points, Vector3

# Points nearer to the contact than so many of its radii are under the tool or bent by its rim;
# farther ones feel the object's shape more than where they are pushed.
_NEAREST, _FARTHEST = 1.0, 6.0
# Fewer points, or a pattern that explains less of the motion, are no contact.
_LEAST_POINTS, _LEAST_EXPLAINED = 30, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class FoundContact:
    """A contact point that was not told.

    Attributes
    ----------
    point : (3,) float [m]          on the surface
    normal : (3,) float [-]         outward
    std : float [m]                 along the surface, of each direction
    explained : float [-]           share of the motion near it that the law explains, 0 to 1
    """

    point: Vector3
    normal: Vector3
    std: float
    explained: float


def find_contact(
    mesh: TriangleMesh, points: Points, displacement: Points, force: Vector3, *, radius: float
) -> FoundContact:
    """The point of the surface from which a measured displacement spreads.

    Parameters
    ----------
    mesh : TriangleMesh
    points : (n, 3) float [m]       on the surface
    displacement : (n, 3) float [m]
    force : (3,) float [N]          on the object
    radius : float [m]              of the contact

    Returns
    -------
    FoundContact

    Raises
    ------
    RecordError                     too few points, or a motion that spreads from no point
    """
    direction = force / np.linalg.norm(force)
    guess = _start(mesh, points, displacement, direction, radius)
    for _ in range(3):
        away = np.linalg.norm(points - guess, axis=1)
        near = (away > _NEAREST * radius) & (away < _FARTHEST * radius)
        if near.sum() < _LEAST_POINTS:
            raise RecordError(
                f"only {int(near.sum())} points are measured within {_FARTHEST:g} contact radii of"
                " where the motion is largest: the contact cannot be found; give `points` or"
                " `poses` in [contact]"
            )
        place = closest_points(mesh, guess[None])
        normal = unit_normals(mesh)[place.triangle[0]]
        across = np.linalg.svd(normal[None])[2][1:]
        found = least_squares(
            lambda shift, p=points[near], u=displacement[near], g=guess, a=across, n=normal: (
                _unexplained(p, u, g + shift @ a, direction, n, radius)
            ),
            np.zeros(2), x_scale=radius, diff_step=1e-4,
        )  # fmt: skip
        guess = closest_points(mesh, (guess + found.x @ across)[None]).position[0]
    rest = float(found.fun @ found.fun) / float(np.square(displacement[near]).sum())
    if 1.0 - rest < _LEAST_EXPLAINED:
        raise RecordError(
            f"the motion does not spread from one point ({100 * (1.0 - rest):.0f} % of it is"
            " explained): the contact cannot be found; give `points` or `poses` in [contact]"
        )
    # Neighbouring points err alike: as many count as patches of a contact radius have room.
    count = max(np.ptp(points[near] @ across.T, axis=0).prod() / (np.pi * radius**2), 8.0)
    variance = float(found.fun @ found.fun) / near.sum() / 3.0
    information = found.jac.T @ found.jac * (count / near.sum())
    std = float(np.sqrt(variance * np.linalg.inv(information).trace() / 2.0))
    return FoundContact(guess, normal, std, 1.0 - rest)


def _start(
    mesh: TriangleMesh, points: Points, displacement: Points, direction: Vector3, radius: float
) -> Vector3:
    """Middle of what moves most along the force, brought to the surface along the force's line."""
    along = np.maximum(displacement @ direction, 0.0)
    most = along >= np.percentile(along, 97.0)
    middle = np.average(points[most], axis=0, weights=along[most])
    position: Vector3 = closest_points(mesh, middle[None]).position[0]
    return position


def _unexplained(
    points: Points,
    displacement: Points,
    contact: Vector3,
    direction: Vector3,
    normal: Vector3,
    radius: float,
) -> Float[np.ndarray, " k"]:
    """What is left of a displacement when the best sum of five patterns is taken away.

    Boussinesq's and Cerruti's fields on the surface are sums of f/r, r (r f)/r^3, r (n f)/r^2 and
    n (r f)/r^2; a constant stands for the rest of the body.

    Source: Johnson, Contact mechanics (1985), 3.2 and 3.6.
    """
    offset = points - contact
    # Under the tool the fields are blunt.
    r = np.sqrt((offset**2).sum(axis=1) + (0.3 * radius) ** 2)[:, None]
    unit = offset / r
    lead = unit @ direction
    patterns = [
        direction / r,
        unit * lead[:, None] / r,
        unit * (normal @ direction) / r,
        normal * lead[:, None] / r,
        *(np.tile(axis, (len(points), 1)) / radius for axis in np.eye(3)),
    ]
    matrix = np.stack([pattern.ravel() for pattern in patterns], axis=1)
    # Far points are many and say little of the place: all rings of equal width weigh alike.
    weight = np.repeat(radius / r[:, 0], 3)
    target = displacement.ravel() * weight
    matrix = matrix * weight[:, None]
    result: np.ndarray = target - matrix @ np.linalg.lstsq(matrix, target, rcond=None)[0]
    return result / weight.mean()
