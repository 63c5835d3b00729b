"""Misfit between measured and predicted displacement, over all probings together.

A measured force is an observation like any other: F_measured = F + noise, with the true force F
unknown. For given constants the true forces are eliminated probing by probing (profile likelihood
of a functional errors-in-variables model), and with them unknown motions of supports and every
nuisance parameter (`nuisance`). They are profiled out, not integrated out: the normaliser of an
integral over F would favour large moduli, by three force variances over the squared force for
every probing.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from palpate.errors import NotConvergedError
from palpate.estimation.noise import NoiseModel
from palpate.estimation.nuisance import LoadedResponse, NuisanceParameter
from palpate.estimation.observed_rows import ObservedRows
from palpate.estimation.search.local_probe import (
    LocalProbe,
    ScaledRows,
    SearchState,
    linearised_probe,
)

_MAX_FORCE_STEPS = 200
_FORCE_TOLERANCE = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Misfit:
    """Minus twice the profile log likelihood of the constants: true forces and errors eliminated.

    Parameters
    ----------
    probes : tuple of ObservedRows
    level : (8,) float                      noise level of each group, see `noise_levels`
    noise : NoiseModel                      of a point's displacement and of a probing's force
    shared : tuple of NuisanceParameter     the m errors that probings of the session share; by
                                            default those that occur in several of `probes`
    """

    probes: tuple[ObservedRows, ...]
    level: Float[np.ndarray, " 8"]
    noise: NoiseModel
    shared: tuple[NuisanceParameter, ...] = None  # type: ignore[assignment]

    def __post_init__(self) -> None:
        if self.shared is None:
            object.__setattr__(self, "shared", _shared_parameters(self.probes))

    def own(self, probe: ObservedRows) -> tuple[NuisanceParameter, ...]:
        """The errors that belong to one probing alone."""
        shared = {parameter.name for parameter in self.shared}
        return tuple(own for own in probe.parameters if own.name not in shared)

    def start(self, poisson_ratio: float, shear_modulus: float) -> SearchState:
        """State at given constants with forces and motions as measured, and no errors."""
        counts = (probe.load_shifts + len(self.own(probe)) for probe in self.probes)
        errors = np.zeros(len(self.shared))
        return SearchState(poisson_ratio, shear_modulus, errors, tuple(map(np.zeros, counts)))

    def __call__(self, poisson_ratio: float, shear_modulus: float) -> float:
        """Misfit at given constants, at its minimum over true forces, motions and errors.

        Parameters
        ----------
        poisson_ratio : float [-]
        shear_modulus : float [Pa]      > 0

        Returns
        -------
        float [-]

        Raises
        ------
        NotConvergedError                   the true force of a probing did not converge
        """
        errors, local = self.at_best_forces(poisson_ratio, shear_modulus, with_slope=False)
        return total_loss(local, errors)

    def at_best_forces(
        self, poisson_ratio: float, shear_modulus: float, *, with_slope: bool = True
    ) -> tuple[Float[np.ndarray, " m"], tuple[LocalProbe, ...]]:
        """Every probing linearised at given constants and at the best true forces, motions and
        errors, by reweighted least squares.

        Parameters
        ----------
        poisson_ratio : float [-]
        shear_modulus : float [Pa]      > 0
        with_slope : bool               False: without derivatives in Poisson's ratio, and without
                                        considered errors

        Returns
        -------
        (m,) float, tuple of LocalProbe     shared errors in sigmas; probings

        Raises
        ------
        NotConvergedError                   the true force of a probing did not converge
        """
        state = self.start(poisson_ratio, shear_modulus)
        rows = self.scaled(state, with_slope=with_slope)
        local = self.linearised(rows, state)
        for _ in range(_MAX_FORCE_STEPS):
            normal, gradient, solutions = common_equations(local, state.errors)
            step = np.linalg.solve(normal[2:, 2:], gradient[2:])
            moves = [solution[:, -1] - solution[:, 2:-1] @ step for solution in solutions]
            change = np.concatenate([np.zeros(2), step, *moves])
            state = state.moved(change)
            local = self.linearised(rows, state)
            if np.abs(change).max() < _FORCE_TOLERANCE * (1 + np.abs(state.vector[2:]).max()):
                if with_slope:
                    # What non-zero errors explain depends on the force, too: linearise again.
                    local = self.linearised(self.scaled(state), state)
                return state.errors, local
        worst = max(local, key=lambda probe: float(np.abs(probe.shift).max()))
        raise NotConvergedError(
            f"probing {worst.rows.name!r}: the true force did not settle in {_MAX_FORCE_STEPS}"
            " steps; check force_std against the force"
        )

    def scaled(self, about: SearchState, *, with_slope: bool = True) -> list[ScaledRows]:
        """Rows of every probing in units of the noise, for linearisation about a state.

        Parameters
        ----------
        about : SearchState
        with_slope : bool               False: slope and drift are zero, and considered errors are
                                        left out

        Returns
        -------
        list of ScaledRows              one for each probing
        """
        poisson_ratio, shear_modulus = about.poisson_ratio, about.shear_modulus
        scaled = []
        for probe, shift in zip(self.probes, about.shifts, strict=True):
            sigma = probe.sigma(self.level)[:, None]
            # First, as it evaluates at other ratios: a response caches its latest solution only.
            slope = probe.slope(poisson_ratio) if with_slope else 0.0
            response = probe.value(poisson_ratio)
            settling = probe.settling(poisson_ratio, shear_modulus)
            settlement = probe.observations.settlement
            if settling is not None and settlement is not None:
                relative_change = 1.0 - settlement.shear_modulus / shear_modulus
                response = response + relative_change * settling
                settling = settling / sigma
            at = probe.loaded(response, probe.load(shear_modulus, shift), poisson_ratio)
            effects, curvature = self._effects(probe, at), self._curvature(probe, at)
            drift = np.zeros((len(sigma), 3))
            all_errors = np.append(about.errors, shift[probe.load_shifts :])
            considered = probe.columns(probe.observations.considered if with_slope else (), at)
            if with_slope and all_errors.any():
                start = _explained(effects, curvature, all_errors)
                drift = self._drift(probe, at, all_errors, start)
            scaled.append(
                ScaledRows(
                    probe=probe,
                    measured=probe.measured / sigma[:, 0],
                    base=response / sigma,
                    slope=np.broadcast_to(slope, response.shape) / sigma,
                    effects=effects / sigma,
                    curvature=None if curvature is None else curvature / sigma[:, :, None],
                    drift=drift / sigma,
                    force=np.array(shift[:3]),
                    poisson_ratio=poisson_ratio,
                    shear_modulus=shear_modulus,
                    considered=considered / sigma,
                    settling=settling,
                )
            )
        return scaled

    def _effects(self, probe: ObservedRows, at: LoadedResponse) -> Float[np.ndarray, "r e"]:
        """Change in displacement per prior standard deviation of each error [m]: the shared errors,
        then the probing's own."""
        names = [parameter.name for parameter in (*self.shared, *self.own(probe))]
        columns = probe.columns(probe.observations.nuisances, at)
        effects = np.zeros((len(columns), len(names)))
        effects[:, [names.index(parameter.name) for parameter in probe.parameters]] = columns
        return effects

    def _curvature(
        self, probe: ObservedRows, at: LoadedResponse
    ) -> Float[np.ndarray, "r o o"] | None:
        """Second derivatives in the probing's own errors [m]; None: effects are linear."""
        curved = probe.curvature(at)
        if not curved:
            return None
        names = [parameter.name for parameter in self.own(probe)]
        whole = np.zeros((len(curved[0][1]), len(names), len(names)))
        for parameters, curvature in curved:
            own = [names.index(parameter.name) for parameter in parameters]
            whole[:, np.array(own)[:, None], own] = curvature
        return whole

    def _drift(
        self,
        probe: ObservedRows,
        at: LoadedResponse,
        errors: Float[np.ndarray, " e"],
        start: Float[np.ndarray, " r"],
    ) -> Float[np.ndarray, "r 3"]:
        """Derivative of the displacement explained by the errors, `start`, per standard deviation
        of each force component [m]."""
        drift = np.zeros((len(start), 3))
        for i in np.flatnonzero(probe.observations.force_std):
            load = at.load.copy()
            # load[3] is 1 / G.
            load[i] += probe.observations.force_std[i] * load[3]
            changed = replace(at, load=load)
            effects, curvature = self._effects(probe, changed), self._curvature(probe, changed)
            drift[:, i] = _explained(effects, curvature, errors) - start
        return drift

    def linearised(self, rows: Sequence[ScaledRows], at: SearchState) -> tuple[LocalProbe, ...]:
        """Every probing linearised at a state.

        Parameters
        ----------
        rows : sequence of ScaledRows   response and slope at the reference
        at : SearchState

        Returns
        -------
        tuple of LocalProbe             one for each probing
        """
        return tuple(
            linearised_probe(self.noise, row, at, shift)
            for row, shift in zip(rows, at.shifts, strict=True)
        )


