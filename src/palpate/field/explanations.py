"""What may be wrong with one modulus everywhere: rival explanations and their evidence.

Each adds coefficients b to the model of the homogeneous body, normal with one standard deviation,
whose effect is taken to first order:

    place      a modulus that differs from place to place (`field_prior`);
    direction  a stiffness that depends on direction, the same everywhere: the nineteen components
               of an elasticity tensor that is not isotropic, over the shear modulus;
    support    a support that gives: the compliance of its parts, in all directions and along their
               normal, times their area, over that of a layer as thick as the body is wide.

With e and r the strains and the reactions of the parts under a unit load where and along which u
is observed, and e' and r' those under the load itself,

    d u / d b = -sum_q w_q e C_b e'    and    d u / d b = L r . r' / A.

The compliance of a part that has come loose has no bound: parts are also let go altogether.

Source
------
Components: Moakher and Norris, The closest elastic tensor of arbitrary symmetry to an elasticity
tensor of lower symmetry, Journal of Elasticity 85 (2006), section 2.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.cluster.vq import kmeans2
from scipy.linalg import block_diag
from scipy.spatial import cKDTree

from palpate.arrays import components_of
from palpate.checkpoints import Cache, Memory, content_digest
from palpate.estimation import Evaluation, FitSettings, ProbeObservations, joint_minimum
from palpate.field.field_fit import (
    SAME_RATIO,
    information_about,
    log_bayes_factor,
    make_model,
    modes_in,
)
from palpate.field.field_prior import STDS, best_evidence
from palpate.field.field_responses import (
    FieldExpansion,
    FieldModel,
    MadeInParts,
    PushModel,
    smooth_prior,
)
from palpate.geometry import TriangleMesh, triangle_areas, unit_normals
from palpate.records import Session
from palpate.solids import GradedBody, GradedStiffness, with_moduli

# Number of elements with which to ask.
_FEW = 1000
# Poisson's ratio from which on it counts to the last digit.
_NO_VOLUME = 0.45
# Components of an elasticity tensor that is not isotropic, without those of one that is.
_COMPONENTS = 19
# Parts of a support.
_PARTS = 8
# Under this name a memory keeps how the body moves under unit loads.
_UNIT_LOADS = "under unit loads"
# How many times as large as a session says errors may be.
_FREED = 2.0 ** np.arange(6)

# Displacements under some loads -> derivatives of what is observed by coefficients, (p, a, b).
Derivative = Callable[[Float[np.ndarray, "n3 p"]], Float[np.ndarray, "p a b"]]


class Cause(StrEnum):
    """Why one modulus does not explain the displacements."""

    PLACE = "a modulus that differs from place to place"
    DIRECTION = "a stiffness that depends on direction"
    SUPPORT = "a support that gives"


@dataclass(frozen=True, slots=True, eq=False)
class Explanation:
    """A cause with its evidence over that of one modulus, to first order and by coarse elements.

    Attributes
    ----------
    cause : Cause
    log_evidence : float
    std : float                     standard deviation of the coefficients of most evidence
    model : FieldModel
    poisson_ratio : float [-]       about which it is expanded
    loose : (h,) bool or None       held nodes of the model that the support lets go; None: none
    """

    cause: Cause
    log_evidence: float
    std: float
    model: FieldModel
    poisson_ratio: float
    loose: Bool[np.ndarray, " h"] | None = None

    def with_field(
        self, session: Session, observations: Sequence[ProbeObservations]
    ) -> list[ProbeObservations]:
        """As of every `UnevenBody`."""
        return self._observations(self.model.under(session, observations))

    def with_parts_let_go(self, minimum: Evaluation, settings: FitSettings) -> "Explanation":
        """The likeliest of supports whose parts are let go one after the other, at each step the
        one that gives most.

        Parameters
        ----------
        minimum : Evaluation        of the homogeneous body
        settings : FitSettings
        """
        part, normals, _ = _parts(self.model.body)
        gone, removed = np.zeros(len(normals), dtype=bool), []
        while gone.sum() < len(gone) - 1:
            looser = replace(self, loose=gone[part])
            at = joint_minimum(looser._observations(self.model), settings)
            removed.append(replace(looser, log_evidence=log_bayes_factor(at, minimum, settings)))
            gives = at.theta[modes_in(at)].reshape(2, -1).sum(axis=0)
            gone[np.where(gone, -np.inf, gives).argmax()] = True
        return max(removed, key=lambda explanation: explanation.log_evidence)

    def _observations(self, model: FieldModel) -> list[ProbeObservations]:
        stiffness = _homogeneous(model, self.poisson_ratio)
        expansion, _ = _expansion(model, stiffness, (self.cause,), Memory(), self.loose)
        count = len(expansion.coefficients)
        return expansion.observations(smooth_prior(self.std * np.eye(count)))


def explanations(
    session: Session,
    observations: Sequence[ProbeObservations],
    minimum: Evaluation,
    *,
    cache: Cache | None = None,
) -> list[Explanation]:
    """What may explain displacements that one modulus does not, the likeliest first; takes seconds.

    Parameters
    ----------
    session : Session                           k probings
    observations : sequence of k ProbeObservations      with the homogeneous body's response
    minimum : Evaluation                        of these
    cache : Cache or None                       a memory keeps the body's elements, and how they
                                                move under unit loads, for other pushes

    Raises
    ------
    MeshError                       so few elements do not fit into the body
    """
    memory = cache if isinstance(cache, Memory) else Memory()
    # What the vertices do is not asked.
    observations = [replace(probe, vertices=None) for probe in observations]
    name = content_digest(("few elements", session.mesh, session.held_triangles))
    if name in memory:
        model: FieldModel = memory[name].under(session, observations)
    else:
        memory[name] = model = make_model(session, observations, elements=_FEW, times=(1, 3))
        if isinstance(model, PushModel):
            # Without these pushes, which are large.
            memory[name] = replace(model, observations=(), points=())
    ratio = _near(minimum.poisson_ratio)
    stiffness: GradedStiffness | None = memory.get(factors := f"{name} factors")
    if stiffness is None or stiffness.poisson_ratio != ratio:
        stiffness = memory[factors] = _homogeneous(model, ratio)
    # Pokes, which tell one number each, cannot tell the others.
    causes = tuple(Cause) if isinstance(model, PushModel) else (Cause.PLACE,)
    expansion, parts = _expansion(model, stiffness, causes, memory)
    # What is known of the coefficients of one cause does not depend on those of the others.
    information, score = information_about(expansion, minimum, expansion.coefficients)
    candidates = []
    for cause, part in zip(causes, parts, strict=True):
        known = information[part, part], score[part]
        if cause is Cause.PLACE:
            prior = model.modes.best_prior(*known)
            evidence, std = prior.log_evidence, prior.std
        else:
            evidence, std = best_evidence(*known, STDS)
        candidates.append(Explanation(cause, evidence, std, model, ratio))
    return sorted(candidates, key=lambda candidate: -candidate.log_evidence)


def evidence_of_errors(minimum: Evaluation) -> float:
    """Largest log evidence, of any one kind, that forces, contacts or other errors of single
    probings are larger than the session states, over errors as stated.

    Parameters
    ----------
    minimum : Evaluation
    """
    problem, normal = minimum.problem, minimum.normal
    places, sources = [], []
    for block in problem.layout.blocks:
        count = block.unknown.start - block.whole.start
        places.append(np.arange(block.whole.start, block.whole.start + count))
        sources += problem.sources[block.whole.start : block.unknown.start]
    counts = [len(entries) for entries in places]
    back = np.concatenate(
        [part[:count, :-1] for part, count in zip(normal.solutions, counts, strict=True)]
    )
    inner = [
        np.linalg.inv(information)[:n, :n]
        for information, n in zip(normal.own, counts, strict=True)
    ]
    covariance = block_diag(*inner) + back @ normal.covariance @ back.T
    theta, gain = minimum.theta[np.concatenate(places)], 0.0
    for source in set(sources):
        chosen = np.flatnonzero(np.array(sources) == source)
        # Of the posterior, whose prior is normal of unit variance.
        precision = np.linalg.inv(covariance[np.ix_(chosen, chosen)])
        known = precision - np.eye(len(chosen)), precision @ theta[chosen]
        gain = max(gain, best_evidence(*known, _FREED)[0] - best_evidence(*known, np.ones(1))[0])
    return gain


def _near(poisson_ratio: float) -> float:
    """A Poisson's ratio near by, of which the factors serve many pushes: effects of first order
    hardly depend on it, but where a body hardly changes its volume."""
    near = SAME_RATIO * round(poisson_ratio / SAME_RATIO)
    return near if near < _NO_VOLUME else poisson_ratio


def _homogeneous(model: FieldModel, poisson_ratio: float) -> GradedStiffness:
    """The body with one modulus."""
    return model.stiffness(np.zeros(model.modes.modes.shape[1]), poisson_ratio)


def _expansion(
    model: FieldModel,
    stiffness: GradedStiffness,
    causes: Sequence[Cause],
    memory: Memory,
    loose: Bool[np.ndarray, " h"] | None = None,
) -> tuple[FieldExpansion, list[slice]]:
    """The responses' change by some causes about the homogeneous body, or about one of which the
    support has let some held nodes go; the coefficients of each."""
    moved = stiffness.displacements(model.load)
    change = zero = model.seen(0.0 * moved)
    if loose is not None:
        held = model.body.held.copy()
        held[held] = ~loose
        body, before = replace(model.body, held=held), moved
        stiffness = with_moduli(body, stiffness.log_modulus, stiffness.poisson_ratio)
        moved = stiffness.displacements(model.load)
        change = model.seen(moved - before)
    derivative: MadeInParts | np.ndarray
    if isinstance(model, PushModel):
        seen = _under_unit_loads(model, stiffness, memory)
        made = [_DERIVATIVES[cause](model, stiffness, seen) for cause in causes]
        counts = [count for count, _ in made]

        def of_some(some: slice) -> Float[np.ndarray, "p a b"]:
            parts = [make(moved[:, some]) for _, make in made]
            return np.concatenate(parts, axis=2, dtype=np.float32)

        derivative = MadeInParts(of_some)
    else:
        derivative = model.derivative(stiffness, moved)
        counts = [derivative.shape[-1]]
    ends = np.cumsum([0, *counts]).tolist()
    none, nowhere = np.zeros(ends[-1]), np.zeros((model.load.shape[1], ends[-1]))
    expansion = FieldExpansion(
        model, none, stiffness.poisson_ratio, nowhere, zero, change, zero, derivative
    )
    return expansion, [slice(*bounds) for bounds in pairwise(ends)]


def _under_unit_loads(
    model: PushModel, stiffness: GradedStiffness, memory: Memory
) -> Float[np.ndarray, "n3 a"]:
    """Displacements under unit loads at the model's corners; of corners about earlier pushes as the
    memory keeps them."""
    kept = memory.get(_UNIT_LOADS)
    if kept is None or kept[0] is not stiffness:
        kept = stiffness, model.corners[:0], np.zeros((3 * len(model.body.solid.nodes), 0))
    _, known, seen = kept
    if not np.array_equal(known, model.corners):
        new = np.setdiff1d(model.corners, known)
        every = np.concatenate([known, new])
        seen = np.hstack([seen, stiffness.displacements(model.unit_loads(new))])
        order = np.argsort(every)
        place = order[np.searchsorted(every, model.corners, sorter=order)]
        seen = seen[:, components_of(place)]
        memory[_UNIT_LOADS] = stiffness, model.corners, seen
    return seen


def _by_place(
    model: PushModel, stiffness: GradedStiffness, seen: Float[np.ndarray, "n3 a"]
) -> tuple[int, Derivative]:
    """Derivative by the modes of a field."""
    modes = model.modes.modes
    return modes.shape[1], lambda moved: stiffness.sensitivities(seen, moved, modes)


def _by_direction(
    _: PushModel, stiffness: GradedStiffness, seen: Float[np.ndarray, "n3 a"]
) -> tuple[int, Derivative]:
    """Derivative by the components of an anisotropic tensor."""

    def derivative(moved: Float[np.ndarray, "n3 p"]) -> Float[np.ndarray, "p a 19"]:
        products = stiffness.strain_products(seen, moved)
        return -np.einsum("paij,ijc->pac", products, _components())

    return _COMPONENTS, derivative


def _components() -> Float[np.ndarray, "6 6 19"]:
    """Orthonormal components of symmetric tensors, without the two isotropic ones (Mandel)."""
    i, j = np.triu_indices(6)
    every = np.zeros((len(i), 6, 6))
    size = np.where(i == j, 1.0, np.sqrt(0.5))
    every[np.arange(len(i)), i, j] = every[np.arange(len(i)), j, i] = size
    volume = np.zeros((6, 6))
    volume[:3, :3] = 1.0 / 3.0
    isotropic = np.stack([volume, (np.eye(6) - volume) / np.sqrt(5.0)])
    share = np.einsum("cij,dij->cd", every, isotropic)
    rest = np.linalg.svd(share, full_matrices=True)[0][:, 2:]
    return np.einsum("cij,cd->ijd", every, rest)


def _by_support(
    model: PushModel, stiffness: GradedStiffness, seen: Float[np.ndarray, "n3 a"]
) -> tuple[int, Derivative]:
    """Derivative by the compliance of every part of the support, in all directions and along its
    normal."""
    body = model.body
    length = float(body.volume.sum()) ** (1.0 / 3.0)
    part, normals, areas = _parts(body)
    part = part[stiffness.body.held[body.held]]
    inside = (part == np.arange(len(areas))[:, None]).astype(float)

    def force_on_parts(displacement: Float[np.ndarray, "n3 p"]) -> Float[np.ndarray, "s 3 p"]:
        on_nodes = stiffness.reactions(displacement).reshape(len(part), 3, -1)
        return np.einsum("sh,hip->sip", inside, on_nodes)

    at_seen = force_on_parts(seen)
    normal_at_seen = np.einsum("si,sia->sa", normals, at_seen)

    def derivative(moved: Float[np.ndarray, "n3 p"]) -> Float[np.ndarray, "p a b"]:
        force = force_on_parts(moved)
        every = np.einsum("sia,sip,s->pas", at_seen, force, length / areas)
        normal = np.einsum("si,sip->sp", normals, force)
        along_normal = np.einsum("sa,sp,s->pas", normal_at_seen, normal, length / areas)
        return np.concatenate([every, along_normal], axis=2)

    return 2 * len(areas), derivative


_DERIVATIVES = {
    Cause.PLACE: _by_place,
    Cause.DIRECTION: _by_direction,
    Cause.SUPPORT: _by_support,
}


def _parts(
    body: GradedBody,
) -> tuple[Int[np.ndarray, " h"], Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Parts of a support of about the same size: number of the part that each held node belongs to,
    mean normals, areas [m^2]."""
    nodes, facets = body.solid.nodes, body.solid.facets
    face = TriangleMesh(nodes, facets[body.held[facets].all(axis=1), :3])
    area, middle = triangle_areas(face), nodes[face.triangles].mean(axis=1)
    centres, nearest = kmeans2(middle, min(_PARTS, len(middle)), minit="++", seed=0)
    used, nearest = np.unique(nearest, return_inverse=True)
    whole = np.zeros((len(used), 3))
    np.add.at(whole, nearest, area[:, None] * unit_normals(face))
    areas = np.bincount(nearest, area)
    normals = whole / np.maximum(np.linalg.norm(whole, axis=1), 1e-9 * areas.max())[:, None]
    part = cKDTree(centres[used]).query(nodes[body.held])[1]
    return part, normals, areas
