"""How deep a tool goes in, on a body with a field of moduli: pokes without pictures.

A tool is smaller than the elements, and hundreds of places cannot all have small ones. Elements
resolve a load that is spread over a patch of 1.5 edges. What they miss under the tool is that of a
half space of the local modulus, in closed form:

    u(m) G / F = C(m) - L_s exp(-m_l) + L exp(-(1 - q) m_l),

C the elements' compliance under the spread load, L_s that of a half space under the same load, L
the tool's dent (`probe.indentation`), m_l the mean of m over the elements under the patch. A load
and its observation are the same, so dC / dm_q = -exp(m_q) u' K_q u takes no further solution.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array, csr_array

from palpate.estimation import (
    Nuisance,
    ProbeObservations,
    ResponseModel,
    ResponseTerms,
)
from palpate.field.field_prior import FieldModes, make_field_modes
from palpate.field.field_responses import (
    ELEMENTS,
    CoefficientPrior,
    depth_below,
    filled,
)
from palpate.geometry import CREASE_ANGLE, triangle_distances, unit_normals
from palpate.probe import GROWTH, dent
from palpate.records import Session, Tool
from palpate.shapes import Points
from palpate.solids import (
    GradedBody,
    half_space_compliance,
    held_nodes,
    make_graded_body,
    pressure_load,
    with_moduli,
)

# Radius of the patch over which a load is spread, over the edge of the elements: with 1.5 the tip's
# displacement is right to 0.3 % of its whole (0.8 % with 1, 0.5 % with 2). Near an edge of the body
# as far as that is away, but not less than 0.75, since its part there varies over the patch.
_SPREAD, _LEAST_SPREAD = 1.5, 0.75
# Change of Poisson's ratio for the derivative of what a field changes.
_STEP = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class PokeResponse:
    """Response of tools that go in along their forces, for k pokes that count as known loads of one
    probing (`ResponseModel`).

    Attributes
    ----------
    force : (k, 3) float [N]
    compliance : function           Poisson's ratio -> (k,) float [1/m]: displacement along the
                                    force times shear modulus, over the force
    more : ResponseModel or None    to which this is added
    """

    force: Points
    compliance: Callable[[float], Float[np.ndarray, " k"]]
    more: ResponseModel | None = None

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "k3 4"]:
        """See `ResponseModel`."""
        value = np.zeros((self.force.size, 4))
        value[:, 3] = (self.force * self.compliance(poisson_ratio)[:, None]).ravel()
        return value if self.more is None else value + self.more.value(poisson_ratio)


@dataclass(frozen=True, slots=True, eq=False)
class PokeModel:
    """Finite elements of a poked object.

    Attributes
    ----------
    body : GradedBody
    modes : FieldModes
    edge : float [m]                of the elements, about
    load : (3 n, k) float [-]       nodal forces of one newton along each push, spread
    spread : (k,) float [1/m]       compliance of a half space under them, times G / (1 - nu)
    near : (k, c) sparse [-]        weights of the corners of elements under them; rows add up to 1
    """

    body: GradedBody
    modes: FieldModes
    edge: float
    load: Float[np.ndarray, "n3 k"]
    spread: Float[np.ndarray, " k"]
    near: csr_array

    @property
    def values(self) -> csr_array:
        """As `FieldModel.values`."""
        return self.body.linear

    def loaded(self, session: Session) -> "PokeModel":
        """The same body under the pokes of another session."""
        return _with_pokes(self, session)

    def moved(
        self, coefficients: Float[np.ndarray, " b"], poisson_ratio: float
    ) -> Float[np.ndarray, "n3 k"]:
        """As `FieldModel.moved`, for one newton."""
        log_modulus = self.values @ (self.modes.modes @ coefficients)
        return with_moduli(self.body, log_modulus, poisson_ratio).displacements(self.load)

    def regular(self, poisson_ratio: float) -> Float[np.ndarray, " k"]:
        """Compliance of the homogeneous body at each poke beyond that of a half space, times G.

        Parameters
        ----------
        poisson_ratio : float [-]

        Returns
        -------
        (k,) float [1/m]
        """
        none = np.zeros(self.modes.modes.shape[1])
        seen = (self.load * self.moved(none, poisson_ratio)).sum(axis=0)
        return np.asarray(seen - (1.0 - poisson_ratio) * self.spread)

    def expanded(
        self,
        coefficients: Float[np.ndarray, " b"],
        poisson_ratio: float,
        homogeneous: Float[np.ndarray, "n3 k"],
    ) -> "PokeExpansion":
        """As `FieldModel.expanded`."""
        log_modulus = self.values @ (self.modes.modes @ coefficients)
        stiffness = with_moduli(self.body, log_modulus, poisson_ratio)
        moved = stiffness.displacements(self.load)
        change = (self.load * (moved - homogeneous)).sum(axis=0)
        derivative = -(self.values.T @ stiffness.energies(moved)).T @ self.modes.modes
        return PokeExpansion(
            self, coefficients, poisson_ratio, change, np.zeros_like(change), derivative
        )


@dataclass(frozen=True, slots=True, eq=False)
class PokeExpansion:
    """Change of the elements' compliance by a field, to first order about some coefficients.

    Attributes
    ----------
    model : PokeModel
    coefficients : (b,) float       b0
    poisson_ratio : float [-]       nu0
    change : (k,) float [1/m]       C(b0) - C(0)
    slope : (k,) float [1/m]        its derivative with respect to Poisson's ratio; zero until it is
                                    asked for
    derivative : (k, b) float [1/m]
    """

    model: PokeModel
    coefficients: Float[np.ndarray, " b"]
    poisson_ratio: float
    change: Float[np.ndarray, " k"]
    slope: Float[np.ndarray, " k"]
    derivative: Float[np.ndarray, "k b"]

    def with_slope(self) -> "PokeExpansion":
        """With the derivative with respect to Poisson's ratio, which takes two factorisations."""
        model, beside = self.model, self.poisson_ratio - _STEP
        moved = model.moved(self.coefficients, beside)
        moved -= model.moved(0.0 * self.coefficients, beside)
        change = (model.load * moved).sum(axis=0)
        return replace(self, slope=(self.change - change) / _STEP)

    def observations(
        self,
        session: Session,
        observations: Sequence[ProbeObservations],
        prior: CoefficientPrior,
    ) -> list[ProbeObservations]:
        """As `FieldExpansion.observations`, of the one that all pokes make up."""
        (probe,), model = observations, self.model
        force = np.stack([each.force for each in session.probings])
        # The half space's modulus at which the homogeneous response was taken.
        modulus = 1.0 if probe.settlement is None else probe.settlement.shear_modulus
        local = model.near @ model.modes.modes
        m, growth = local @ self.coefficients, growths(session)

        def parts(
            poisson_ratio: float,
        ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
            """What a field changes of what elements miss, and the derivative by m."""
            dented = dents(session, modulus, poisson_ratio)
            missed, shared = (1.0 - poisson_ratio) * model.spread * np.exp(-m), 1.0 - growth
            softer = dented * np.exp(-shared * m)
            change = (1.0 - poisson_ratio) * model.spread - missed + softer - dented
            return change, missed - shared * softer

        derivative = self.derivative + parts(self.poisson_ratio)[1][:, None] * local
        offset = self.change - derivative @ self.coefficients

        def change(poisson_ratio: float) -> Float[np.ndarray, " k"]:
            further = (poisson_ratio - self.poisson_ratio) * self.slope
            return np.asarray(offset + further + parts(poisson_ratio)[0])

        mixed = (force[:, :, None] * (derivative @ prior.mixing)[:, None]).reshape(force.size, -1)

        def effects(at: ResponseTerms) -> Float[np.ndarray, "r 1 c p"]:
            moved = np.zeros((len(at.rows), 1, at.value.shape[2], mixed.shape[1]))
            moved[:, 0, 3] = mixed[at.rows]
            return moved

        nuisances = (*probe.nuisances, Nuisance(prior.parameters, effects))
        changed = PokeResponse(force, change, probe.response)
        return [replace(probe, response=changed, nuisances=nuisances)]


def dents(session: Session, modulus: float, poisson_ratio: float) -> Float[np.ndarray, " k"]:
    """Dent of a half space under the tool of each poke, times G, over the force.

    Parameters
    ----------
    session : Session               `without_pictures`, k probings
    modulus : float [Pa]            G / (1 - nu), > 0: of all moduli what dents tell best
    poisson_ratio : float [-]

    Returns
    -------
    (k,) float [1/m]
    """
    shear_modulus, found = modulus * (1.0 - poisson_ratio), []
    for tool, probing in zip(tools(session), session.probings, strict=True):
        force = float(np.linalg.norm(probing.force))
        depth = dent(tool, force, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio)
        found.append(depth * shear_modulus / force)
    return np.array(found)


def growths(session: Session) -> Float[np.ndarray, " k"]:
    """q of the tool of each poke, (k,) [-]."""
    return np.array([GROWTH[tool.shape] for tool in tools(session)])


def tools(session: Session) -> list[Tool]:
    """The tool of each poke.

    Parameters
    ----------
    session : Session               `without_pictures`
    """
    return [each.contact.tool for each in session.probings if each.contact.tool is not None]


def make_poke_model(
    session: Session, *, elements: int = ELEMENTS, times: Sequence[int] = (1, 3, 9)
) -> PokeModel:
    """Finite elements for a poked object.

    Parameters
    ----------
    session : Session               `without_pictures`
    elements, times                 as `make_field_model`

    Returns
    -------
    PokeModel

    Raises
    ------
    InputError                      a tool that touches no part of the surface
    MeshError                       the surface cannot be filled
    """
    solid, edge = filled(session.mesh, [each * elements for each in times])
    body = make_graded_body(solid, held_nodes(solid, session.held_triangles))
    none = csr_array((0, len(body.corners)))
    depth = depth_below(session, body.corners)
    modes = make_field_modes(body.corners, body.corner_volume, depth)
    # Layers change every poke of a face alike, as a modulus or Poisson's ratio does.
    modes = replace(modes, modes=modes.modes[:, : len(modes.mixing[0])])
    empty = PokeModel(body, modes, edge, np.zeros((solid.nodes.size, 0)), np.zeros(0), none)
    return _with_pokes(empty, session)


def _with_pokes(model: PokeModel, session: Session) -> PokeModel:
    """A model under the pokes of a session."""
    solid, share, load, spread = model.body.solid, list[np.ndarray](), list[np.ndarray](), []
    normals = unit_normals(session.mesh)
    for probing in session.probings:
        away = triangle_distances(session.mesh, probing.contact.point)
        turned = normals @ normals[int(away.argmin())] < np.cos(CREASE_ANGLE)
        radius = float(away[turned].min(initial=_SPREAD * model.edge))
        patch = probing.contact.point, max(radius, _LEAST_SPREAD * model.edge), _smooth
        share.append(pressure_load(solid, *patch))
        spread.append(half_space_compliance(solid, *patch))
        push = probing.force / np.linalg.norm(probing.force)
        load.append(np.outer(share[-1], push).ravel())
    count = len(solid.elements)
    row = np.repeat(np.arange(count), solid.elements.shape[1])
    entries = (np.ones(row.size), (row, solid.elements.ravel()))
    incidence = csr_array(coo_array(entries, shape=(count, len(solid.nodes))))
    # A node's share of the load to the elements about it, and an element's to its corners.
    to_corners = 0.25 * incidence[:, : len(model.body.corners)]
    near = csr_array(np.stack(share) / incidence.sum(axis=0) @ incidence.T @ to_corners)
    return replace(model, load=np.stack(load, axis=1), spread=np.array(spread), near=near)


def _smooth(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    return np.clip(1.0 - s**2, 0.0, None)
