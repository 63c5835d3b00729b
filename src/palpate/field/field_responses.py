"""What a field of moduli changes in the responses of a session's probings.

The homogeneous body's response stays that of the boundary elements; finite elements give the
difference of a body with a field from one without. Their own error is mostly in the dent under the
tool, and that goes with the modulus there: of what boundary and finite elements differ by for the
homogeneous body, s times as much is missed, s the mean modulus over that under the tool.

    u(b, nu) = u(0, nu) + d(b0, nu) + (s(b0) - 1) (u(0) - u_FE(0)) + S(b0) (b - b0),

d the difference at the coefficients b0 about which it is expanded, S the derivative of all of it.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, Self, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, kron, vstack

from palpate.arrays import components_of
from palpate.errors import InputError
from palpate.estimation import (
    PLACES,
    Nuisance,
    NuisanceParameter,
    ProbeObservations,
    ResponseModel,
    ResponseTerms,
    Settlement,
)
from palpate.field.elements import (
    ELEMENTS,
    depth_below,
    elements_under,
    filled,
    no_field_reason,
    nodal_loads,
    nodal_shifts,
)
from palpate.field.field_prior import FieldModes, make_field_modes
from palpate.geometry import TriangleMesh, closest_points
from palpate.records import Session
from palpate.shapes import Points
from palpate.solids import (
    GradedBody,
    GradedStiffness,
    Solid,
    held_nodes,
    make_graded_body,
    surface_values,
    with_moduli,
)

# Probings whose derivatives are made at once; change of Poisson's ratio for the derivative of d.
_PART, _STEP = 8, 0.005
# Begins the names of a field's coefficients; what the budget calls them together.
_MODE, _SOURCE = "mode of the modulus", "modulus that differs from place to place"


@dataclass(frozen=True, slots=True, eq=False)
class CoefficientPrior:
    """Prior of a field's coefficients: b = mean + L xi, xi normal. The mean of a part whose own
    modulus is known depends on the constants: it is that at a Poisson's ratio and a modulus.

    Attributes
    ----------
    names : tuple of j str          of xi
    mixing : (b, j) float           L
    mean : (b,) float
    by_ratio : (b,) float           derivative of the mean with respect to Poisson's ratio
    by_log_modulus : (b,) float     the same with respect to log G
    poisson_ratio, shear_modulus : float [-], [Pa]
    """

    names: tuple[str, ...]
    mixing: Float[np.ndarray, "b j"]
    mean: Float[np.ndarray, " b"]
    by_ratio: Float[np.ndarray, " b"]
    by_log_modulus: Float[np.ndarray, " b"]
    poisson_ratio: float = 0.0
    shear_modulus: float = 1.0

    @property
    def parameters(self) -> tuple[NuisanceParameter, ...]:
        """xi, as errors that all probings share."""
        return tuple(
            NuisanceParameter(name, 1.0, of=_SOURCE, is_material=True) for name in self.names
        )


def smooth_prior(mixing: Float[np.ndarray, "b j"]) -> CoefficientPrior:
    """Prior of mean zero, b = L xi.

    Parameters
    ----------
    mixing : (b, j) float           L
    """
    names = tuple(f"{_MODE} {j}" for j in range(mixing.shape[1]))
    none = np.zeros(len(mixing))
    return CoefficientPrior(names, mixing, none, none, none)


@runtime_checkable
class UnevenBody(Protocol):
    """What was found of a body that is not the same everywhere: a field, regions, round parts or
    another cause."""

    def with_field(
        self, session: Session, observations: Sequence[ProbeObservations]
    ) -> list[ProbeObservations]:
        """Observations of other pushes of the same body, with what was found in the response, its
        coefficients as errors that all probings share.

        Parameters
        ----------
        session : Session                           k probings
        observations : sequence of k ProbeObservations      with the homogeneous body's response
        """


@dataclass(frozen=True, slots=True, eq=False)
class FieldModel(ABC):
    """Finite elements of a session's object under the loads of its probings.

    Attributes
    ----------
    body : GradedBody
    modes : FieldModes              at the quadrature points of the elements
    load : (3 n, k) float [N]       nodal forces of every probing
    session : Session
    observations : tuple of ProbeObservations       of its probings, of the homogeneous body
    """

    body: GradedBody
    modes: FieldModes
    load: Float[np.ndarray, "n3 k"]
    session: Session
    observations: tuple[ProbeObservations, ...]

    @abstractmethod
    def under(self, session: Session, observations: Sequence[ProbeObservations] = ()) -> Self:
        """This model of the body, under the loads of another session.

        Parameters
        ----------
        session : Session
        observations : sequence of ProbeObservations        of the homogeneous body
        """

    @abstractmethod
    def seen(self, moved: Float[np.ndarray, "n3 k"]) -> Float[np.ndarray, "*n"]:
        """What an expansion keeps of the displacements of every node under each load."""

    @property
    def every_load(self) -> Float[np.ndarray, "n3 l"]:
        """Nodal forces of every probing, and after them others of which responses are made."""
        return self.load

    @property
    def under_loads(self) -> Float[np.ndarray, "k b"]:
        """Modes under each load, by which s changes: means over the elements there."""
        return np.zeros((self.load.shape[1], self.modes.modes.shape[1]))

    @abstractmethod
    def derivative(
        self, stiffness: GradedStiffness, moved: Float[np.ndarray, "n3 k"]
    ) -> Float[np.ndarray, "*n b"]:
        """Derivative of what is observed with respect to the coefficients of the modes.

        Parameters
        ----------
        stiffness : GradedStiffness
        moved : (3 n, k) float [m Pa]       displacements with it
        """

    @abstractmethod
    def changed(
        self, expansion: "FieldExpansion", prior: CoefficientPrior
    ) -> list[ProbeObservations]:
        """`FieldExpansion.observations`."""

    def stiffness(
        self, coefficients: Float[np.ndarray, " b"], poisson_ratio: float
    ) -> GradedStiffness:
        """The body with a field.

        Parameters
        ----------
        coefficients : (b,) float       of the modes
        poisson_ratio : float [-]
        """
        return with_moduli(self.body, self.modes.modes @ coefficients, poisson_ratio)

    def moved(
        self, coefficients: Float[np.ndarray, " b"], poisson_ratio: float
    ) -> Float[np.ndarray, "n3 l"]:
        """Displacement of every node under `every_load`, times the mean modulus [m Pa].

        Parameters
        ----------
        coefficients, poisson_ratio     as `stiffness`
        """
        return self.stiffness(coefficients, poisson_ratio).displacements(self.every_load)

    def expanded(
        self,
        coefficients: Float[np.ndarray, " b"],
        poisson_ratio: float,
        homogeneous: Float[np.ndarray, "n3 l"],
    ) -> "FieldExpansion":
        """The responses' change by a field, about some coefficients and a Poisson's ratio.

        Parameters
        ----------
        coefficients, poisson_ratio     as `stiffness`
        homogeneous : (3 n, l) float [m Pa]     `moved` of the body without a field
        """
        stiffness = self.stiffness(coefficients, poisson_ratio)
        moved = stiffness.displacements(self.every_load)
        change = self.seen(moved - homogeneous)
        return FieldExpansion(
            self, coefficients, poisson_ratio, self.under_loads, self.seen(homogeneous), change,
            np.zeros_like(change), self.derivative(stiffness, moved[:, : self.load.shape[1]]),
        )  # fmt: skip


class MadeInParts:
    """Derivatives of probings, those of some made at a time when one of them is asked for: of all
    they would be most of what a fit of many pushes needs.

    Parameters
    ----------
    make : callable             slice of probings -> their derivatives, as `FieldExpansion` has them
    """

    def __init__(self, make: Callable[[slice], Float[np.ndarray, "p a b"]]) -> None:
        self._make, self._first = make, -1

    def __getitem__(self, index: int) -> Float[np.ndarray, "a b"]:
        """That of one probing."""
        first = index - index % _PART
        if first != self._first:
            self._part, self._first = self._make(slice(first, first + _PART)), first
        return self._part[index - first]


@dataclass(frozen=True, slots=True, eq=False)
class FieldExpansion:
    """Change of the responses by a field, to first order about some coefficients.

    Attributes
    ----------
    model : FieldModel
    coefficients : (b,) float                   b0
    poisson_ratio : float [-]                   nu0
    under_loads : (k, b) float                  modes under each load, by which s changes
    homogeneous : (..., k) float                u_FE(0), as `change`
    change : (..., k) float                     d under the load of each probing (`FieldModel.seen`)
    slope : (..., k) float                      its derivative with respect to Poisson's ratio; zero
                                                until it is asked for
    derivative : (k, ..., b) float, or parts of it      S (`FieldModel.derivative`)
    """

    model: FieldModel
    coefficients: Float[np.ndarray, " b"]
    poisson_ratio: float
    under_loads: Float[np.ndarray, "k b"]
    homogeneous: Float[np.ndarray, "*n"]
    change: Float[np.ndarray, "*n"]
    slope: Float[np.ndarray, "*n"]
    derivative: Float[np.ndarray, "*d b"] | MadeInParts

    def with_slope(self) -> "FieldExpansion":
        """Expansion with the derivative by Poisson's ratio, which takes two factorisations."""
        beside = self.poisson_ratio - _STEP
        moved = self.model.moved(self.coefficients, beside)
        moved -= self.model.moved(0.0 * self.coefficients, beside)
        return replace(self, slope=(self.change - self.model.seen(moved)) / _STEP)

    def under(
        self, session: Session, observations: Sequence[ProbeObservations]
    ) -> "FieldExpansion":
        """Expansion about the same field, for other pushes of the body.

        Parameters
        ----------
        session : Session           k probings
        observations : sequence of k ProbeObservations      of the homogeneous body
        """
        model, about, ratio = (
            self.model.under(session, observations), self.coefficients, self.poisson_ratio
        )  # fmt: skip
        return model.expanded(about, ratio, model.moved(0.0 * about, ratio)).with_slope()

    def observations(self, prior: CoefficientPrior) -> list[ProbeObservations]:
        """Observations with the field's response, its coefficients by xi as errors of unit standard
        deviation that all probings share.

        Parameters
        ----------
        prior : CoefficientPrior
        """
        return self.model.changed(self, prior)


