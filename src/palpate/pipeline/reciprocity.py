"""A test of a measurement that needs no model: the work of one push's force in the motion under
another is that of the other's in the motion under the first.

Betti's law holds for every linear elastic body on fixed or springy supports, whatever its material
and shape. How the patch under one tool moves when another presses is measured, so every two pushes
whose patches are seen in each other's measurement are compared. Pairs share forces, patches and
displacements; their differences are judged together.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.linalg import null_space
from scipy.special import chdtrc, ndtr

from palpate.estimation import FALSE_ALARM
from palpate.geometry import area_vectors
from palpate.pipeline.model.shared_errors import calibration_strains
from palpate.pipeline.model.supports import (
    MovingSupport,
    given_motion,
    moving_supports,
    rigid_modes,
)
from palpate.pipeline.patch_motion import Patch, PatchMotion, make_patch, patch_motion
from palpate.records import (
    FREE,
    RIGID,
    Contact,
    ForceExcess,
    Load,
    Probing,
    Reciprocity,
    Session,
    WorkPair,
)
from palpate.shapes import Vector3
from palpate.threads import map_in_threads

# The push that explains the pairs best is named alone if all other ones together are less likely;
# in so many sound sessions one is named though the law is not broken.
_DOUBT, _SUSPICION = 0.2, 0.025
# Relative standard deviation of the radius of a tool's contact before it is known.
_ANY_RADIUS = 0.5
# Of a work: no work is known better.
_FINEST = 1e-5
# Of the largest force: where forces differ by less, one told too large would look like motion that
# does not grow in proportion.
_ALIKE = 0.25
_Pairs = tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"]]


@dataclass(frozen=True, slots=True, eq=False)
class _Works:
    """Loads of k probings, a patch each, and how these move in every probing.

    Attributes
    ----------
    probings : tuple of k Probing
    patches : tuple of l Patch
    owner : (k, l) float            1 where the load belongs to the probing, else 0
    force : (l, 3) float [N]        of the loads
    tool : (l, 3) float [N]         the same of tools; 0 for other loads, which are exact
    motions : tuple of k PatchMotion
    mean : (k, l, 3) float [m]      how the patches move in each, relative to a support whose motion
                                    is given
    """

    probings: tuple[Probing, ...]
    patches: tuple[Patch, ...]
    owner: Float[np.ndarray, "k l"]
    force: Float[np.ndarray, "l 3"]
    tool: Float[np.ndarray, "l 3"]
    motions: tuple[PatchMotion, ...]
    mean: Float[np.ndarray, "k l 3"]

    def of(
        self, force: Float[np.ndarray, "l 3"], moved: Float[np.ndarray, "k l 3"]
    ) -> Float[np.ndarray, "k k"]:
        """Works [J]: entry [i, j] that of the loads of j in a motion of the patches in i."""
        return np.asarray(np.einsum("la,ila->il", force, moved) @ self.owner.T)

    @property
    def sizes(self) -> Float[np.ndarray, " k"]:
        """Force of every tool [N]."""
        return np.asarray(self.owner @ np.linalg.norm(self.tool, axis=1))

    @property
    def seen(self) -> Bool[np.ndarray, "k k"]:
        """Entry [i, j]: the patches of j are seen in i."""
        hidden = ~np.stack([motion.seen for motion in self.motions])
        return np.asarray(hidden @ self.owner.T == 0.0)


def reciprocity(session: Session) -> Reciprocity:
    """Test the pushes of a session against each other.

    Parameters
    ----------
    session : Session

    Returns
    -------
    Reciprocity

    Raises
    ------
    InputError                      a motion of a support that is to be given, and is not
    RecordError, CalibrationError   a rig that cannot be read
    """
    moving = moving_supports(session)
    if moving and (len(session.supports) > 1 or session.supports[0].directions is not None):
        return _untested(
            "Supports move, and the work of their reactions is known only of a single support that"
            " holds in all directions."
        )
    probings = tuple(probing for probing in session.probings if probing.displacement is not None)
    gripped = [probing.name for probing in probings if probing.contact.profile == RIGID]
    reasons = [f"A grip pulls in {', '.join(gripped)}, not a tool."] if gripped else []
    probings = tuple(probing for probing in probings if probing.name not in gripped)
    if len(probings) < 2:
        return _untested(*reasons, "It takes two pushes with measured displacements.")
    works = _works(session, probings, moving)
    reasons += _unseen(works)
    first, other = np.nonzero(np.triu(works.seen & works.seen.T, 1))
    if not first.size:
        return _untested(*reasons)
    return _judged(session, works, moving, (first, other), tuple(reasons))


def _untested(*reasons: str) -> Reciprocity:
    return Reciprocity((), (), 0.0, 0, 1.0, None, (), False, True, untested=reasons)


def _works(
    session: Session, probings: tuple[Probing, ...], moving: Sequence[MovingSupport]
) -> _Works:
    """Loads of the probings, and how their patches move in each."""
    patches: list[Patch] = []
    rows: list[tuple[int, Vector3, bool]] = []
    for k, probing in enumerate(probings):
        if probing.force.any():
            patches.append(make_patch(session.mesh, probing.contact))
            rows.append((k, probing.force, True))
        for load in probing.loads:
            for patch, force in _parts(session, load):
                patches.append(patch)
                rows.append((k, force, False))
    owner = np.array([k for k, _, _ in rows]) == np.arange(len(probings))[:, None]
    force = np.stack([patch_force for _, patch_force, _ in rows])
    tool = force * np.array([by_tool for _, _, by_tool in rows])[:, None]
    fields = [probing.displacement for probing in probings if probing.displacement is not None]
    pressing_patches = [[patches[p] for p in np.flatnonzero(is_own)] for is_own in owner]
    motions = tuple(
        map_in_threads(
            lambda field, pressing: patch_motion(session.mesh, field, patches, pressing),
            fields,
            pressing_patches,
        )
    )
    mean = np.stack([motion.mean for motion in motions])
    for support in moving:
        if support.motion != FREE:
            modes = _modes(patches, support)
            for k, probing in enumerate(probings):
                mean[k] -= modes @ given_motion(session, probing, support).value
    return _Works(probings, tuple(patches), 1.0 * owner, force, tool, motions, mean)


def _parts(session: Session, load: Load) -> list[tuple[Patch, Vector3]]:
    """Patches and forces of a load; of a pressure, of each triangle."""
    if load.force is not None:
        return [(make_patch(session.mesh, load.contact), load.force)]
    triangles = load.contact.triangles
    pressure = load.pressure or 0.0
    return [
        (
            make_patch(session.mesh, Contact(np.zeros(3), None, "uniform", np.array([triangle]))),
            -pressure * area,
        )
        for triangle, area in enumerate(area_vectors(session.mesh))
        if triangles is not None and triangle in triangles
    ]


def _modes(patches: Sequence[Patch], support: MovingSupport) -> Float[np.ndarray, "l 3 6"]:
    """Displacement of the patches' centres per rigid motion of the support."""
    return rigid_modes(np.stack([patch.centre for patch in patches]), support.centre)


