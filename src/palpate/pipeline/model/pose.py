"""The pose of the object relative to what was measured, as an error that all probings share."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array

from palpate.estimation import Nuisance, NuisanceParameter, ResponseTerms
from palpate.geometry import SurfacePoints, interpolation_matrix
from palpate.pipeline.model.object_model import ObjectModel
from palpate.pipeline.model.responses import ProbeResponse
from palpate.pipeline.model.supports import rigid_modes
from palpate.records import Session

# Small rotations about x, y and z.
_TURNS = np.stack([np.cross(axis, np.eye(3)).T for axis in np.eye(3)])
# Barycentric coordinates along two sides of a triangle.
_SIDES = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
_POSE = "pose of the object"


@dataclass(frozen=True, slots=True, eq=False)
class PoseChanges:
    """Change of the displacements at points, from those of the vertices, with the pose of the mesh,
    per standard deviation of each of p parameters.

    Where the mesh is shifted by d relative to the points, its displacement is evaluated at x - d; a
    rotation also rotates the displacements.

    Attributes
    ----------
    here : (n, v) sparse            takes displacements of the v vertices to those at the n points
    slopes : two (n, v) sparse      takes them to their derivatives along two sides of the triangles
    shifts : (p, n, 2) float [-]    by how much of these sides the points are shifted
    turns : (p, 3, 3) float         takes displacements at the points to their change with the turn
    """

    here: csr_array
    slopes: tuple[csr_array, csr_array]
    shifts: Float[np.ndarray, "p n 2"]
    turns: Float[np.ndarray, "p 3 3"]

    def at(self, points: Int[np.ndarray, " m"]) -> "PoseChanges":
        """Of some of the points."""
        first, second = self.slopes
        return PoseChanges(
            self.here[points], (first[points], second[points]), self.shifts[:, points], self.turns
        )

    def of(self, vertices: Float[np.ndarray, "rows c"]) -> Float[np.ndarray, "r c p"]:
        """Change of the displacements at the points, (3 n, c, p).

        Parameters
        ----------
        vertices : (rows, c) float  of the vertices, three rows each; further rows are left out
        """
        points, count = self.here.shape
        columns = vertices.shape[1]
        # Components of one vertex in a row: all are interpolated alike.
        field = vertices[: 3 * count].reshape(count, -1)
        here = (self.here @ field).reshape(points, 3, columns)
        slopes = np.stack([slope @ field for slope in self.slopes], axis=2)
        shifted = (slopes @ self.shifts.transpose(1, 2, 0)).reshape(*here.shape, -1)
        turned = np.moveaxis(self.turns[:, None] @ here, 0, 3)
        return (shifted + turned).reshape(3 * points, columns, -1)


def pose_changes(model: ObjectModel, points: SurfacePoints) -> PoseChanges | None:
    """Changes of the displacements at points with the pose of the mesh: with three translations,
    then with three rotations, without those whose prior is exact.

    Parameters
    ----------
    model : ObjectModel
    points : SurfacePoints          of n points

    Returns
    -------
    PoseChanges or None             None: the pose is exact
    """
    stds = _pose_stds(model.session)
    chosen = np.flatnonzero(stds)
    if not chosen.size:
        return None
    nodes, place = model.system.surface.displacement, points.barycentric

    def at(barycentric: Float[np.ndarray, "n 3"]) -> csr_array:
        return interpolation_matrix(nodes, points.triangle, barycentric)

    # Of quadratic shape functions a central difference is the derivative, whatever its step.
    first, second = (csr_array(at(place + half) - at(place - half)) for half in 0.5 * _SIDES)
    turns = np.concatenate([np.zeros((3, 3, 3)), _TURNS]) * stds[:, None, None]
    return PoseChanges(at(place), (first, second), _shifts(model, points), turns[chosen])


def pose_dips(
    model: ObjectModel, response: ProbeResponse, points: SurfacePoints, change: PoseChanges
) -> Callable[[float], Float[np.ndarray, "p r 4"]]:
    """Change with the pose of what vertices miss of the dips about a probing's contact.

    Parameters
    ----------
    model : ObjectModel
    response : ProbeResponse        of the probing
    points : SurfacePoints          of n points
    change : PoseChanges            of these

    Returns
    -------
    function                        Poisson's ratio -> (p, 3 n, 4) float [m Pa]: displacement times
                                    shear modulus under its loads, for each of the p parameters
    """
    rows, surface, (poses, count, _) = response.rows, model.system.surface, change.shifts.shape
    columns = rows.columns[: len(rows.columns) - rows.changes]
    # Where points lie if the mesh is off by half a standard deviation one way, then the other.
    half, place = 0.5 * change.shifts @ _SIDES, points.barycentric
    sides = np.concatenate([place + half, place - half]).reshape(-1, 3)
    triangle = np.tile(points.triangle, 2 * poses)
    beside = model.loads.missed_indentation(surface, columns, triangle, sides)
    beside = beside.reshape(2, 2, poses, 3 * count, -1)
    here = model.loads.missed_indentation(surface, columns, points.triangle, place)
    turned = change.turns[:, None, None] @ here.reshape(2, count, 3, -1)
    moved = np.moveaxis(beside[:, 0] - beside[:, 1], 1, 0)
    moved += turned.reshape(moved.shape)
    return lambda nu: np.stack([rows.of_loads(dips, nu) for dips in moved])


def _pose_stds(session: Session) -> Float[np.ndarray, "6"]:
    """Standard deviations of three translations [m], then of three rotations [rad]."""
    priors = session.errors
    return np.repeat([priors.pose_translation, priors.pose_rotation], 3)


def _shifts(model: ObjectModel, points: SurfacePoints) -> Float[np.ndarray, "p n 2"]:
    """Shift of points relative to the mesh, if that is off by a standard deviation of each of p
    poses, over two sides of their triangles; its part normal to these has no effect."""
    mesh, stds = model.session.mesh, _pose_stds(model.session)
    chosen = np.flatnonzero(stds)
    modes = rigid_modes(points.position, mesh.vertices.mean(axis=0))[:, :, chosen] * stds[chosen]
    sides = _SIDES @ mesh.vertices[mesh.triangles[points.triangle]]
    return -np.moveaxis(np.linalg.pinv(sides.swapaxes(1, 2)) @ modes, 2, 0)


def pose_error(
    translation: float,
    rotation: float,
    change: PoseChanges,
    vertices: Callable[[float], Float[np.ndarray, "rows c"]],
    dips: Callable[[float], Float[np.ndarray, "p r t"]],
) -> Nuisance:
    """Pose of the mesh relative to the measured points, the same in all probings.

    Parameters
    ----------
    translation, rotation : float [m], [rad]    standard deviation along and about each axis; 0 =
                                                exact
    change : PoseChanges                        of n points, for each parameter
    vertices : function                         Poisson's ratio -> (rows, c) float: response of all
                                                vertices, three rows each (`ResponseModel`)
    dips : function                             Poisson's ratio -> (p, 3 n, t) float: further change
                                                of the first t columns, per standard deviation

    Returns
    -------
    Nuisance                                    of six parameters; of three where one of the
                                                standard deviations is zero
    """

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
        # Rows of a measured contact point follow those of the vertices.
        moved = change.of(vertices(at.poisson_ratio))
        further = dips(at.poisson_ratio)
        moved[:, : further.shape[2]] += np.moveaxis(further, 0, 2)
        # The contact point moves with the tool, not with the mesh.
        tip = np.zeros((3, *moved.shape[1:]))
        return np.concatenate([moved, tip])[at.rows][:, None]

    translations = (
        NuisanceParameter(f"shift of the object along {axis}", translation, "m", _POSE)
        for axis in "xyz"
    )
    rotations = (
        NuisanceParameter(f"turn of the object about {axis}", rotation, "rad", _POSE)
        for axis in "xyz"
    )
    every = (*translations, *rotations)
    return Nuisance(tuple(parameter for parameter in every if parameter.std > 0.0), effects)
