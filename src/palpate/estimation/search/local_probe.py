"""One probing in units of the noise, linearised at given constants, forces and errors."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from palpate.estimation.noise import NoiseModel
from palpate.estimation.observed_rows import ObservedRows, weighted_square


@dataclass(frozen=True, slots=True, eq=False)
class SearchState:
    """Values of all that is estimated together.

    Parameters
    ----------
    poisson_ratio : float [-]
    shear_modulus : float [Pa]      > 0
    errors : (m,) float             shared errors, in prior standard deviations
    shifts : tuple of (n,) float    `LocalProbe.shift` of each probing
    """

    poisson_ratio: float
    shear_modulus: float
    errors: Float[np.ndarray, " m"]
    shifts: tuple[Float[np.ndarray, " _"], ...]

    @property
    def vector(self) -> Float[np.ndarray, " p"]:
        """All of them as one vector, the modulus as its logarithm."""
        constants = [self.poisson_ratio, np.log(self.shear_modulus)]
        return np.concatenate([constants, self.errors, *self.shifts])

    def moved(self, change: Float[np.ndarray, " p"]) -> "SearchState":
        """The state after a change of `vector`."""
        ends = np.cumsum([2, len(self.errors), *map(len, self.shifts)])
        _, errors, *moves, _ = np.split(change, ends)
        return SearchState(
            self.poisson_ratio + float(change[0]),
            self.shear_modulus * float(np.exp(change[1])),
            self.errors + errors,
            tuple(shift + move for shift, move in zip(self.shifts, moves, strict=True)),
        )


@dataclass(frozen=True, slots=True, eq=False)
class ScaledRows:
    """Response and measurement of one probing in units of the noise.

    Parameters
    ----------
    probe : ObservedRows
    measured : (r,) float [-]
    base : (r, c) float             response at a reference Poisson's ratio, over the noise
    slope : (r, c) float            its derivative with respect to Poisson's ratio; zero if not
                                    requested
    effects : (r, e) float          change in displacement per prior standard deviation of each
                                    error, at the reference: the m shared errors, then the o of its
                                    own; e = m + o
    curvature : (r, o, o) float or None     second derivatives in its own errors; None: the effects
                                    are linear
    drift : (r, 3) float            derivative of the displacement explained by the errors at the
                                    reference, per standard deviation of each force component
    force : (3,) float              shift of the force at the reference, in sigmas
    poisson_ratio : float [-]       the reference
    shear_modulus : float [Pa]      at which `effects` were taken; they scale as 1 / G
    considered : (r, q) float       change per prior standard deviation of each error that is
                                    considered, not fitted; no columns if not requested
    settling : (r, c) float or None derivative of the response with respect to log G there, over the
                                    noise; None: the response does not depend on G
    """

    probe: ObservedRows
    measured: Float[np.ndarray, " r"]
    base: Float[np.ndarray, "r c"]
    slope: Float[np.ndarray, "r c"]
    effects: Float[np.ndarray, "r e"]
    curvature: Float[np.ndarray, "r o o"] | None
    drift: Float[np.ndarray, "r 3"]
    force: Float[np.ndarray, "3"]
    poisson_ratio: float
    shear_modulus: float
    considered: Float[np.ndarray, "r q"]
    settling: Float[np.ndarray, "r c"] | None = None

    def response(self, poisson_ratio: float, shear_modulus: float) -> Float[np.ndarray, "r c"]:
        """Response at a Poisson's ratio and a shear modulus [Pa], over the noise, (r, c)."""
        offset = poisson_ratio - self.poisson_ratio
        response = self.base if offset == 0 else self.base + offset * self.slope
        if self.settling is None:
            return response
        return response + (shear_modulus / self.shear_modulus - 1.0) * self.settling


