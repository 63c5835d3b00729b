"""The objective of the estimate, as a function of one vector.

    theta = (nu, log G | shared errors | for each probing: force, motions, own errors, model error)

Everything but nu and the material is in units of its prior's standard deviation, so the objective
is, with r the residual of a point, s its standard deviation and rho minus twice a log density,

    f(theta) = c sum rho(|r / s|^2) + |errors|^2 + |forces|^2 + |motions|^2 + |model error|^2 / k^2.

The model's own error enters as parameters with a prior, like every other error, and what varies of
it from point to point in s: however many points there are and however little noise, no combination
of them counts as better than the model is there. The constant c is that for which the curvature of
f is the inverse covariance of the estimate (a calibrated composite likelihood: Pauli, Racugno and
Ventura, Statistica Sinica 21 (2011)), k the size of the model's own error over what comparisons of
meshes say, at least 1.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from palpate.estimation.measured_components import (
    FIRST_CLAIMED,
    GROUP_COUNT,
    MeasuredComponents,
)
from palpate.estimation.noise import Moments, NoiseModel, gaussian_moments
from palpate.estimation.observations import NuisanceParameter, ResponseTerms
from palpate.estimation.unknown_error import UnknownRows, correlated_patterns, unknown_rows
from palpate.shapes import Points, Vertices

# Sources in the uncertainty budget: of what is no named error.
FORCES, MOTIONS, MODEL = "measured forces", "motions of supports", "mesh"
# Half the distance of the two Poisson's ratios from which a model is expanded: the error is of
# second order.
_STEP = 1e-4
# Noise over motion to start from where none was claimed: so little that what the model leaves over
# is first explained by its own error where that can, and only then by noise.
_FIRST_LEVEL = 0.003


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Where the parameters of one probing are in theta.

    Attributes
    ----------
    force, motions, errors, unknown : slice    true minus measured force and motions; its own
                                    errors; coefficients of the model's error of unknown shape
    whole : slice                   all of them
    shared : (s,) int               which of the shared errors it has, in its own order
    """

    force: slice
    motions: slice
    errors: slice
    unknown: slice
    whole: slice
    shared: Int[np.ndarray, " s"]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Names of the parts of theta. Entry 0 is Poisson's ratio, entry 1 log G.

    Attributes
    ----------
    errors : slice                  shared errors
    blocks : tuple of Block         one for each probing
    """

    errors: slice
    blocks: tuple[Block, ...]

    @property
    def common(self) -> int:
        """Number of parameters that probings have in common: all before the first block."""
        return self.errors.stop

    @property
    def size(self) -> int:
        """Length of theta."""
        return self.blocks[-1].whole.stop


@dataclass(frozen=True, slots=True, eq=False)
class Expansion:
    """Model of one probing's rows, bilinear in load and errors; its response is linear in Poisson's
    ratio about a reference, with the effects of errors there.

    Attributes
    ----------
    poisson_ratio : float           the reference
    value, slope : (l, r) float     displacement per unit of each entry of the load, and its
                                    derivative with respect to Poisson's ratio
    effects : (k, u, r) float       change of the value per prior standard deviation of each error,
                                    in the entries of the load that any of them changes
    changed : (u,) int              these entries
    curvature : (r, o, o) float     second derivatives in its own o errors, the last ones, times
                                    the shear modulus
    """

    poisson_ratio: float
    value: Float[np.ndarray, "l r"]
    slope: Float[np.ndarray, "l r"]
    effects: Float[np.ndarray, "k u r"]
    changed: Int[np.ndarray, " u"]
    curvature: Float[np.ndarray, "r o o"]


@dataclass(frozen=True, slots=True, eq=False)
class Expansions(Sequence[Expansion]):
    """Models of probings that are made each time they are asked for: with a field of moduli one
    takes megabytes, and the objective at a single point asks twice.

    Attributes
    ----------
    probes : tuple of MeasuredComponents
    shared : tuple of NuisanceParameter     as `Problem.shared`
    poisson_ratio : float                   the reference
    """

    probes: tuple[MeasuredComponents, ...]
    shared: tuple[NuisanceParameter, ...]
    poisson_ratio: float

    def __len__(self) -> int:
        return len(self.probes)

    def __getitem__(self, index: Any) -> Any:
        """Expansion of one probing, or expansions of several."""
        if isinstance(index, slice):
            return replace(self, probes=self.probes[index])
        return _expansion(self.probes[index], self.shared, self.poisson_ratio)


@dataclass(frozen=True, slots=True, eq=False)
class Problem:
    """The objective, with its noise levels and its model expanded about a Poisson's ratio.

    Parameters
    ----------
    probes : tuple of MeasuredComponents
    noise : NoiseModel
    shared : tuple of NuisanceParameter     the m errors that probings of the session share
    unknown : tuple of UnknownRows          the model's error of unknown shape, of each probing
    layout : Layout
    expansions : sequence of Expansion
    level : (8,) float              noise level of each group, see `noise_levels`
    scale : float                   k, size of the model's own error over what the mesh says, >= 1
    information : float             c
    """

    probes: tuple[MeasuredComponents, ...]
    noise: NoiseModel
    shared: tuple[NuisanceParameter, ...]
    unknown: tuple[UnknownRows, ...]
    layout: Layout
    expansions: Sequence[Expansion]
    level: Float[np.ndarray, " 8"]
    scale: float
    information: float

    @property
    def expected(self) -> Moments:
        """Moments of the robust score for Gaussian noise, at the usual number of components."""
        return _expected(self.noise, self.probes)

    def own(self, index: int) -> tuple[NuisanceParameter, ...]:
        """The errors that belong to one probing alone."""
        return _own(self.probes[index], self.shared)

    @property
    def sources(self) -> list[str]:
        """Source in the uncertainty budget of every entry of theta; empty for the constants."""
        sources = ["", "", *(error.source for error in self.shared)]
        for index, (seen, rows) in enumerate(zip(self.probes, self.unknown, strict=True)):
            sources += [FORCES] * 3 + [MOTIONS] * len(seen.observations.motion)
            sources += [error.source for error in self.own(index)] + [MODEL] * rows.count
        return sources

    def expanded(self, poisson_ratio: float) -> "Problem":
        """The objective with the model expanded about another Poisson's ratio."""
        expansions = (_expansion(probe, self.shared, poisson_ratio) for probe in self.probes)
        return replace(self, expansions=tuple(expansions))

    def unexpanded(self) -> "Problem":
        """The same objective, with expansions that are not kept."""
        ratio = self.expansions[0].poisson_ratio
        return replace(self, expansions=Expansions(self.probes, self.shared, ratio))

    def subset(
        self, index: int, theta: Float[np.ndarray, " t"]
    ) -> tuple["Problem", Float[np.ndarray, " b"]]:
        """The objective of one probing alone, and its part of a vector."""
        layout, chosen = self.layout, slice(index, index + 1)
        part = np.concatenate([theta[: layout.common], theta[layout.blocks[index].whole]])
        probes, unknown = self.probes[chosen], self.unknown[chosen]
        alone = replace(
            self,
            probes=probes,
            unknown=unknown,
            expansions=self.expansions[chosen],
            layout=_layout(probes, self.shared, unknown),
        )
        return alone, part

    def of(
        self,
        probes: tuple[MeasuredComponents, ...],
        shared: tuple[NuisanceParameter, ...],
        theta: Float[np.ndarray, " _"],
        unknown: tuple[UnknownRows, ...] | None = None,
    ) -> "Problem":
        """The objective of other probings with the same noise, about the constants of a vector: for
        a single point; for more it is to be `expanded`.

        Parameters
        ----------
        probes : tuple of MeasuredComponents
        shared : tuple of NuisanceParameter     that they share, with others as well
        theta : (n,) float                      begins with Poisson's ratio and log G
        unknown : tuple of UnknownRows or None  of these probings, where that is known
        """
        expansions = Expansions(probes, shared, float(theta[0]))
        if unknown is None:
            unknown = _unknown(probes, shared, expansions, float(np.exp(theta[1])))
        return replace(
            self, probes=probes, shared=shared, unknown=unknown, expansions=expansions,
            layout=_layout(probes, shared, unknown),
        )  # fmt: skip

    def precision(self) -> Float[np.ndarray, " n"]:
        """Prior precision of every entry of theta; zero for the constants."""
        layout = self.layout
        precision = np.ones(layout.size)
        precision[: layout.errors.start] = 0.0
        for block in layout.blocks:
            precision[block.unknown] = 1.0 / self.scale**2
        return precision

    def variance(self) -> list[Float[np.ndarray, " r"]]:
        """Variance of every row of each probing [m^2]: noise, and the model's error that varies
        from point to point. That is the mesh's, the same whichever probing looks at it: it counts
        once for each of them, so that it does not average out over probings."""
        times = len(self.probes) * self.scale**2
        return [
            probe.sigma(self.level) ** 2 + times * unknown.variance
            for probe, unknown in zip(self.probes, self.unknown, strict=True)
        ]

    def linearised(
        self, theta: Float[np.ndarray, " t"]
    ) -> tuple[list[Float[np.ndarray, " r"]], list[Float[np.ndarray, "s r"]]]:
        """Measured minus predicted displacement of each probing's rows, and the derivative of the
        prediction.

        Parameters
        ----------
        theta : (n,) float

        Returns
        -------
        one (r,) float [m] for each probing
        one (s, r) float [m] for each   by the common parameters, then by those of its own block;
                                        without those by the coefficients of the model's error,
                                        which come last and do not depend on theta (`UnknownRows`)
        """
        residuals, derivatives = [], []
        for k, (probe, unknown, block) in enumerate(
            zip(self.probes, self.unknown, self.layout.blocks, strict=True)
        ):
            moved, table = self._predicted(k, theta, self.expansions[k])
            residuals.append(probe.measured - moved - unknown.moved(theta[block.unknown]))
            derivatives.append(table)
        return residuals, derivatives

    def table(self, index: int, theta: Float[np.ndarray, " t"]) -> Float[np.ndarray, "s r"]:
        """The derivative of one probing's prediction, as `linearised`."""
        return self._predicted(index, theta, self.expansions[index])[1]

    def load(self, index: int, theta: Float[np.ndarray, " t"]) -> Float[np.ndarray, " c"]:
        """Load of one probing, one entry for each column of `ResponseModel`: force and 1 over the
        shear modulus, and motions."""
        block, seen = self.layout.blocks[index], self.probes[index].observations
        force = seen.force + seen.force_std * theta[block.force]
        motion = seen.motion + seen.motion_std * theta[block.motions]
        return np.concatenate([np.append(force, 1.0) / np.exp(theta[1]), motion])

    def predicted_points(self, index: int, theta: Float[np.ndarray, " t"]) -> Points:
        """Displacement of every point of a probing, measured or not, without the model's error of
        unknown shape, (n, 3) [m]."""
        probe = self.probes[index]
        model = _expansion(probe.everywhere(), self.shared, float(theta[0]))
        count = len(probe.observations.position)
        return self._predicted(index, theta, model)[0].reshape(-1, 3)[:count]

    def predicted_surface(self, index: int, theta: Float[np.ndarray, " t"]) -> Vertices | None:
        """Displacement of all vertices in a probing, (v, 3) [m]; None without their response."""
        seen = self.probes[index].observations
        return seen.surface(self.load(index, theta), float(theta[0]))

    def _errors(self, index: int, theta: Float[np.ndarray, " t"]) -> Float[np.ndarray, " k"]:
        """Errors of one probing, in the order of its expansion."""
        block = self.layout.blocks[index]
        return np.append(theta[self.layout.errors][block.shared], theta[block.errors])

    def _predicted(
        self, index: int, theta: Float[np.ndarray, " t"], model: Expansion
    ) -> tuple[Float[np.ndarray, " r"], Float[np.ndarray, "s r"]]:
        """Displacement of rows of one probing without the model's error of unknown shape, and its
        derivatives (`linearised`)."""
        block, common = self.layout.blocks[index], self.layout.common
        seen, modulus = self.probes[index].observations, float(np.exp(theta[1]))
        unshared, count = theta[block.errors], len(block.shared)
        errors = self._errors(index, theta)
        response = model.value + (theta[0] - model.poisson_ratio) * model.slope
        if errors.any():
            response[model.changed] += np.tensordot(errors, model.effects, axes=1)
        load = _in_terms(self.load(index, theta), modulus, len(response))
        bend = model.curvature @ unshared / modulus
        first = common - block.whole.start
        table = np.zeros((first + block.unknown.start, response.shape[1]))
        table[0] = load @ model.slope
        columns = 4 + len(seen.motion)
        # Term 0 scales with 1 / G except for motions; term 1 does not depend on G, but motions do.
        scaling = np.concatenate([-load[:4], np.zeros(len(load) - 4)])
        scaling[columns + 4 :] = load[columns + 4 :]
        table[1] = scaling @ response - 0.5 * bend @ unshared
        effects = load[model.changed] @ model.effects
        table[self.layout.errors.start + block.shared] = effects[:count]
        table[first + block.errors.start : first + block.errors.stop] = effects[count:] + bend.T
        force = response[:3] / modulus
        motions = response[4:columns]
        if len(load) > columns:
            force = force + response[columns : columns + 3]
            motions = motions + modulus * response[columns + 4 :]
        table[first + block.force.start : first + block.force.stop] = (
            force * seen.force_std[:, None]
        )
        table[first + block.motions.start : first + block.motions.stop] = (
            motions * seen.motion_std[:, None]
        )
        return load @ response + 0.5 * bend @ unshared, table