def _unseen(works: _Works) -> list[str]:
    """A sentence on pushes that are in no pair; empty if there are none."""
    both = works.seen & works.seen.T
    np.fill_diagonal(both, False)
    names = [works.probings[k].name for k in np.flatnonzero(~both.any(axis=1))]
    if not names:
        return []
    if not both.any():
        text = (
            "No two pushes see each other's contacts: measured points must surround the contact of"
            " one while the other presses."
        )
    else:
        text = (
            f"No other push sees the contact of {', '.join(names)}, or they do not see the others':"
            " measured points must surround a contact while another tool presses."
        )
    return [text]


def _changes(
    session: Session, works: _Works, moving: Sequence[MovingSupport]
) -> Iterator[Float[np.ndarray, "k k"]]:
    """Change of the works per standard deviation of every error but the displacements' noise."""
    priors, axes, count = session.errors, np.eye(3), len(works.probings)
    gradient = np.stack([motion.gradient for motion in works.motions])
    growth = np.stack([motion.growth for motion in works.motions])
    identity = np.eye(count)
    for k, probing in enumerate(works.probings):
        tool = works.tool * works.owner[k][:, None]
        if not tool.any():
            continue
        for a, std in enumerate(session.force_std(probing)):
            unit = (tool != 0.0).any(axis=1)[:, None] * axes[a]
            yield std * works.of(unit, works.mean)
        point_std = priors.contact_std(probing.name)
        for a in range(3):
            yield point_std * works.of(tool, gradient[..., a])
        known = probing.contact.tool is None
        yield (priors.contact_radius if known else _ANY_RADIUS) * works.of(tool, growth)
    for sensor in {probing.force_sensor for probing in works.probings}:
        read = np.array([probing.force_sensor == sensor for probing in works.probings])
        tool = works.tool * (read @ works.owner)[:, None]
        yield priors.gain_std(sensor) * works.of(tool, works.mean)
        for a in range(3):
            yield priors.force_direction * works.of(np.cross(axes[a], tool), works.mean)
    centre = session.mesh.vertices.mean(axis=0)
    offset = np.stack([patch.centre for patch in works.patches]) - centre
    for a in range(3):
        yield priors.length_scale * works.of(works.force, works.mean * axes[a])
        yield priors.pose_translation * works.of(works.force, gradient[..., a])
        shift = np.einsum("klab,lb->kla", gradient, np.cross(axes[a], offset))
        turned = np.cross(axes[a], works.mean) - shift
        yield priors.pose_rotation * works.of(works.force, turned)
    strains = calibration_strains(session)
    for strain in () if strains is None else strains:
        yield works.of(works.force, works.mean @ strain)
    for support in moving:
        if support.motion != FREE:
            modes = _modes(works.patches, support)
            for k, probing in enumerate(works.probings):
                std = given_motion(session, probing, support).std
                for m in np.flatnonzero(std):
                    yield identity[k][:, None] * works.of(
                        works.force, std[m] * np.tile(modes[..., m], (count, 1, 1))
                    )