@dataclass(frozen=True, slots=True, eq=False)
class LocalProbe:
    """One probing linearised at given constants, true force, motions and errors, in units of the
    noise.

    Parameters
    ----------
    rows : ObservedRows
    table : (r, d + n + 1) float    Jacobian of the prediction in the d common parameters (nu, log
                                    G, shared errors) and in the n shifts; last column: the
                                    residual, measured minus predicted
    squared : (p,) float            squared length of every point's residual
    explained : (r,) float          displacement explained by the errors
    weight : (p,) float             robust weight of every point
    shift : (n,) float              true minus measured force, likewise for the motions of supports,
                                    then the probing's own errors, in sigmas
    force_weight : float            robust weight of the measured force
    loss : float                    contribution to the misfit
    considered : (r, q) float       change per prior standard deviation of each error that is
                                    considered, not fitted
    """

    rows: ObservedRows
    table: Float[np.ndarray, "r t"]
    squared: Float[np.ndarray, " p"]
    explained: Float[np.ndarray, " r"]
    weight: Float[np.ndarray, " p"]
    shift: Float[np.ndarray, " n"]
    force_weight: float
    loss: float
    considered: Float[np.ndarray, "r q"]

    @property
    def common(self) -> int:
        """Number d of parameters in common with the other probings."""
        return self.table.shape[1] - len(self.shift) - 1

    @property
    def design(self) -> Float[np.ndarray, "r d"]:
        """Jacobian of the prediction (design matrix)."""
        return self.table[:, :-1]

    @property
    def residual(self) -> Float[np.ndarray, " r"]:
        """Measured minus predicted."""
        return self.table[:, -1]

    def prior(self, force_weight: float | None = None) -> Float[np.ndarray, " n"]:
        """Prior weight of each shift, (n,); that of the force as given, else its robust weight."""
        weight = self.force_weight if force_weight is None else force_weight
        prior = self.rows.prior(weight)
        return np.append(prior, np.ones(len(self.shift) - len(prior)))

    def weighted_products(self) -> Float[np.ndarray, "t t"]:
        """Weighted Gram matrix of the table, table' W table, (t, t) [-]; W: the robust weights."""
        return weighted_square(self.table.T, self.rows.per_row(self.weight))


def linearised_probe(
    noise: NoiseModel, rows: ScaledRows, at: SearchState, shift: Float[np.ndarray, " n"]
) -> LocalProbe:
    """Linearise one probing at some constants and shared errors, and at its own shifts.

    Parameters
    ----------
    noise : NoiseModel
    rows : ScaledRows
    at : SearchState
    shift : (n,) float              its shifts of this probing

    Returns
    -------
    LocalProbe
    """
    probe = rows.probe
    shear_modulus, errors = at.shear_modulus, at.errors
    response = rows.response(at.poisson_ratio, shear_modulus)
    load = probe.load(shear_modulus, shift)
    moved = response[:, :4] @ load[:4]
    shared, first = len(errors), 2 + len(errors)
    motions = probe.load_shifts
    scale = rows.shear_modulus / shear_modulus
    effects, drift = scale * rows.effects, scale * rows.drift
    explained = effects @ np.append(errors, shift[motions:])
    if rows.curvature is not None:
        effect_changes = scale * (rows.curvature @ shift[motions:])
        explained += 0.5 * effect_changes @ shift[motions:]
        effects[:, shared:] += effect_changes
    explained += drift @ (shift[:3] - rows.force)
    moved += explained
    table = np.empty((len(moved), first + len(shift) + 1))
    table[:, 0] = rows.slope @ load
    np.negative(moved, out=table[:, 1])
    if rows.settling is not None:
        table[:, 1] += (shear_modulus / rows.shear_modulus) * (rows.settling @ load)
    table[:, 2:first] = effects[:, :shared]
    table[:, first : first + motions] = probe.per_shift(response, shear_modulus)
    table[:, first : first + 3] += drift
    table[:, first + motions : -1] = effects[:, shared:]
    np.subtract(rows.measured, moved + response[:, 4:] @ load[4:], out=table[:, -1])
    squared = probe.squared_length(table[:, -1])
    length = np.array([shift[:3] @ shift[:3]])
    count = np.array([float(probe.force_components)])
    loss = noise.loss(squared, probe.components).sum() + noise.loss(length, count).sum()
    loss += shift[3:] @ shift[3:]
    return LocalProbe(
        rows=probe,
        table=table,
        squared=squared,
        explained=explained,
        weight=noise.weight(squared, probe.components),
        shift=shift,
        force_weight=float(noise.weight(length, count)[0]),
        loss=float(loss),
        considered=scale * rows.considered,
    )