def make_problem(
    probes: tuple[MeasuredComponents, ...],
    noise: NoiseModel,
    *,
    poisson_ratio: float,
    shear_modulus: float,
) -> Problem:
    """The objective of some probings before its noise levels are known.

    Parameters
    ----------
    probes : tuple of MeasuredComponents
    noise : NoiseModel
    poisson_ratio : float [-]           about which the model is expanded
    shear_modulus : float [Pa]          at which the size of the model's error is taken

    Returns
    -------
    Problem                             with claimed noise, or, where none is claimed, with a small
                                        share of the motion
    """
    shared = _shared_parameters(probes)
    motion = np.concatenate([probe.measured / probe.unit for probe in probes])
    level = np.ones(GROUP_COUNT)
    level[:FIRST_CLAIMED] = _FIRST_LEVEL * np.sqrt(np.mean(motion**2))
    information = _expected(noise, probes).information
    expansions = tuple(_expansion(probe, shared, poisson_ratio) for probe in probes)
    unknown = _unknown(probes, shared, expansions, shear_modulus)
    layout = _layout(probes, shared, unknown)
    return Problem(probes, noise, shared, unknown, layout, expansions, level, 1.0, information)


def _unknown(
    probes: tuple[MeasuredComponents, ...],
    shared: tuple[NuisanceParameter, ...],
    expansions: Sequence[Expansion],
    shear_modulus: float,
) -> tuple[UnknownRows, ...]:
    """The model's error of unknown shape in each probing."""
    places = np.concatenate([probe.position for probe in probes])
    patterns_at = correlated_patterns(places[np.isfinite(places[:, 0])])
    return tuple(
        unknown_rows(probe, _fields(probe, shared, model, shear_modulus), patterns_at)
        for probe, model in zip(probes, expansions, strict=True)
    )