@dataclass(frozen=True, slots=True, eq=False)
class SeenPoints:
    """Where the rows of a probing are among the elements.

    Attributes
    ----------
    from_nodes : (r, 3 n) sparse        their displacements from those of all nodes
    from_corners : (r, 3 c) sparse      the same from those of `PushModel.corners`
    vertices : (v, 3 n) sparse or None  as `from_nodes`, of all vertices and the tip, if asked for
    """

    from_nodes: csr_array
    from_corners: csr_array
    vertices: csr_array | None


@dataclass(frozen=True, eq=False)
class PushModel(FieldModel):
    """Finite elements of an object whose surface is seen to move.

    Attributes
    ----------
    corners : (c,) int              nodes on the surface at which derivatives are computed: those
                                    about the observed points
    points : tuple of SeenPoints    of every probing
    near : (k, m) sparse [-]        weights of the elements under each load; rows add up to 1
    """

    corners: Int[np.ndarray, " c"]
    points: tuple[SeenPoints, ...]
    near: csr_array

    def under(
        self, session: Session, observations: Sequence[ProbeObservations] = ()
    ) -> "PushModel":
        """See `FieldModel`."""
        return _push_model(self.body, self.modes, session, observations)

    @cached_property
    def shifts(self) -> Float[np.ndarray, "n3 k2"]:
        """What loads change by as contacts move [N] (`nodal_shifts`)."""
        return nodal_shifts(self.session, self.body.solid)

    @property
    def every_load(self) -> Float[np.ndarray, "n3 l"]:
        """See `FieldModel`: after the loads, what they change by as contacts move."""
        return np.concatenate([self.load, self.shifts], axis=1)

    @property
    def under_loads(self) -> Float[np.ndarray, "k b"]:
        """See `FieldModel`."""
        return self.near @ self.body.means(self.modes.modes)

    def seen(self, moved: Float[np.ndarray, "n3 k"]) -> Float[np.ndarray, "n3 k"]:
        """The displacements themselves."""
        return moved

    def derivative(
        self, stiffness: GradedStiffness, moved: Float[np.ndarray, "n3 k"]
    ) -> Float[np.ndarray, "k c3 b"]:
        """Derivative of the displacements of the corners."""
        basis = self.modes.modes
        # Whichever takes fewer solutions.
        if basis.shape[1] * moved.shape[1] < 3 * len(self.corners):
            changes = stiffness.changes(moved, basis)
            return changes[:, components_of(self.corners)]
        seen = stiffness.displacements(self.unit_loads(self.corners))
        return stiffness.sensitivities(seen, moved, basis)

    def unit_loads(self, corners: Int[np.ndarray, " c"]) -> Float[np.ndarray, "n3 c3"]:
        """One newton on each component of some nodes."""
        loads = np.zeros((3 * len(self.body.solid.nodes), 3 * len(corners)))
        loads[components_of(corners), np.arange(loads.shape[1])] = 1.0
        return loads

    def changed(
        self, expansion: FieldExpansion, prior: CoefficientPrior
    ) -> list[ProbeObservations]:
        """See `FieldExpansion.observations`."""
        return [
            _changed(expansion, k, probe, points, prior)
            for k, (probe, points) in enumerate(zip(self.observations, self.points, strict=True))
        ]