def _explained(
    effects: Float[np.ndarray, "r e"],
    curvature: Float[np.ndarray, "r o o"] | None,
    errors: Float[np.ndarray, " e"],
) -> Float[np.ndarray, " r"]:
    """Displacement explained by the errors, to second order in the last o of them."""
    explained = effects @ errors
    if curvature is None:
        return explained
    own = errors[len(errors) - curvature.shape[1] :]
    return np.asarray(explained + 0.5 * (curvature @ own) @ own)


def _shared_parameters(probes: Sequence[ObservedRows]) -> tuple[NuisanceParameter, ...]:
    """Parameters that occur in more than one probing."""
    encountered: dict[str, NuisanceParameter] = {}
    shared: dict[str, NuisanceParameter] = {}
    for probe in probes:
        for parameter in probe.parameters:
            group = shared if parameter.name in encountered else encountered
            group[parameter.name] = parameter
    return tuple(shared.values())


def total_loss(local: Sequence[LocalProbe], errors: Float[np.ndarray, " m"]) -> float:
    """The misfit from linearised probings.

    Parameters
    ----------
    local : sequence of LocalProbe
    errors : (m,) float             shared errors, in sigmas

    Returns
    -------
    float [-]
    """
    return float(sum(probe.loss for probe in local) + errors @ errors)