def _expected(noise: NoiseModel, probes: Sequence[MeasuredComponents]) -> Moments:
    components = np.concatenate([probe.components for probe in probes])
    return gaussian_moments(noise, round(float(components.mean())))


def _layout(
    probes: Sequence[MeasuredComponents],
    shared: tuple[NuisanceParameter, ...],
    unknown: Sequence[UnknownRows],
) -> Layout:
    number = {parameter.name: k for k, parameter in enumerate(shared)}
    first = 2 + len(shared)
    blocks = []
    for probe, rows in zip(probes, unknown, strict=True):
        counts = (3, len(probe.observations.motion), len(_own(probe, shared)), rows.count)
        ends = np.cumsum([first, *counts]).tolist()
        force, motions, errors, coefficients = (slice(*bounds) for bounds in pairwise(ends))
        shared_numbers = [number[error.name] for error in probe.parameters if error.name in number]
        whole = slice(first, ends[-1])
        blocks.append(
            Block(
                force,
                motions,
                errors,
                coefficients,
                whole,
                np.array(shared_numbers, dtype=np.int64),
            )
        )
        first = ends[-1]
    return Layout(slice(2, 2 + len(shared)), tuple(blocks))


def _own(
    probe: MeasuredComponents, shared: tuple[NuisanceParameter, ...]
) -> tuple[NuisanceParameter, ...]:
    names = {parameter.name for parameter in shared}
    return tuple(error for error in probe.parameters if error.name not in names)


