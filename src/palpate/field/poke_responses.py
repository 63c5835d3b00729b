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
from scipy.sparse import csr_array

from palpate.estimation import (
    Nuisance,
    ProbeObservations,
    ResponseModel,
    ResponseTerms,
)
from palpate.field.elements import ELEMENTS, depth_below, elements_under, filled
from palpate.field.field_prior import make_field_modes
from palpate.field.field_responses import CoefficientPrior, FieldExpansion, FieldModel
from palpate.geometry import CREASE_ANGLE, triangle_distances, unit_normals
from palpate.probe import dent
from palpate.records import FlatFace, Session, Sphere
from palpate.shapes import Points
from palpate.solids import (
    GradedBody,
    GradedStiffness,
    half_space_compliance,
    held_nodes,
    make_graded_body,
    pressure_load,
)

# Radius of the patch over which a load is spread, over the edge of the elements: with 1.5 the tip's
# displacement is right to 0.3 % of its whole (0.8 % with 1, 0.5 % with 2). Near an edge of the body
# as far as that is away, but not less than 0.75, since its part there varies over the patch.
_SPREAD, _LEAST_SPREAD = 1.5, 0.75


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
class PokeModel(FieldModel):
    """Finite elements of a poked object. Loads are one newton along each push, spread; all k pokes
    are one probing.

    Attributes
    ----------
    edge : float [m]                of the elements, about
    spread : (k,) float [1/m]       compliance of a half space under the loads, times G / (1 - nu)
    near : (k, m) sparse [-]        weights of the elements under them; rows add up to 1
    """

    edge: float
    spread: Float[np.ndarray, " k"]
    near: csr_array

    def under(
        self, session: Session, observations: Sequence[ProbeObservations] = ()
    ) -> "PokeModel":
        """See `FieldModel`."""
        load, spread, near = _loads(self.body, self.edge, session)
        return PokeModel(
            self.body, self.modes, load, session, tuple(observations), self.edge, spread, near,
        )  # fmt: skip

    def seen(self, moved: Float[np.ndarray, "n3 k"]) -> Float[np.ndarray, " k"]:
        """Compliance under each load [1/m]."""
        return np.asarray((self.load * moved).sum(axis=0))

    def derivative(
        self, stiffness: GradedStiffness, moved: Float[np.ndarray, "n3 k"]
    ) -> Float[np.ndarray, "k b"]:
        """Derivative of the compliances."""
        return -stiffness.energies(moved).T @ self.modes.modes

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
        return self.seen(self.moved(none, poisson_ratio)) - (1.0 - poisson_ratio) * self.spread

    def changed(
        self, expansion: FieldExpansion, prior: CoefficientPrior
    ) -> list[ProbeObservations]:
        """See `FieldExpansion.observations`."""
        (probe,), session, spread = self.observations, self.session, self.spread
        force = np.stack([probing.force for probing in session.probings])
        # The half space's modulus at which the homogeneous response was taken.
        modulus = 1.0 if probe.settlement is None else probe.settlement.shear_modulus
        local = self.near @ self.body.means(self.modes.modes)
        m, growth = local @ expansion.coefficients, growths(session)

        def parts(
            poisson_ratio: float,
        ) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
            """What a field changes of what elements miss, and the derivative by m."""
            dented = dents(session, modulus, poisson_ratio)
            missed, shared = (1.0 - poisson_ratio) * spread * np.exp(-m), 1.0 - growth
            softer = dented * np.exp(-shared * m)
            change = (1.0 - poisson_ratio) * spread - missed + softer - dented
            return change, missed - shared * softer

        derivative = expansion.derivative + parts(expansion.poisson_ratio)[1][:, None] * local
        offset = expansion.change - derivative @ expansion.coefficients

        def change(poisson_ratio: float) -> Float[np.ndarray, " k"]:
            further = (poisson_ratio - expansion.poisson_ratio) * expansion.slope
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
    shear_modulus, columns = modulus * (1.0 - poisson_ratio), []
    for tool, probing in zip(tools(session), session.probings, strict=True):
        force = float(np.linalg.norm(probing.force))
        depth = dent(tool, force, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio)
        columns.append(depth * shear_modulus / force)
    return np.array(columns)


def growths(session: Session) -> Float[np.ndarray, " k"]:
    """q of the tool of each poke, (k,) [-]."""
    return np.array([tool.growth for tool in tools(session)])


def tools(session: Session) -> list[Sphere | FlatFace]:
    """The tool of each poke.

    Parameters
    ----------
    session : Session               `without_pictures`
    """
    contact_tools = [probing.contact.tool for probing in session.probings]
    return [tool for tool in contact_tools if isinstance(tool, Sphere | FlatFace)]


def make_poke_model(
    session: Session,
    observations: Sequence[ProbeObservations] = (),
    *,
    elements: int = ELEMENTS,
    times: Sequence[int] = (1, 3, 9),
) -> PokeModel:
    """Finite elements for a poked object.

    Parameters
    ----------
    session : Session               `without_pictures`
    observations, elements, times   as `make_field_model`

    Returns
    -------
    PokeModel

    Raises
    ------
    InputError                      a tool that touches no part of the surface
    MeshError                       the surface cannot be filled
    """
    solid, edge = filled(session.mesh, [factor * elements for factor in times])
    body = make_graded_body(solid, held_nodes(solid, session.held_triangles))
    points = body.points.reshape(-1, 3)
    depth = depth_below(session, points)
    modes = make_field_modes(points, body.weight.ravel(), depth, edges=1)
    # Layers change every poke of a face alike, as a modulus or Poisson's ratio does.
    modes = replace(modes, modes=modes.modes[:, : len(modes.mixing[0])])
    load, spread, near = _loads(body, edge, session)
    observed = tuple(observations)
    return PokeModel(body, modes, load, session, observed, edge, spread, near)


def _loads(
    body: GradedBody, edge: float, session: Session
) -> tuple[Float[np.ndarray, "n3 k"], Float[np.ndarray, " k"], csr_array]:
    """`load`, `spread` and `near` of the pokes of a session."""
    solid, load, spread = body.solid, list[np.ndarray](), []
    normals = unit_normals(session.mesh)
    for probing in session.probings:
        away = triangle_distances(session.mesh, probing.contact.point)
        turned = normals @ normals[int(away.argmin())] < np.cos(CREASE_ANGLE)
        radius = float(away[turned].min(initial=_SPREAD * edge))
        patch = probing.contact.point, max(radius, _LEAST_SPREAD * edge), _smooth
        share = pressure_load(solid, *patch)
        spread.append(half_space_compliance(solid, *patch))
        push = probing.force / np.linalg.norm(probing.force)
        load.append(np.outer(share, push).ravel())
    every = np.stack(load, axis=1)
    return every, np.array(spread), elements_under(solid, every)


def _smooth(s: Float[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
    return np.clip(1.0 - s**2, 0.0, None)
