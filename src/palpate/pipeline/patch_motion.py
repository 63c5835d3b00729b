"""How the patches under other tools move in a probing: averages of the measured displacements,
weighted by the pressure there, with their covariance.

The displacement around a place is that of a plane and a Gaussian process (kriging) through the
noisy measured points, whose size, smoothness and noise make the measurement most likely.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import block_diag
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist
from scipy.special import ndtri

from palpate.arrays import tangents_of
from palpate.estimation import FALSE_ALARM
from palpate.geometry import (
    BESIDE,
    TriangleMesh,
    closest_points,
    triangle_areas,
    triangle_distances,
    unit_normals,
)
from palpate.records import Contact, DisplacementField
from palpate.shapes import PointIndices, Points, Vector3

# Prior variance of the plane over that of the noise.
_PLANE = 1e6
# Tried for a process: its length of correlation over the farthest point's distance, its variance
# over that of the noise, from nothing to a motion without any noise.
_LENGTHS, _RATIOS = np.geomspace(0.5, 20.0, 7), np.geomspace(1e-6, 1e16, 45)
# Tried for the noise: its standard deviation over that of the motion, or over what was claimed.
_QUIET, _LOUD = np.geomspace(1e-5, 2.0, 22), np.geomspace(1.0, 100.0, 22)
# Passes that leave points out.
_ROUNDS = 4
# Fewest points: a plane has four coefficients.
_FEWEST = 12


@dataclass(frozen=True, slots=True, eq=False)
class LocalField:
    """The displacement around a place.

    Attributes
    ----------
    rows : (n,) int                 of the measured points that it follows
    origin : (3,) float [m]
    size : float [m]                farthest distance of a point from the origin
    place : (n, 3) float [-]        of the points, from the origin, over the size
    middle : (3,) float [m]         mean displacement
    moved : (n, 3) float [m]        less the mean
    apart : (n, n) float [-]        distances of the places
    shape : (float, float)          length of correlation over the size; variance of the process
                                    over that of the noise
    level : float [m]               standard deviation of the noise, of all components together
    claim : float                   the same as it was given
    inverse : (3, n, n) float       of the points' covariance over level^2, for each component
    """

    rows: PointIndices
    origin: Vector3
    size: float
    place: Points
    middle: Vector3
    moved: Points
    apart: Float[np.ndarray, "n n"]
    shape: tuple[float, float]
    level: float
    claim: float
    inverse: Float[np.ndarray, "3 n n"]

    def weights(self, points: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "3 q n"]:
        """Weights of the measured points in the displacement of others, for each component.

        Parameters
        ----------
        points : (q, 3) float [m]
        """
        return np.asarray(self._prior(points) @ self.inverse)

    def at(self, points: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q 3"]:
        """Most likely displacement of points [m].

        Parameters
        ----------
        points : (q, 3) float [m]
        """
        off = np.einsum("anm,ma->na", self.inverse, self.moved)
        return np.asarray(self.middle + self._prior(points) @ off)

    def rest(
        self, points: Float[np.ndarray, "q 3"], share: Float[np.ndarray, "p q"]
    ) -> Float[np.ndarray, "3 p p"]:
        """Covariance [m^2] of averages over points beyond that of the noise in them: what the
        measured points leave open between them.

        Parameters
        ----------
        points : (q, 3) float [m]
        share : (p, q) float [-]        of the points in the averages
        """
        used = share.any(axis=0)
        points, share = points[used], share[:, used]
        here = (points - self.origin) / self.size
        across = share @ self._prior(points)
        prior = share @ _prior_covariance(cdist(here, here), here, here, self.shape) @ share.T
        among = _prior_covariance(self.apart, self.place, self.place, self.shape)
        # Of the process and the plane, seen through weights that the noise has no part in.
        weights = across @ self.inverse
        mixed = weights @ across.T
        left = prior - mixed - mixed.mT + weights @ among @ weights.mT
        return np.asarray(self.level**2 * left)

    def _prior(self, points: Float[np.ndarray, "q 3"]) -> Float[np.ndarray, "q n"]:
        here = (points - self.origin) / self.size
        return _prior_covariance(cdist(here, self.place), here, self.place, self.shape)


def _prior_covariance(
    distance: Float[np.ndarray, "n k"],
    here: Points,
    others: Float[np.ndarray, "k 3"],
    shape: tuple[float, float],
) -> Float[np.ndarray, "n k"]:
    """Covariance of plane and process between points, over the noise's variance: Matern's, of
    smoothness 5/2."""
    length, power = shape
    return np.asarray(power * _process(distance, length) + _PLANE * (1.0 + here @ others.T))


def _process(distance: Float[np.ndarray, "n k"], length: float) -> Float[np.ndarray, "n k"]:
    """Correlation of the process."""
    scaled = np.sqrt(5.0) / length * distance
    return np.asarray((1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled))


def local_field(
    rows: PointIndices,
    points: Points,
    moved: Points,
    noise: Float[np.ndarray, "3 n n"],
    *,
    claimed: bool,
) -> LocalField | None:
    """The displacement around a place; points that are far off are left out.

    Parameters
    ----------
    rows : (n,) int                 numbers of the points
    points : (n, 3) float [m]
    moved : (n, 3) float [m]
    noise : (3, n, n) float         covariance of each component's noise, up to one factor, which is
                                    found
    claimed : bool                  whether it is in m^2, and the factor at least 1: what looks like
                                    less noise may be noise that neighbours share

    Returns
    -------
    LocalField or None              None where there are too few points
    """
    # In a unit that makes the noise about 1.
    claim = float(np.sqrt(np.einsum("ann->an", noise).mean()))
    noise = noise / claim**2
    for _ in range(_ROUNDS):
        if len(rows) < _FEWEST:
            return None
        field = _most_likely(rows, points, moved, noise, claim, claimed)
        # What each point is off from the prediction by all others, over its standard deviation.
        sharp = np.einsum("ann->na", field.inverse)
        scaled = np.einsum("anm,ma->na", field.inverse, field.moved)
        off = np.abs(scaled) / (np.sqrt(sharp) * field.level)
        inliers = off.max(axis=1) < -float(ndtri(0.5 * FALSE_ALARM / off.size))
        if inliers.all():
            break
        rows, points, moved = rows[inliers], points[inliers], moved[inliers]
        noise = noise[:, inliers][:, :, inliers]
    return field


def _most_likely(
    rows: PointIndices,
    points: Points,
    moved: Points,
    noise: Float[np.ndarray, "3 n n"],
    claim: float,
    claimed: bool,
) -> LocalField:
    """The process of most likelihood with the mean noise that all processes leave, each by its
    likelihood: where points are far apart a rough process can explain all of the noise, and so
    small a level is one of many."""
    origin = points.mean(axis=0)
    size = float(np.linalg.norm(points - origin, axis=1).max())
    middle, position = moved.mean(axis=0), (points - origin) / size
    around = moved - middle
    apart = cdist(position, position)
    if (noise == noise[0]).all():
        noise = noise[:1]
    motion = float(np.sqrt((around**2).mean())) + np.finfo(float).tiny ** 0.25
    levels = claim * _LOUD if claimed else motion * _QUIET
    # The plane is taken out: what is left of n points is n - 4 combinations of them.
    plane = np.column_stack([np.ones(len(position)), position])
    rest = np.linalg.qr(plane, mode="complete")[0][:, 4:]
    white = np.linalg.inv(np.linalg.cholesky(rest.T @ noise @ rest)) @ rest.T
    chance = np.zeros((len(_LENGTHS), len(levels), len(_RATIOS)))
    for k, length in enumerate(_LENGTHS):
        value, axes = np.linalg.eigh(white @ _process(apart, length) @ white.mT)
        square = (axes.mT @ white @ around) ** 2
        squares = square.sum(axis=2) if len(noise) == 1 else np.einsum("ana->an", square)
        # Over the square of the level, so that all levels share what takes time.
        total = 1.0 + _RATIOS[:, None, None] * np.maximum(value, 0.0)
        volume = 3 / len(noise) * np.log(total).sum(axis=(1, 2))
        misfit = (squares / total).sum(axis=(1, 2))
        count = 3.0 * value.shape[1]
        chance[k] = -0.5 * (volume + misfit / levels[:, None] ** 2)
        chance[k] -= count * np.log(levels)[:, None]
    chance = np.exp(chance - chance.max())
    level = float(np.sqrt(np.einsum("klp,l->", chance, levels**2) / chance.sum()))
    nearest = int(np.abs(np.log(levels / level)).argmin())
    k, p = np.unravel_index(chance[:, nearest].argmax(), chance[:, 0].shape)
    shape = (float(_LENGTHS[k]), float(_RATIOS[p] * (levels[nearest] / level) ** 2))
    sides = np.linalg.inv(
        np.linalg.cholesky(_prior_covariance(apart, position, position, shape) + noise)
    )
    inverse = np.broadcast_to(sides.mT @ sides, (3, *apart.shape))
    return LocalField(
        rows, origin, size, position, middle, around, apart, shape, level, claim, inverse
    )


# Longest side of the triangles of a patch over its reach.
_FINE = 0.4
# Points around a patch that are used: so many, or those within so many reaches, evenly thinned.
_NEAREST, _MOST, _REACHES = 60, 150, 1.5
# Of a regular pattern at least three points lie within a spacing of any place, and each has six
# neighbours a spacing away.
_SURROUNDING, _NEIGHBOURS = 3, 6
# Steps of the derivatives: of the radius, and along the surface over the reach or triangles' sides.
_GROWN, _STEP = 0.2, 0.5
_Rows = Int[np.ndarray, " _"]


@dataclass(frozen=True, slots=True, eq=False)
class Patch:
    """Where a load acts.

    Attributes
    ----------
    centre : (3,) float [m]
    points : (q, 3) float [m]       of the surface there
    share : (7, q) float [-]        of each point in the force; in that of the patch displaced along
                                    either tangent, forward and back; in that of a larger and a
                                    smaller one; rows sum to 1
    step : float [m]                by which it is displaced
    normal : (3,) float [-]         outward
    reach : float [m]               farthest distance from the centre; 0 for a single point
    """

    centre: Vector3
    points: Float[np.ndarray, "q 3"]
    share: Float[np.ndarray, "7 q"]
    step: float
    normal: Vector3
    reach: float


def make_patch(mesh: TriangleMesh, contact: Contact) -> Patch:
    """The patch of a contact.

    Parameters
    ----------
    mesh : TriangleMesh
    contact : Contact

    Returns
    -------
    Patch
    """
    if contact.triangles is not None or contact.radius is None:
        return _fixed_patch(mesh, contact)
    distance = triangle_distances(mesh, contact.point)
    normals = unit_normals(mesh)
    normal = normals[distance.argmin()]
    step = _STEP * contact.reach
    near = distance < (1.0 + _GROWN) * contact.reach + step
    near &= normals @ normal > BESIDE
    corner = mesh.vertices[mesh.triangles[near]]
    while _longest_side(corner) > _FINE * contact.reach:
        middle = 0.5 * (corner + np.roll(corner, -1, axis=1))
        ends = [np.stack([corner[:, k], middle[:, k], middle[:, k - 1]], axis=1) for k in range(3)]
        corner = np.concatenate([middle, *ends])
    points = corner.mean(axis=1)
    area = np.linalg.norm(
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
    )
    offsets = _displacements(normal, step)
    places = [(points - contact.point - offset) / contact.radius for offset in offsets]
    places += [places[0] / grown for grown in (1.0 + _GROWN, 1.0 - _GROWN)]
    share = np.stack([area * contact.pressure_at(position) for position in places])
    used = share.any(axis=0)
    share = share[:, used] / share.sum(axis=1, keepdims=True)
    return Patch(contact.point, points[used], share, step, normal, contact.reach)


def _fixed_patch(mesh: TriangleMesh, contact: Contact) -> Patch:
    """The patch of a load over triangles, or of one at a point."""
    normals, triangles = unit_normals(mesh), contact.triangles
    side, points, area = (
        _longest_side(mesh.vertices[mesh.triangles]),
        contact.point[None],
        np.ones(1),
    )
    if triangles is None:
        triangles = closest_points(mesh, points).triangle
    else:
        points = mesh.vertices[mesh.triangles[triangles]].mean(axis=1)
        area = triangle_areas(mesh)[triangles]
    area = area / area.sum()
    centre, normal = area @ points, normals[triangles].sum(axis=0)
    normal = normal / max(float(np.linalg.norm(normal)), 0.1)
    reach = float(np.linalg.norm(points - centre, axis=1).max())
    step = _STEP * max(side, reach)
    places = np.concatenate([points + offset for offset in _displacements(normal, step)])
    share = np.kron(np.eye(5), area)
    share = np.concatenate([share, share[:1], share[:1]])
    return Patch(centre, closest_points(mesh, places).position, share, step, normal, reach)


def _longest_side(corner: Float[np.ndarray, "m 3 3"]) -> float:
    """Longest side of some triangles [m]."""
    return float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max())


def _displacements(normal: Vector3, step: float) -> list[Vector3]:
    """Zero, then a step forward and a step back along each tangent."""
    along = [sign * step * tangent for tangent in tangents_of(normal) for sign in (1.0, -1.0)]
    return [np.zeros(3), *along]


@dataclass(frozen=True, slots=True, eq=False)
class PatchMotion:
    """How patches move in one probing.

    Attributes
    ----------
    seen : (p,) bool                whether measured points surround the patch; all else is 0 where
                                    they do not
    mean : (p, 3) float [m]         displacement, averaged with the shares of the force
    gradient : (p, 3, 3) float [-]  [p, a, b]: its component a per displacement of the patch along
                                    b, on the surface
    growth : (p, 3) float [m]       its change per relative change of the patch's radius
    covariance : (p, 3, p, 3) float [m^2]    of the mean
    """

    seen: Bool[np.ndarray, " p"]
    mean: Float[np.ndarray, "p 3"]
    gradient: Float[np.ndarray, "p 3 3"]
    growth: Float[np.ndarray, "p 3"]
    covariance: Float[np.ndarray, "p 3 p 3"]


def patch_motion(
    mesh: TriangleMesh,
    field: DisplacementField,
    patches: Sequence[Patch],
    pressing: Sequence[Patch],
) -> PatchMotion:
    """How patches move in a probing.

    Displacements that are averages over the surface count as those of their points.

    Parameters
    ----------
    mesh : TriangleMesh
    field : DisplacementField       of the probing
    patches : sequence of p Patch
    pressing : sequence of Patch    where the probing itself presses; another patch is judged by the
                                    points that are nearer to it than to these

    Returns
    -------
    PatchMotion
    """
    measured = np.flatnonzero(np.isfinite(field.displacement).all(axis=1))
    spacing = _spacing(field.points[measured])
    around = [_around(mesh, field, measured, patch, pressing, spacing) for patch in patches]
    parts, smooth = [], np.zeros((len(patches), 3, len(field.points)))
    for group in _groups(patches, [len(rows) > 0 for rows in around]):
        rows = np.unique(np.concatenate([around[p] for p in group]))
        points, moved = field.points[rows], field.displacement[rows]
        motion = local_field(
            rows, points, moved, _noise(field, rows), claimed=field.std is not None
        )
        if motion is not None:
            parts.append((group, motion))
            chosen = [patches[p] for p in group]
            weights = _shares(chosen) @ motion.weights(_points(chosen))
            smooth[np.ix_(group, np.arange(3), motion.rows)] = weights.transpose(1, 0, 2)
    return _moved(field, patches, parts, smooth)


def _moved(
    field: DisplacementField,
    patches: Sequence[Patch],
    parts: Sequence[tuple[_Rows, LocalField]],
    smooth: Float[np.ndarray, "p 3 n"],
) -> PatchMotion:
    """The motion of groups of patches by their local fields, whose weights are `smooth`."""
    count = len(patches)
    seen, mean, growth = np.zeros(count, dtype=bool), np.zeros((count, 3)), np.zeros((count, 3))
    gradient, factor = np.zeros((count, 3, 3)), np.zeros(count)
    for group, motion in parts:
        seen[group], factor[group] = True, motion.level / motion.claim
        for p in group:
            patch = patches[p]
            values = patch.share @ motion.at(patch.points)
            mean[p], growth[p] = values[0], (values[5] - values[6]) / (2.0 * _GROWN)
            slopes = (values[[1, 3]] - values[[2, 4]]) / (2.0 * patch.step)
            gradient[p] = slopes.T @ tangents_of(patch.normal)
    used = np.flatnonzero(smooth.any(axis=(0, 1)))
    covariance = factor[:, None, None, None] * factor[:, None] * _spread(field, used, smooth)
    for group, motion in parts:
        chosen = [patches[p] for p in group]
        rest = motion.rest(_points(chosen), _shares(chosen))
        for a in range(3):
            entries = np.ix_(group, np.array([a]), group, np.array([a]))
            covariance[entries] += rest[a][:, None, :, None]
    return PatchMotion(seen, mean, gradient, growth, covariance)


def _spacing(points: Points) -> float:
    """Typical distance of neighbouring points [m]."""
    if len(points) <= _NEIGHBOURS:
        return 0.0
    return float(np.median(cKDTree(points).query(points, _NEIGHBOURS + 1)[0][:, -1]))


def _around(
    mesh: TriangleMesh,
    field: DisplacementField,
    measured: _Rows,
    patch: Patch,
    pressing: Sequence[Patch],
    spacing: float,
) -> _Rows:
    """Measured points that tell how a patch moves, nearest first; none where they do not surround
    it."""
    points = field.points[measured]
    distance = np.linalg.norm(points - patch.centre, axis=1)
    facing = unit_normals(mesh)[field.surface.triangle[measured]] @ patch.normal > 0.0
    apart = [float(np.linalg.norm(tool.centre - patch.centre)) - tool.reach for tool in pressing]
    is_pressed = min(apart, default=np.inf) < patch.reach
    reach = patch.reach if is_pressed else max(patch.reach, spacing)
    if (facing & (distance <= reach)).sum() < _SURROUNDING:
        return measured[:0]
    nearer = np.ones(len(points), dtype=bool)
    for tool in pressing if not is_pressed else ():
        nearer &= distance < np.linalg.norm(points - tool.centre, axis=1)
    order = np.flatnonzero(nearer)[np.argsort(distance[nearer], kind="stable")]
    count = max(_NEAREST, int((distance[order] < _REACHES * patch.reach).sum()))
    chosen = order[:count]
    return measured[chosen[:: -(-len(chosen) // _MOST)]]


def _groups(patches: Sequence[Patch], seen: Sequence[bool]) -> list[_Rows]:
    """Numbers of the seen patches, those that overlap together."""
    rows = np.flatnonzero(seen)
    centre = np.array([patches[p].centre for p in rows.tolist()]).reshape(-1, 3)
    reach = np.array([patches[p].reach for p in rows.tolist()])
    distance = np.linalg.norm(centre[:, None] - centre[None], axis=2)
    count, label = connected_components(distance <= reach[:, None] + reach, directed=False)
    return [rows[label == k] for k in range(count)]


def _points(patches: Sequence[Patch]) -> Points:
    return np.concatenate([patch.points for patch in patches])


def _shares(patches: Sequence[Patch]) -> Float[np.ndarray, "p q"]:
    """Shares of all points of several patches in the average over each."""
    return block_diag(*(patch.share[:1] for patch in patches))


def _noise(field: DisplacementField, rows: _Rows) -> Float[np.ndarray, "3 k k"]:
    """Covariance of each component's noise at some points [m^2], or one where it is not given."""
    std = np.ones((len(rows), 3)) if field.std is None else field.std[rows]
    shared = field.correlation.subset(rows, len(field.points))
    noise = np.stack([np.diag(variance) for variance in std.T**2])
    (first, other), value = shared.pair.T, shared.value
    noise[:, first, other] = (value[:, None] * std[first] * std[other]).T
    noise[:, other, first] = noise[:, first, other]
    if not len(value):
        return noise
    # Correlations that are known pair by pair need not fit together.
    size, axes = np.linalg.eigh(noise)
    return np.asarray((axes * np.clip(size, 1e-6 * size[:, -1:], None)[:, None]) @ axes.mT)


def _spread(
    field: DisplacementField, used: _Rows, smooth: Float[np.ndarray, "p 3 n"]
) -> Float[np.ndarray, "p 3 p 3"]:
    """Covariance of smoothed displacements from the noise as it is claimed."""
    weights = smooth[:, :, used]
    std = np.ones((len(used), 3)) if field.std is None else field.std[used]
    block = std[:, :, None] * np.eye(3) * std[:, None]
    if field.covariance is not None:
        block = field.covariance[used]
    spread = np.einsum("pan,nab,qbn->paqb", weights, block, weights, optimize=True)
    shared = field.correlation.subset(used, len(field.points))
    scaled = weights * std.T
    first, other = scaled[:, :, shared.pair[:, 0]] * shared.value, scaled[:, :, shared.pair[:, 1]]
    across = np.einsum("pam,qam->apq", first, other)
    for a in range(3):
        spread[:, a, :, a] += across[a] + across[a].T
    # As above: what pairs have in common need not make a covariance.
    size, axes = np.linalg.eigh(spread.reshape(3 * len(weights), -1))
    return np.asarray((axes * np.clip(size, 0.0, None)) @ axes.T).reshape(spread.shape)