def _shared_parameters(probes: Sequence[MeasuredComponents]) -> tuple[NuisanceParameter, ...]:
    """Parameters that occur in more than one probing, and those of the material."""
    encountered: dict[str, NuisanceParameter] = {}
    shared: dict[str, NuisanceParameter] = {}
    for probe in probes:
        for parameter in probe.parameters:
            known = parameter.is_material or parameter.name in encountered
            group = shared if known else encountered
            group[parameter.name] = parameter
    return tuple(shared.values())


def _in_terms(load: Float[np.ndarray, " c"], modulus: float, count: int) -> Float[np.ndarray, " l"]:
    """The load, and where the model has two terms the load times the modulus after it."""
    return load if count == len(load) else np.append(load, modulus * load)


def _expansion(
    probe: MeasuredComponents, shared: tuple[NuisanceParameter, ...], poisson_ratio: float
) -> Expansion:
    order, seen = _order(probe, shared), probe.observations
    low, response, high = (
        seen.response_terms(poisson_ratio + side)[probe.rows] for side in (-_STEP, 0.0, _STEP)
    )
    at = ResponseTerms(probe.rows, response, poisson_ratio)
    effects = [nuisance.effects(at) for nuisance in seen.nuisances]
    terms = max([response.shape[1], *(effect.shape[1] for effect in effects)])
    columns = [response[..., None], (high - low)[..., None] / (2 * _STEP), *effects]
    table = np.zeros((2 + len(order), terms, response.shape[2], len(response)))
    position = np.concatenate([[0, 1], 2 + np.argsort(order)])
    first = 0
    for values in columns:
        at_rows = probe.whitened(values).transpose(3, 1, 2, 0)
        table[position[first : first + len(at_rows)], : values.shape[1]] = at_rows
        first += len(at_rows)
    table = table.reshape(len(position), -1, len(response))
    changed = np.flatnonzero(table[2:].any(axis=(0, 2)))
    unshared = order[len(order) - len(_own(probe, shared)) :]
    curvature = _curvature(probe, at, unshared)
    value, slope = table[:2].copy()
    return Expansion(poisson_ratio, value, slope, table[2:, changed], changed, curvature)