def _unknowns(
    session: Session, works: _Works, moving: Sequence[MovingSupport]
) -> Iterator[Float[np.ndarray, "k k"]]:
    """Change of the works per unit of what is not known at all: the work of the weight, which acts
    in every push alike, and motions of a support that is free."""
    count = len(works.probings)
    for k in range(count):
        row = np.eye(count)[k][:, None]
        if session.added_gravity is not None:
            yield row * np.ones((count, count))
        for support in moving:
            if support.motion == FREE:
                for mode in np.moveaxis(_modes(works.patches, support), 2, 0):
                    yield row * works.of(works.force, np.tile(mode, (count, 1, 1)))


def _judged(
    session: Session,
    works: _Works,
    moving: Sequence[MovingSupport],
    pairs: _Pairs,
    reasons: tuple[str, ...],
) -> Reciprocity:
    """Test of all pairs together, and of every push against the others."""
    first, other = pairs
    matrix = works.of(works.force, works.mean)
    errors = list(_changes(session, works, moving))
    columns = _differences(np.stack(errors), pairs)
    covariance = columns.T @ columns + _noise(works, pairs)
    finest = _FINEST * np.maximum(np.abs(matrix[first, other]), np.abs(matrix[other, first]))
    covariance += np.diag(finest**2)
    names = [probing.name for probing in works.probings]
    works_of = zip(matrix[first, other], matrix[other, first], np.diag(covariance), strict=True)
    judged = tuple(
        WorkPair(names[i], names[j], float(work), float(back), float(np.sqrt(variance)))
        for i, j, (work, back, variance) in zip(first, other, works_of, strict=True)
    )
    unknowns = list(_unknowns(session, works, moving))
    known = np.eye(len(first))
    if unknowns:
        free = _differences(np.stack(unknowns), pairs)
        length = np.linalg.norm(free, axis=1, keepdims=True)
        known = null_space(free / np.where(length > 0.0, length, 1.0))
    if not known.shape[1]:
        return _untested(
            *reasons, "With so few pushes the motion of the support takes up all that they tell."
        )
    inverse = np.linalg.inv(np.linalg.cholesky(known.T @ covariance @ known)) @ known.T
    white = inverse @ (matrix[first, other] - matrix[other, first])
    chi_square, degrees = float(white @ white), len(white)
    pushes, growth = _excesses(session, works, pairs, inverse, white)
    chance = float(chdtrc(degrees, chi_square))
    far = [abs(excess.sigmas) for excess in (*pushes, growth) if excess is not None]
    # By chance alone one of them is as far in this share of sound sessions.
    far_by_chance = 2.0 * len(far) * float(ndtr(-max(far, default=0.0)))
    holds = min(chance, far_by_chance if far else 1.0) > FALSE_ALARM
    odd: tuple[str, ...] = ()
    grows = False
    if far and far_by_chance < _SUSPICION:
        odd, grows = _suspects(pushes, growth, chi_square, degrees)
        if holds and (grows or len(odd) > 1):
            odd, grows = (), False
    least, std, passive = _own_work(session, works, errors)
    return Reciprocity(
        judged, pushes, chi_square, degrees, chance, growth, odd, grows, holds,
        least, std, passive, reasons,
    )  # fmt: skip


def _differences(change: Float[np.ndarray, "e k k"], pairs: _Pairs) -> Float[np.ndarray, "e p"]:
    """Changes of the pairs' differences from those of the works."""
    first, other = pairs
    return np.asarray(change[:, first, other] - change[:, other, first])


def _noise(works: _Works, pairs: _Pairs) -> Float[np.ndarray, "p p"]:
    """Covariance of the pairs' differences from the noise of the displacements [J^2]."""
    first, other = pairs
    total = np.zeros((len(first), len(first)))
    for i in range(len(works.probings)):
        sign = 1.0 * (first == i) - (other == i)
        partner = np.where(first == i, other, first)
        total += np.outer(sign, sign) * _own_noise(works, i)[np.ix_(partner, partner)]
    return total


def _own_noise(works: _Works, index: int) -> Float[np.ndarray, "k k"]:
    """Covariance of all works in the motion under one push [J^2]."""
    loaded = works.owner[:, :, None] * works.force
    covariance = works.motions[index].covariance
    return np.asarray(np.einsum("kla,lamb,nmb->kn", loaded, covariance, loaded, optimize=True))