def _changed(
    expansion: FieldExpansion,
    index: int,
    probe: ProbeObservations,
    points: SeenPoints,
    prior: CoefficientPrior,
) -> ProbeObservations:
    """Observations of one probing with what a field changes."""
    local = expansion.under_loads[index]
    scale = float(np.exp(-local @ expansion.coefficients))

    def missed(response: ResponseModel, rows: csr_array) -> Float[np.ndarray, " r"]:
        """What finite elements lack of the homogeneous body's displacement."""
        moved = response.value(expansion.poisson_ratio)[:, :3] @ probe.force
        return np.asarray(moved - rows @ expansion.homogeneous[:, index])

    missing = missed(probe.response, points.from_nodes)

    def along_coefficients(by: Float[np.ndarray, "b j"]) -> Float[np.ndarray, "r j"]:
        """Change of the rows, to first order, with changes of the coefficients."""
        if not by.any():
            return np.zeros((points.from_corners.shape[0], by.shape[1]))
        changed = points.from_corners @ (expansion.derivative[index] @ by)
        return changed - scale * np.outer(missing, local @ by)

    along = probe.force / (probe.force @ probe.force)
    moved = np.stack([expansion.change[:, index], expansion.slope[:, index]], axis=1)
    expected = np.stack([prior.mean - expansion.coefficients, prior.by_ratio], axis=1)
    here = points.from_nodes @ moved + along_coefficients(expected)
    here[:, 0] += (scale - 1.0) * missing
    response = _Changed(probe.response, along, expansion.poisson_ratio, *here.T)
    vertices = probe.vertices
    if vertices is not None and points.vertices is not None:
        there = points.vertices @ moved
        there[:, 0] += (scale - 1.0) * missed(vertices, points.vertices)
        vertices = _Changed(vertices, along, expansion.poisson_ratio, *there.T)
    settlement = None
    if prior.by_log_modulus.any():
        rising = along_coefficients(prior.by_log_modulus[:, None]) * along
        columns = np.pad(rising, ((0, 0), (0, 1 + len(probe.motion))))
        settlement = Settlement(prior.shear_modulus, lambda _: columns)

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
        mixed = along_coefficients(prior.mixing)[at.rows]
        moved = np.zeros((*mixed.shape[:1], 1, at.value.shape[2], mixed.shape[1]))
        moved[:, 0, :3] = along[:, None] * mixed[:, None]
        return moved

    first = expansion.model.load.shape[1] + 2 * index
    changes = points.from_nodes @ expansion.change[:, first : first + 2]
    nuisances = [_shifted(nuisance, changes) for nuisance in probe.nuisances]
    return replace(
        probe, response=response, vertices=vertices, settlement=settlement,
        nuisances=(*nuisances, Nuisance(prior.parameters, effects)),
    )  # fmt: skip