def _order(
    probe: MeasuredComponents, shared: tuple[NuisanceParameter, ...]
) -> Int[np.ndarray, " k"]:
    """Order of a probing's errors in its expansion: those that it shares, then its own."""
    names = {parameter.name for parameter in shared}
    is_own = np.array([error.name not in names for error in probe.parameters], dtype=bool)
    return np.argsort(is_own, kind="stable")


def _curvature(
    probe: MeasuredComponents, at: ResponseTerms, unshared: Int[np.ndarray, " o"]
) -> Float[np.ndarray, "r o o"]:
    """Second derivatives in a probing's own errors, given by their ascending numbers, times the
    shear modulus."""
    curvature, first = np.zeros((len(at.rows), len(unshared), len(unshared))), 0
    for nuisance in probe.observations.nuisances:
        if nuisance.curvature is not None:
            begin = int(np.searchsorted(unshared, first))
            chosen = slice(begin, begin + len(nuisance.parameters))
            curvature[:, chosen, chosen] = nuisance.curvature(at)
        first += len(nuisance.parameters)
    return probe.whitened(curvature)


def _fields(
    probe: MeasuredComponents,
    shared: tuple[NuisanceParameter, ...],
    model: Expansion,
    shear_modulus: float,
) -> Float[np.ndarray, "r f"]:
    """Displacement per standard deviation of each error of the model, under the measured load."""
    seen, parameters = probe.observations, probe.parameters
    order = _order(probe, shared)
    chosen = [k for k, number in enumerate(order) if parameters[number].is_model_error]
    load = _in_terms(seen.load(shear_modulus), shear_modulus, len(model.value))
    return (load[model.changed] @ model.effects[chosen]).T
