"""What an estimation gives: constants with intervals, per probing and for all of them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from enum import StrEnum, auto
from typing import Any

from palpate.errors import InputError

# Rounding of a product in double precision, with room.
_EXACT = 1e-12
# Prior standard deviations: an error that lies farther off is named as a likely fault.
SURPRISING = 3.0
# The same: chance leads so far in one of two million, so that the model contradicts the session.
IMPOSSIBLE = 5.0
# What notes say of data that lead every constant astray; a verdict quotes such notes.
BIASED = "the estimate will be biased"
CONSTANT_NAMES = ("shear_modulus", "poisson_ratio", "young_modulus")

_SUFFIX = "_not_identifiable"
_TANGENTIAL_CURE = (
    "observe displacement vectors with all three components near the contact (a few contact radii"
    " away), or probe at more points, on steep slopes too: force and normal displacement alone"
    " determine only G / (1 - nu)"
)
_SCALE_CURE = (
    "press harder (within small deformation), measure more points nearer to the contact, or repeat"
    " probings: the displacements hardly exceed their noise"
)
# What a status means, and what to do about it.
_FINDINGS = {
    "ok": ("all three constants are determined by the data", ""),
    "poisson_ratio" + _SUFFIX: ("Poisson's ratio is not determined by the data", _TANGENTIAL_CURE),
    "shear_modulus" + _SUFFIX: ("the shear modulus is not determined by the data", _SCALE_CURE),
    "young_modulus" + _SUFFIX: ("Young's modulus is not determined by the data", _SCALE_CURE),
    "shear_modulus_and_poisson_ratio" + _SUFFIX: (
        "only Young's modulus is determined by the data, as in bending or stretching",
        f"for the shear modulus and Poisson's ratio {_TANGENTIAL_CURE}",
    ),
    "poisson_ratio_and_young_modulus" + _SUFFIX: (
        "only the shear modulus is determined by the data",
        f"for Young's modulus and Poisson's ratio {_TANGENTIAL_CURE}",
    ),
    "shear_modulus_and_young_modulus" + _SUFFIX: (
        "only Poisson's ratio is determined by the data",
        f"for the moduli check the force, then {_SCALE_CURE}",
    ),
    "nothing_identifiable": (
        "no constant is determined by the data",
        (
            "check that force, contact point and displacements belong together, with their signs"
            f" and the order of their components; then {_SCALE_CURE}"
        ),
    ),
    "model_contradicted": (
        (
            "the model does not explain what was measured, so the constants may be far off and"
            " their intervals too narrow"
        ),
        (
            "read in the notes where; check the support, the contact (point, radius, force), the"
            " place of the points on the mesh, and whether the material is the same everywhere and"
            " in all directions"
        ),
    ),
    "not_converged": (
        "the search for the constants stopped early, so the numbers are no estimate",
        (
            "look at the plots for outliers, and check that force, contact point and displacements"
            " belong together"
        ),
    ),
}


class Status(StrEnum):
    """Outcome of an estimation, its name in small letters as text; a person reads `sentence`, and
    what to do about it in `cure`."""

    OK = auto()
    POISSON_RATIO_NOT_IDENTIFIABLE = auto()
    SHEAR_MODULUS_NOT_IDENTIFIABLE = auto()
    YOUNG_MODULUS_NOT_IDENTIFIABLE = auto()
    SHEAR_MODULUS_AND_POISSON_RATIO_NOT_IDENTIFIABLE = auto()
    POISSON_RATIO_AND_YOUNG_MODULUS_NOT_IDENTIFIABLE = auto()
    SHEAR_MODULUS_AND_YOUNG_MODULUS_NOT_IDENTIFIABLE = auto()
    NOTHING_IDENTIFIABLE = auto()
    MODEL_CONTRADICTED = auto()
    NOT_CONVERGED = auto()

    @property
    def sentence(self) -> str:
        """What it means, in words, without capital and full stop."""
        return _FINDINGS[self.value][0]

    @property
    def cure(self) -> str:
        """What to do about it, in words; empty where there is nothing to do."""
        return _FINDINGS[self.value][1]

    @property
    def advice(self) -> str:
        """What it means and what to do about it."""
        return f"{self.sentence}: {self.cure}" if self.cure else self.sentence

    @classmethod
    def from_identifiable(cls, identifiable: Mapping[str, bool]) -> "Status":
        """Status that names exactly the constants that the data do not determine.

        Parameters
        ----------
        identifiable : mapping with the keys shear_modulus, poisson_ratio, young_modulus

        Raises
        ------
        InputError                  a key is missing
        """
        _check_identifiable(identifiable)
        lost = [name for name in CONSTANT_NAMES if not identifiable[name]]
        if not lost:
            return cls.OK
        if len(lost) == len(CONSTANT_NAMES):
            return cls.NOTHING_IDENTIFIABLE
        return cls("_and_".join(lost) + _SUFFIX)


def _check_identifiable(identifiable: Mapping[str, bool]) -> None:
    """Refuse a mapping that does not speak of exactly the three constants."""
    if set(identifiable) != set(CONSTANT_NAMES):
        raise InputError(
            f"identifiable has the keys {sorted(identifiable)}; must be {sorted(CONSTANT_NAMES)}"
        )


@dataclass(frozen=True, slots=True)
class Constant:
    """An elastic constant with its uncertainty; NaN and infinity mean that it is not known.

    Parameters
    ----------
    value : float                   [Pa] for moduli, [-] for Poisson's ratio
    std : float                     one standard deviation, same unit
    ci95 : (float, float)           95 % interval, same unit
    """

    value: float
    std: float
    ci95: tuple[float, float]

    def __post_init__(self) -> None:
        low, high = self.ci95
        if low > high:
            raise InputError(f"ci95 is {self.ci95}; its lower end must not exceed its upper end")
        if self.value < low or self.value > high:
            raise InputError(f"the value {self.value:g} lies outside its ci95, {low:g} to {high:g}")
        if self.std < 0.0:
            raise InputError(f"std is {self.std:g}; must not be negative")


@dataclass(frozen=True, slots=True)
class SupportEstimate:
    """How a support moved in one probing; NaN where that was not estimated.

    Parameters
    ----------
    support : int                       its number, from 1
    translation : 3 float [m]           of its middle
    translation_std : 3 float [m]       one standard deviation
    rotation : 3 float [rad]            axis times angle, about its middle
    rotation_std : 3 float [rad]

    Raises
    ------
    InputError                          a negative standard deviation
    """

    support: int
    translation: tuple[float, ...]
    translation_std: tuple[float, ...]
    rotation: tuple[float, ...]
    rotation_std: tuple[float, ...]

    def __post_init__(self) -> None:
        for std in (*self.translation_std, *self.rotation_std):
            if std < 0.0:
                raise InputError(f"std of a motion is {std:g}; must not be negative")


@dataclass(frozen=True, slots=True)
class ErrorEstimate:
    """An error of the measurement that was estimated along with the constants.

    Parameters
    ----------
    name : str                      "gain of the force sensor"
    unit : str                      "m", "rad", "m/Pa", or empty for a share
    value : float                   by how much the measurement is off, in that unit
    std : float                     one standard deviation, after the fit
    prior_std : float               one standard deviation, before

    Raises
    ------
    InputError                      a negative standard deviation
    """

    name: str
    unit: str
    value: float
    std: float
    prior_std: float

    def __post_init__(self) -> None:
        if self.std < 0.0 or self.prior_std < 0.0:
            raise InputError(
                f"std is {self.std:g}, prior_std {self.prior_std:g}; must not be negative"
            )

    @property
    def is_surprising(self) -> bool:
        """Whether it lies more than three prior standard deviations off."""
        return abs(self.value) > SURPRISING * self.prior_std

    @property
    def is_impossible(self) -> bool:
        """Whether it lies more than five off, which chance does not do."""
        return abs(self.value) > IMPOSSIBLE * self.prior_std


@dataclass(frozen=True, slots=True)
class BudgetEntry:
    """What one source adds to the uncertainty of the constants; NaN for those that the data do not
    determine.

    Parameters
    ----------
    source : str                    "gain of the force sensor"
    shear_modulus, young_modulus : float [-]    standard deviation, relative
    poisson_ratio : float [-]       standard deviation

    Raises
    ------
    InputError                      a negative standard deviation
    """

    source: str
    shear_modulus: float
    poisson_ratio: float
    young_modulus: float

    def __post_init__(self) -> None:
        for name in CONSTANT_NAMES:
            if getattr(self, name) < 0.0:
                raise InputError(f"std of {name} is {getattr(self, name):g}; must not be negative")


@dataclass(frozen=True, slots=True)
class ProbeEstimate:
    """The constants as one probing alone determines them, and how well it was explained.

    Parameters
    ----------
    name : str
    shear_modulus, poisson_ratio, young_modulus : Constant
    observed : int                  points used
    missing : int                   points looked at and not measured (NaN rows)
    rejected : int                  points that the robust loss all but switched off
    rms_residual : float [m]        over the observed points, joint estimate
    prediction_error : float [m] or None    rms residual when this probing was left out
    supports : tuple of SupportEstimate     those that move
    errors : tuple of ErrorEstimate         of the measurement of this probing alone
    identifiable : mapping                  constant's name -> whether this probing alone determines
                                            it; empty where that was not asked
    """

    name: str
    shear_modulus: Constant
    poisson_ratio: Constant
    young_modulus: Constant
    observed: int
    missing: int
    rejected: int
    rms_residual: float
    prediction_error: float | None
    supports: tuple[SupportEstimate, ...] = ()
    errors: tuple[ErrorEstimate, ...] = ()
    identifiable: Mapping[str, bool] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class Estimate:
    """The elastic constants of the object, from all its probings.

    Parameters
    ----------
    status : Status                 OK, or what is not identifiable, with its cure
    shear_modulus, poisson_ratio, young_modulus : Constant
    identifiable : mapping          constant's name -> whether the data determine it
    probes : tuple of ProbeEstimate
    seconds : mapping               stage -> wall time [s]
    method : str                    how the misfit was minimised
    settings : mapping              everything chosen, for repeating the run
    notes : tuple of str            full sentences for the reader of the result
    errors : tuple of ErrorEstimate     of the measurement, which all probings share
    budget : tuple of BudgetEntry   what the standard deviations come from, as the root of a sum of
                                    squares; the largest part of Young's modulus's first

    Raises
    ------
    InputError                      `identifiable` does not name exactly the three constants, or
                                    something contradicts something else
    """

    status: Status
    shear_modulus: Constant
    poisson_ratio: Constant
    young_modulus: Constant
    identifiable: dict[str, bool]
    probes: tuple[ProbeEstimate, ...]
    seconds: dict[str, float]
    method: str
    settings: dict[str, Any]
    notes: tuple[str, ...]
    errors: tuple[ErrorEstimate, ...] = ()
    budget: tuple[BudgetEntry, ...] = ()

    def __post_init__(self) -> None:
        expected = Status.from_identifiable(self.identifiable)
        # The other words speak of something else than what the data determine.
        if self.status != expected and self.status.value.endswith(("ok", "identifiable")):
            raise InputError(f"status is '{self.status}'; `identifiable` asks for '{expected}'")
        names = [probe.name for probe in self.probes]
        if len(set(names)) < len(names):
            raise InputError(f"{len(names)} probings have {len(set(names))} names; each its own")
        for name in CONSTANT_NAMES:
            if self.identifiable[name] and not math.isfinite(getattr(self, name).value):
                raise InputError(f"{name} is identifiable by `identifiable`, but has no value")
        values = self.shear_modulus.value, self.poisson_ratio.value, self.young_modulus.value
        _check_ranges(*values)
        # What the data do not determine is given for all of its range, each constant by itself.
        if all(self.identifiable.values()):
            _check_product(*values)

    def __repr__(self) -> str:
        parts = []
        for name in CONSTANT_NAMES:
            one: Constant = getattr(self, name)
            low, high = one.ci95
            told = f"{one.value:.4g} " if self.identifiable[name] else "not determined "
            parts.append(f"{name} {told}({low:.4g} to {high:.4g})")
        return f"Estimate: {self.status.sentence}; {', '.join(parts)}"


def _check_ranges(shear: float, ratio: float, young: float) -> None:
    """Refuse constants that no material has; NaN is unknown."""
    for name, modulus in (("shear_modulus", shear), ("young_modulus", young)):
        if modulus <= 0.0 or math.isinf(modulus):
            raise InputError(f"{name} is {modulus:g} Pa; must be positive and finite")
    if ratio <= -1.0 or ratio > 0.5:
        raise InputError(f"poisson_ratio is {ratio:g}; must be above -1, and 0.5 at most")


def _check_product(shear: float, ratio: float, young: float) -> None:
    """Refuse constants that belong to no one material."""
    expected = 2.0 * shear * (1.0 + ratio)
    # A person may have rounded all three.
    room = 2.0 * (1.0 + ratio) * _rounding(shear) + 2.0 * shear * _rounding(ratio)
    if abs(young - expected) > room + _rounding(young) + _EXACT * expected:
        raise InputError(
            f"young_modulus is {young:g} Pa, but 2 G (1 + nu) is {expected:g} Pa, with"
            f" G = {shear:g} Pa and nu = {ratio:g}"
        )


def _rounding(value: float) -> float:
    """Half a unit of the last digit that a number is written with."""
    exponent = Decimal(repr(value)).normalize().as_tuple().exponent
    return 0.5 * 10.0**exponent if isinstance(exponent, int) else math.nan