def common_equations(
    local: Sequence[LocalProbe],
    errors: Float[np.ndarray, " m"],
    factors: Sequence[float] | None = None,
) -> tuple[Float[np.ndarray, "d d"], Float[np.ndarray, " d"], list[Float[np.ndarray, "_ _"]]]:
    """Normal equations of the common parameters, with the shifts of each probing eliminated.

    Parameters
    ----------
    local : sequence of LocalProbe
    errors : (m,) float             shared errors, in sigmas; d = 2 + m
    factors : one for each probing  on the products of its Jacobian, 1 by default

    Returns
    -------
    normal : (d, d) float
    gradient : (d,) float
    solutions : one (n, d + 1) float for each probing    minus the change of its shifts per unit of
                                    each common parameter; last column: their step with these fixed
    """
    d = 2 + len(errors)
    normal, gradient = np.diag(np.append(np.zeros(2), np.ones(d - 2))), np.zeros(d)
    gradient[2:] = -errors
    solutions = []
    for probe, factor in zip(local, factors or np.ones(len(local)), strict=True):
        products, prior = probe.weighted_products(), probe.prior()
        inner, score = factor * products[:-1, :-1], products[:-1, -1]
        own = inner[d:, d:] + np.diag(prior)
        own_score = score[d:] - prior * probe.shift
        solution = np.linalg.solve(own, np.column_stack([inner[d:, :d], own_score]))
        normal += inner[:d, :d] - inner[:d, d:] @ solution[:, :d]
        gradient += score[:d] - inner[:d, d:] @ solution[:, d]
        solutions.append(solution)
    return normal, gradient, solutions
