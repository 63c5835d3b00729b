"""Parts of a body with moduli of their own: their elements, and the moduli that fit best.

A region is a field that is 1 in it and 0 outside: in each element, the share of its volume. The
coefficient is the logarithm of the region's modulus over that of the rest, which is G.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

import numpy as np
from jaxtyping import Bool, Float

from palpate.errors import InputError, MeshError
from palpate.estimation import (
    Evaluation,
    FitSettings,
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseTerms,
    joint_minimum,
)
from palpate.field.elements import ELEMENTS, VOLUME, no_field_reason
from palpate.field.field_fit import Fitted, expanded_about_best, modes_in
from palpate.field.field_map import map_of
from palpate.field.field_prior import FieldModes
from palpate.field.field_responses import CoefficientPrior, FieldExpansion, PushModel, push_model
from palpate.geometry import TriangleMesh, enclosed_volume, inside, triangle_areas
from palpate.progress import Progress, silent
from palpate.records import (
    HALF_95,
    RATIO,
    YOUNG,
    Box,
    Constant,
    Insert,
    Layer,
    ModulusMap,
    Region,
    RegionEstimate,
    Session,
    Skin,
)
from palpate.shapes import Points, Vector3
from palpate.solids import (
    GradedBody,
    Solid,
    make_solid,
    with_moduli,
)

# Change of the logarithm of a modulus that ends the rounds: of second order in what it leaves.
_TOLERANCE = 0.01
# Standard deviation of the logarithm of a ratio of which nothing is known: within a factor of 100.
_UNKNOWN = float(np.log(10.0))
# Points along the longest side of a body at which its regions are looked at, and points of all
# regions that there is time for: half a minute.
_LATTICE, _MOST_POINTS = 32, 1_000_000
# Elements that a fit has time for, a minute or so, and that a region has at least where half its
# thickness asks for more.
_MOST_ELEMENTS, _IN_A_REGION = 40_000, 5000
# A region is not seen where its standard deviation is more than this of the prior's; and is
# determined where the ends of its interval differ by less than this factor, as for all moduli.
_UNSEEN, _MAX_FACTOR = 0.9, 2.0
# Share of the object that regions may fill: more leaves nothing to be the rest.
_MOST_OF_ALL = 0.99


@dataclass(frozen=True, slots=True, eq=False)
class RegionFit:
    """Regions with what the data say about their moduli.

    Attributes
    ----------
    regions : tuple of k Region
    expansion : FieldExpansion      about the moduli that fit best
    prior : CoefficientPrior
    observations : list of ProbeObservations    with the regions' response, their coefficients as
                                    errors that all probings share
    """

    regions: tuple[Region, ...]
    expansion: FieldExpansion
    prior: CoefficientPrior
    observations: list[ProbeObservations]

    def with_field(
        self, session: Session, observations: Sequence[ProbeObservations]
    ) -> list[ProbeObservations]:
        """As of every `UnevenBody`."""
        return _with_cut_elements(self.expansion.under(session, observations), self.prior)

    def estimates(self, minimum: Evaluation) -> tuple[RegionEstimate, ...]:
        """What a fit of `observations` says of every region.

        Parameters
        ----------
        minimum : Evaluation
        """
        ratio, covariance = minimum.poisson_ratio, minimum.normal.covariance
        value, direction = _log_ratios(minimum, self.prior)
        # To log G of a region, and to its log E, from the logarithm of its ratio to the rest.
        young = np.log(2.0 * (1.0 + ratio))
        shift = np.array([0.0, minimum.theta[1], minimum.theta[1] + young])
        above = np.zeros((3, len(covariance)))
        above[1:, 1], above[2, 0] = 1.0, 1.0 / (1.0 + ratio)
        estimates = []
        for k, (region, entry) in enumerate(zip(self.regions, modes_in(minimum), strict=True)):
            rows = direction[k] + above
            stds = np.sqrt(np.einsum("ij,jk,ik->i", rows, covariance, rows))
            of_rest, shear, its_young = map(_constant, value[k] + shift, stds)
            is_seen = bool(region.known or covariance[entry, entry] < _UNSEEN**2)
            low, high = shear.ci95
            determined = high < _MAX_FACTOR * low
            estimates.append(
                RegionEstimate(
                    region.name, of_rest, shear, its_young, region.known, determined, is_seen
                )
            )
        return tuple(estimates)

    def map(self, minimum: Evaluation) -> ModulusMap:
        """The modulus of every element over that of the rest.

        Parameters
        ----------
        minimum : Evaluation
        """
        value, direction = _log_ratios(minimum, self.prior)
        model = self.expansion.model
        modes = model.body.means(model.modes.modes)
        covariance = direction @ minimum.normal.covariance @ direction.T
        seen = np.array([estimate.is_seen for estimate in self.estimates(minimum)])
        known = modes[:, ~seen].sum(axis=1) < 0.5
        return map_of(model.body.solid, modes @ value, modes, covariance, known)


def _log_ratios(
    minimum: Evaluation, prior: CoefficientPrior
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "k d"]]:
    """Logarithm of every region's modulus over G, and its derivative with respect to the common
    parameters."""
    where = modes_in(minimum)
    direction = np.zeros((len(prior.mean), minimum.problem.layout.common))
    direction[:, where] = prior.mixing
    direction[:, 0], direction[:, 1] = prior.by_ratio, prior.by_log_modulus
    moved = np.log(minimum.shear_modulus / prior.shear_modulus)
    value = prior.mean + prior.mixing @ minimum.theta[where] + prior.by_log_modulus * moved
    value += prior.by_ratio * (minimum.poisson_ratio - prior.poisson_ratio)
    return value, direction


def _constant(log_value: float, std: float) -> Constant:
    value, factor = float(np.exp(log_value)), float(np.exp(HALF_95 * std))
    return Constant(value, value * float(std), (value / factor, value * factor))


def fit_regions(
    session: Session,
    observations: Sequence[ProbeObservations],
    *,
    settings: FitSettings = FitSettings(),
    progress: Progress = silent,
) -> RegionFit:
    """Expand about the moduli of a session's regions that fit best.

    Parameters
    ----------
    session : Session                           k probings, with regions
    observations : sequence of k ProbeObservations      with the homogeneous body's response
    settings : FitSettings
    progress : callable

    Returns
    -------
    RegionFit

    Raises
    ------
    InputError, MeshError           as `make_region_model`
    NotConvergedError               the moduli do not settle
    """
    progress("finite elements", 0.0)
    model = make_region_model(session, observations)

    def fitted(
        expansion: FieldExpansion, last: Fitted[CoefficientPrior], _iteration: int
    ) -> Fitted[CoefficientPrior]:
        prior = _prior(session.regions, expansion.poisson_ratio, last.minimum.shear_modulus)
        minimum = joint_minimum(expansion.observations(prior), settings)
        return Fitted(minimum, _log_ratios(minimum, prior)[0], prior)

    plain = joint_minimum(observations, settings)
    prior = _prior(session.regions, plain.poisson_ratio, plain.shear_modulus)
    expansion, best = expanded_about_best(
        model, Fitted(plain, prior.mean, prior), fitted, tolerance=_TOLERANCE,
        what="the modulus of a region", progress=progress,
    )  # fmt: skip
    observed = _with_cut_elements(expansion, best.prior)
    return RegionFit(session.regions, expansion, best.prior, observed)


def _with_cut_elements(
    expansion: FieldExpansion, prior: CoefficientPrior
) -> list[ProbeObservations]:
    """Observations with the error of elements that a region's boundary cuts: half of the step from
    one modulus in each of them, the geometric mean, to one at each of its quadrature points."""
    model, observations = cast(PushModel, expansion.model), expansion.observations(prior)
    body, ratio = model.body, expansion.poisson_ratio
    log_modulus = model.modes.modes @ expansion.coefficients
    coarser = body.constant @ body.means(log_modulus[:, None])[:, 0]
    moved = with_moduli(body, coarser, ratio).displacements(model.every_load)
    step = 0.5 * (model.moved(expansion.coefficients, ratio) - moved)
    parameter = NuisanceParameter("elements that regions cut", 1.0, is_model_error=True)
    return [
        _with_change(probe, parameter, points.from_nodes @ step[:, k])
        for k, (probe, points) in enumerate(zip(observations, model.points, strict=True))
    ]


def _with_change(
    probe: ProbeObservations, parameter: NuisanceParameter, change: Float[np.ndarray, " n"]
) -> ProbeObservations:
    """A probing with an error that changes its displacements, times the modulus, in proportion to
    its force."""
    along = probe.force / (probe.force @ probe.force)

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c 1"]:
        moved = np.zeros((len(at.rows), 1, at.value.shape[2], 1))
        moved[:, 0, :3, 0] = along * change[at.rows, None]
        return moved

    return replace(probe, nuisances=(*probe.nuisances, Nuisance((parameter,), effects)))


def _prior(regions: Sequence[Region], ratio: float, modulus: float) -> CoefficientPrior:
    """What is known of the logarithms of the ratios before the data, at a Poisson's ratio and a
    shear modulus of the rest."""
    mean, by_ratio, by_log_modulus = np.zeros((3, len(regions)))
    std = np.full(len(regions), _UNKNOWN)
    for k, region in enumerate(regions):
        if not region.known:
            continue
        std[k] = region.std / region.value
        mean[k] = np.log(region.value)
        if region.known != RATIO:
            mean[k] -= np.log(modulus)
            by_log_modulus[k] = -1.0
        if region.known == YOUNG:
            mean[k] -= np.log(2.0 * (1.0 + ratio))
            by_ratio[k] = -1.0 / (1.0 + ratio)
    names = tuple(f"modulus of region {region.name!r}" for region in regions)
    return CoefficientPrior(names, np.diag(std), mean, by_ratio, by_log_modulus, ratio, modulus)


def make_region_model(
    session: Session, observations: Sequence[ProbeObservations] = ()
) -> PushModel:
    """Finite elements for a session's object, fine enough for its regions, and the loads of its
    probings.

    Parameters
    ----------
    session : Session               its contacts with radii
    observations : sequence of ProbeObservations    of the homogeneous body

    Returns
    -------
    PushModel                       its modes are 1 within a region, 0 outside

    Raises
    ------
    InputError                      supports or loads that regions are not computed for; as
                                    `check_regions`
    MeshError                       the surface cannot be filled
    """
    if reason := no_field_reason(session):
        raise InputError(f"{session.path}: {reason} Fit with --material homogeneous")
    solid = _filled(session)

    def modes_of(body: GradedBody) -> FieldModes:
        points = body.points.reshape(-1, 3)
        within = np.stack([_within(region, points) for region in session.regions], axis=1)
        return FieldModes(1.0 * within, np.zeros(0), (), np.zeros(len(points)))

    return push_model(session, observations, solid, modes_of)


def check_regions(session: Session) -> list[Points]:
    """Refuse regions that are no parts of the object, or too thin for any elements.

    Parameters
    ----------
    session : Session

    Returns
    -------
    list of (n, 3) float [m]        evenly spaced points in each region

    Raises
    ------
    InputError                      a region outside the object, or thinner than elements can be;
                                    two that overlap; or no rest
    """
    try:
        return _separate_points(session.mesh, session.regions)
    except InputError as error:
        raise InputError(f"{session.path}: {error}") from error


def _separate_points(mesh: TriangleMesh, regions: Sequence[Region]) -> list[Points]:
    """Evenly spaced points in each region, in which no other is."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    _check_thickness(mesh, regions)
    inside = [_points_in(region, mesh) for region in regions]
    for k, (region, points) in enumerate(zip(regions, inside, strict=True)):
        if not len(points):
            ends = (", ".join(f"{x:.3g}" for x in corner + 0.0) for corner in (low, high))
            raise InputError(
                f"region {region.name!r} is outside the object, which is from ({next(ends)}) to"
                f" ({next(ends)}) m: check its place and length_unit"
            )
        for other in regions[:k]:
            if share := float(_within(other, points).mean()):
                raise InputError(
                    f"{100.0 * share:.3g} % of region {region.name!r} lie in region {other.name!r},"
                    " too; a point belongs to one of them: make one smaller"
                )
        _size_in(region, points, mesh)
    volume = sum(
        len(points) * _step(region, mesh) ** 3
        for region, points in zip(regions, inside, strict=True)
    )
    if volume > _MOST_OF_ALL * enclosed_volume(mesh):
        raise InputError(
            "the regions fill the whole object; leave one of them out: G is the modulus of the rest"
        )
    return inside