def _shifted(nuisance: Nuisance, changes: Float[np.ndarray, "r s"]) -> Nuisance:
    """Errors of a contact's place with what a field changes in their effects, if that is known."""
    places = [k for k, error in enumerate(nuisance.parameters) if error.of == PLACES]
    if not places or not changes.size:
        return nuisance

    def effects(at: ResponseTerms) -> Float[np.ndarray, "r s c p"]:
        moved = np.array(nuisance.effects(at))
        # Entry 3 of the load is 1 / G.
        moved[:, 0, 3, places] += changes[at.rows]
        return moved

    return replace(nuisance, effects=effects)


def _seen(
    body: GradedBody, session: Session, observations: Sequence[ProbeObservations]
) -> tuple[Int[np.ndarray, " c"], tuple[SeenPoints, ...]]:
    """The corners about all observed points that are free, and the points of every probing."""
    solid = body.solid
    surface = TriangleMesh(solid.nodes, solid.facets[:, :3])
    asked, near, matrices = any(probe.vertices is not None for probe in observations), [], []
    vertices = at_points(solid, session.mesh.vertices) if asked else None
    for probing, probe in zip(session.probings, observations, strict=False):
        points = probe.position
        if tip := probe.tip_displacement is not None:
            points = np.concatenate([points, probing.contact.point[None]])
        near.append(closest_points(surface, points))
        at_each = at_points(solid, points)
        every = csr_array(vstack([vertices, at_each[-3:]])) if tip and asked else vertices
        matrices.append((at_each, every))
    about = [surface.triangles[closest.triangle] for closest in near]
    corners = np.unique(
        np.concatenate([np.zeros(0, np.int64), *(corner.ravel() for corner in about)])
    )
    corners = corners[~body.held[corners]]
    number = np.full(len(solid.nodes), -1)
    number[corners] = np.arange(len(corners))
    seen = []
    for triangle, closest, (from_nodes, every) in zip(about, near, matrices, strict=True):
        column = number[triangle]
        share = np.where(column >= 0, closest.barycentric, 0.0)
        row = np.repeat(np.arange(len(share)), 3)
        entries = (share.ravel(), (row, np.maximum(column, 0).ravel()))
        matrix = csr_array(entries, shape=(len(share), len(corners)))
        seen.append(SeenPoints(from_nodes, csr_array(kron(matrix, np.eye(3))), every))
    return corners, tuple(seen)