def _excesses(
    session: Session,
    works: _Works,
    pairs: _Pairs,
    inverse: Float[np.ndarray, "d p"],
    white: Float[np.ndarray, " d"],
) -> tuple[tuple[ForceExcess, ...], ForceExcess | None]:
    """Excess of each force, and of the largest one if excess grows in proportion to force."""
    # Symmetric, as the law has it: else differences by noise would look like forces too large.
    by_tool, sizes = works.of(works.tool, works.mean), works.sizes
    by_tool = 0.5 * (by_tool + by_tool.T)

    def excess(name: str, change: Float[np.ndarray, "k k"], known: float) -> ForceExcess | None:
        along = inverse @ _differences(change[None], pairs)[0]
        square = float(along @ along)
        if square == 0.0:
            return None
        value, excesses = float(along @ white) / square, 1.0 / square
        std = float(np.sqrt(max(excesses - known**2, 0.0)))
        sigmas = value * float(np.sqrt(square))
        # Of the mean of both works, half of which is without the excess.
        shrunk = 1.0 - 0.5 * min(value, 1.0)
        return ForceExcess(name, value / shrunk, std / shrunk**2, sigmas)

    excesses = []
    for k in np.unique(pairs):
        probing = works.probings[k]
        along = session.force_std(probing) * probing.force
        known = float(np.linalg.norm(along)) / max(sizes[k] ** 2, np.finfo(float).tiny)
        excesses.append(excess(probing.name, by_tool * np.eye(len(sizes))[k], known))
    share = sizes / max(float(sizes.max()), np.finfo(float).tiny)
    used = share[np.unique(pairs)]
    growth = excess("", by_tool * share, 0.0) if np.ptp(used) > _ALIKE else None
    return tuple(push for push in excesses if push is not None), growth


def _suspects(
    pushes: Sequence[ForceExcess], growth: ForceExcess | None, chi_square: float, degrees: int
) -> tuple[tuple[str, ...], bool]:
    """Pushes one of which may have a wrong force, and whether motion out of proportion to the force
    may be the cause instead; none where no such cause explains the pairs."""
    every = [*pushes, *([growth] if growth is not None else [])]
    fall = np.array([push.sigmas**2 for push in every])
    if degrees > 1 and chdtrc(degrees - 1, chi_square - fall.max()) < FALSE_ALARM:
        return (), False
    likely = np.exp(0.5 * (fall - fall.max()))
    order = np.argsort(-likely, kind="stable")
    count = 1 + int((np.cumsum(likely[order]) < (1.0 - _DOUBT) * likely.sum()).sum())
    chosen = [every[k] for k in order[:count]]
    return tuple(push.name for push in chosen if push is not growth), growth in chosen


def _own_work(
    session: Session, works: _Works, errors: Sequence[Float[np.ndarray, "k k"]]
) -> tuple[float, float, tuple[str, ...]]:
    """Least work of forces in their own motion, over that of each apart, its standard deviation,
    and the pushes that it covers: those whose own contact's motion was measured."""
    count, mean, tip = len(works.probings), works.mean.copy(), np.zeros(len(works.probings))
    seen = works.seen
    for k, probing in enumerate(works.probings):
        moved, std = probing.tip_displacement, probing.tip_displacement_std
        if moved is not None and np.isfinite(moved).all() and probing.force.any():
            mean[k, works.owner[k].argmax()] = moved
            tip[k] = 0.0 if std is None else np.linalg.norm(std * probing.force)
            seen[k, k] = True
    both = seen & seen.T
    rows = np.flatnonzero(np.diag(both) & (works.owner.sum(axis=1) == 1))
    while rows.size and not (whole := both[np.ix_(rows, rows)]).all():
        rows = np.delete(rows, whole.sum(axis=1).argmin())
    if not rows.size or session.added_gravity is not None or moving_supports(session):
        return np.nan, np.nan, ()
    whole = np.ix_(rows, rows)
    matrix = works.of(works.force, mean)[whole]
    scale = 1.0 / np.sqrt(np.abs(np.diag(matrix)))
    size, axes = np.linalg.eigh(0.5 * (matrix + matrix.T) * scale[:, None] * scale)
    mixture = np.zeros(count)
    mixture[rows] = scale * axes[:, 0]
    variance = _FINEST**2 + sum(float(mixture @ change @ mixture) ** 2 for change in errors)
    for k in rows.tolist():
        noise = _own_noise(works, k)
        if tip[k] > 0.0:
            noise[k], noise[:, k] = 0.0, 0.0
            noise[k, k] = tip[k] ** 2
        variance += mixture[k] ** 2 * float(mixture @ noise @ mixture)
    names = tuple(works.probings[k].name for k in rows)
    return float(size[0]), float(np.sqrt(variance)), names