def _points_in(region: Region, mesh: TriangleMesh) -> Points:
    """Evenly spaced points in the part of a region that lies in the object."""
    step = _step(region, mesh)
    ends = zip(*_bounds(region, mesh), strict=True)
    axes = [np.arange(a + 0.5 * step, b, step) for a, b in ends]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    points = points[_within(region, points)]
    return points[inside(mesh, points)] if len(points) else points


def _bounds(region: Region, mesh: TriangleMesh) -> tuple[Vector3, Vector3]:
    """Lowest and highest corner of a box around what of a region lies in the object."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    if isinstance(region.shape, Skin | Layer):
        return low, high
    corners = region.shape.bounds
    return np.maximum(low, corners[0]), np.minimum(high, corners[1])


def _check_thickness(mesh: TriangleMesh, regions: Sequence[Region]) -> None:
    """Refuse regions too thin, or too many, before a point of them is made."""
    counts = []
    for region in regions:
        shape = region.shape
        if isinstance(shape, Skin | Layer):
            area = enclosed_volume(mesh) ** (2.0 / 3.0)
            if isinstance(shape, Skin):
                area = float(triangle_areas(shape.faces).sum())
            _check_elements(region, area * shape.thickness, shape.thickness)
        low, high = _bounds(region, mesh)
        counts.append(float(np.prod(np.clip(high - low, 0.0, None) / _step(region, mesh))))
    if sum(counts) > _MOST_POINTS:
        worst = regions[int(np.argmax(counts))]
        raise InputError(
            f"to tell the regions from the rest takes {sum(counts):.2g} points, most of them for"
            f" {worst.name!r}, which is {1e3 * worst.shape.thickness:.2g} mm thick; there is time"
            f" for {_MOST_POINTS:g}: give fewer regions, or thicker ones"
        )


def _step(region: Region, mesh: TriangleMesh) -> float:
    """Distance of the points at which a region is looked at."""
    longest = float(np.ptp(mesh.vertices, axis=0).max())
    return min(longest / _LATTICE, region.shape.thickness)


def _usual_edge(mesh: TriangleMesh) -> float:
    """Edge of elements away from regions [m]."""
    return float((enclosed_volume(mesh) / (VOLUME * ELEMENTS)) ** (1.0 / 3.0))


def _size_in(region: Region, points: Points, mesh: TriangleMesh) -> float:
    """Size of the elements of a region [m], of which there must not be too many."""
    thickness, volume = region.shape.thickness, len(points) * _step(region, mesh) ** 3
    wanted = (volume / (VOLUME * _IN_A_REGION)) ** (1.0 / 3.0)
    small = min(thickness, max(0.5 * thickness, wanted))
    if small < _usual_edge(mesh):
        _check_elements(region, volume, small)
    return small


def _check_elements(region: Region, volume: float, size: float) -> None:
    """Refuse a region that takes too many elements of its own and around it, where they grow by
    0.3 m/m on both of its sides, or on one of a skin: within a factor of two."""
    thickness, sides = region.shape.thickness, 1 if isinstance(region.shape, Skin) else 2
    around = sides / (2.0 * 0.3 * thickness)
    count = volume / (VOLUME * size**2) * (1.0 / size + around)
    if count > _MOST_ELEMENTS:
        raise InputError(
            f"region {region.name!r} is {1e3 * thickness:.2g} mm thick, which takes {count:.0f}"
            f" elements there and around; a fit has time for {_MOST_ELEMENTS}: make it part of the"
            " rest, or thicker"
        )


def _within(region: Region, points: Points) -> Bool[np.ndarray, " n"]:
    """Which points of the object lie in a region."""
    if not isinstance(region.shape, Insert):
        return region.shape.contains(points)
    # The cheap test first.
    near = Box(*region.shape.bounds).contains(points)
    near[near] = inside(region.shape.surface, points[near])
    return near


def _filled(session: Session) -> Solid:
    """The object in elements no larger than its regions are thick, half as large in small ones,
    that follow boxes and inserts."""
    mesh, edge, fine = session.mesh, _usual_edge(session.mesh), []
    for region, points in zip(session.regions, check_regions(session), strict=True):
        if (small := _size_in(region, points, mesh)) < edge:
            fine += [(point, _step(region, mesh), small) for point in points]
    shapes = [region.shape for region in session.regions]
    walls = [shape.surface for shape in shapes if isinstance(shape, Insert)]
    walls += [
        Box(*_bounds(region, mesh)).surface
        for region in session.regions
        if isinstance(region.shape, Box)
    ]
    try:
        return make_solid(mesh, edge=edge, fine=fine, walls=walls)
    except MeshError:
        # Of a region as thin as its elements, nodes opposite each other leave flat ones.
        return make_solid(mesh, edge=edge, fine=fine)