def at_points(solid: Solid, points: Points) -> csr_array:
    """Displacements at points of the surface from those of all nodes.

    Parameters
    ----------
    solid : Solid
    points : (p, 3) float [m]

    Returns
    -------
    (3 p, 3 n) sparse
    """
    return csr_array(kron(surface_values(solid, points), np.eye(3)))


@dataclass(frozen=True, slots=True, eq=False)
class _Changed:
    """A response with what a field changes in it, in proportion to the force along its direction
    (`ResponseModel`)."""

    response: ResponseModel
    along: Float[np.ndarray, "3"]
    poisson_ratio: float
    change: Float[np.ndarray, " n_rows"]
    slope: Float[np.ndarray, " n_rows"]

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        value = np.array(self.response.value(poisson_ratio))
        change = self.change + (poisson_ratio - self.poisson_ratio) * self.slope
        value[:, :3] += change[:, None] * self.along
        return value


def make_field_model(
    session: Session,
    observations: Sequence[ProbeObservations] = (),
    *,
    elements: int = ELEMENTS,
    times: Sequence[int] = (1, 3, 9),
) -> PushModel:
    """Finite elements for a session's object and the loads of its probings.

    Parameters
    ----------
    session : Session               its contacts with radii
    observations : sequence of ProbeObservations    of the homogeneous body
    elements : int                  about so many
    times : sequence of int         how many times as many are tried until they fit into a thin body

    Returns
    -------
    PushModel

    Raises
    ------
    InputError                      supports or loads that a field is not computed for
    MeshError                       the surface cannot be filled
    """
    if reason := no_field_reason(session):
        raise InputError(f"{session.path}: {reason} Fit with --material homogeneous")
    solid, _ = filled(session.mesh, [factor * elements for factor in times])

    def modes_of(body: GradedBody) -> FieldModes:
        points = body.points.reshape(-1, 3)
        return make_field_modes(points, body.weight.ravel(), depth_below(session, points))

    return push_model(session, observations, solid, modes_of)


def push_model(
    session: Session,
    observations: Sequence[ProbeObservations],
    solid: Solid,
    modes_of: Callable[[GradedBody], FieldModes],
) -> PushModel:
    """The finite elements of a solid with the loads of a session's probings.

    Parameters
    ----------
    session : Session               its contacts with radii
    observations : sequence of ProbeObservations    of the homogeneous body
    solid : Solid
    modes_of : callable             gives `FieldModel.modes`
    """
    body = make_graded_body(solid, held_nodes(solid, session.held_triangles))
    return _push_model(body, modes_of(body), session, observations)


def _push_model(
    body: GradedBody,
    modes: FieldModes,
    session: Session,
    observations: Sequence[ProbeObservations],
) -> PushModel:
    seen, load = _seen(body, session, observations), nodal_loads(session, body.solid)
    near = elements_under(body.solid, load)
    return PushModel(body, modes, load, session, tuple(observations), *seen, near)
