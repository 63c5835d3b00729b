"""Results of an estimation: constants with intervals, jointly and for each probing."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from decimal import Decimal
from enum import StrEnum, auto
from typing import Any

from palpate.errors import InputError
from palpate.records.modulus_field import FieldEstimate
from palpate.records.reciprocity import Reciprocity

# Relative rounding error of a product in double precision, with a margin.
_RELATIVE_ROUNDING = 1e-12
# An estimated error of more than this many prior standard deviations is reported as a likely fault.
SURPRISING = 3.0
# Beyond this many, which happens by chance once in two million, the model is contradicted.
IMPOSSIBLE = 5.0
# Phrase in notes about data that bias all constants; the verdict quotes such notes.
BIASED = "the estimate will be biased"
# Half of a 95 % interval of a normal error, in standard deviations.
HALF_95 = 1.96
CONSTANT_NAMES = ("shear_modulus", "poisson_ratio", "young_modulus")

_SUFFIX = "_not_identifiable"
_TANGENTIAL_CURE = (
    "measure displacement vectors with all three components, close beside a tool that presses or"
    " across the pull between grips, or push at more points, on steep slopes too: force and normal"
    " displacement alone determine only G / (1 - nu)"
)
_SCALE_CURE = (
    "press harder (within small deformation), measure more points nearer to the contact, or repeat"
    " probings: the displacements hardly exceed their noise"
)
# Meaning of each status, and advice what to do about it.
_STATUS_TEXTS = {
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
        ("the model does not explain what was measured, so the constants may be far off"),
        (
            "read in the notes where; check the support, the contact (point, radius, force), the"
            " place of the points on the mesh, and whether the material is the same everywhere and"
            " in all directions"
        ),
    ),
    "heterogeneous": (
        "the material is not the same everywhere; the notes say what the constants are of",
        "see the map of the modulus in the report; predictions take the field along",
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
    """Outcome of an estimation; the string value is the name in lower case. `sentence` explains it
    to a reader, `cure` says what to do about it."""

    OK = auto()
    POISSON_RATIO_NOT_IDENTIFIABLE = auto()
    SHEAR_MODULUS_NOT_IDENTIFIABLE = auto()
    YOUNG_MODULUS_NOT_IDENTIFIABLE = auto()
    SHEAR_MODULUS_AND_POISSON_RATIO_NOT_IDENTIFIABLE = auto()
    POISSON_RATIO_AND_YOUNG_MODULUS_NOT_IDENTIFIABLE = auto()
    SHEAR_MODULUS_AND_YOUNG_MODULUS_NOT_IDENTIFIABLE = auto()
    NOTHING_IDENTIFIABLE = auto()
    HETEROGENEOUS = auto()
    MODEL_CONTRADICTED = auto()
    NOT_CONVERGED = auto()

    @property
    def sentence(self) -> str:
        """Meaning in words, without initial capital and full stop."""
        return _STATUS_TEXTS[self.value][0]

    @property
    def cure(self) -> str:
        """What to do about it, in words; empty if there is nothing to do."""
        return _STATUS_TEXTS[self.value][1]

    @property
    def advice(self) -> str:
        """Meaning and, if there is one, the cure, in one text."""
        return f"{self.sentence}: {self.cure}" if self.cure else self.sentence

    @classmethod
    def from_identifiable(cls, identifiable: Mapping[str, bool]) -> "Status":
        """Status that names exactly the constants that the data do not determine.

        Parameters
        ----------
        identifiable : mapping      shear_modulus, poisson_ratio, young_modulus -> bool

        Raises
        ------
        InputError                  not exactly these three keys
        """
        _check_identifiable(identifiable)
        undetermined = [name for name in CONSTANT_NAMES if not identifiable[name]]
        if not undetermined:
            return cls.OK
        if len(undetermined) == len(CONSTANT_NAMES):
            return cls.NOTHING_IDENTIFIABLE
        return cls("_and_".join(undetermined) + _SUFFIX)


def _check_identifiable(identifiable: Mapping[str, bool]) -> None:
    """Refuse a mapping whose keys are not exactly the three constants."""
    if set(identifiable) != set(CONSTANT_NAMES):
        raise InputError(
            f"identifiable has the keys {sorted(identifiable)}; must be {sorted(CONSTANT_NAMES)}"
        )


@dataclass(frozen=True, slots=True)
class Constant:
    """An elastic constant with its uncertainty; NaN and infinity mean unknown.

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
        _check_not_negative(std=self.std)


def _check_not_negative(**numbers: float) -> None:
    """Refuse negative numbers, which are given by name; NaN means unknown."""
    for name, number in numbers.items():
        if number < 0.0:
            raise InputError(f"{name} is {number:g}; must not be negative")


@dataclass(frozen=True, slots=True)
class SupportEstimate:
    """Estimated rigid motion of a support in one probing; NaN where it was not estimated.

    Parameters
    ----------
    support : int                       number of the support, from 1
    translation : 3 float [m]           of the middle of the support
    translation_std : 3 float [m]       one standard deviation
    rotation : 3 float [rad]            rotation vector about the middle, axis times angle
    rotation_std : 3 float [rad]        one standard deviation

    Raises
    ------
    InputError                          a negative standard deviation
    """

    support: int
    translation: tuple[float, float, float]
    translation_std: tuple[float, float, float]
    rotation: tuple[float, float, float]
    rotation_std: tuple[float, float, float]

    def __post_init__(self) -> None:
        for std in (*self.translation_std, *self.rotation_std):
            _check_not_negative(**{"std of a motion": std})


@dataclass(frozen=True, slots=True)
class ErrorEstimate:
    """A systematic measurement error (nuisance parameter), estimated along with the constants.

    Parameters
    ----------
    name : str                      e.g. "gain of the force sensor"
    unit : str                      "m", "rad", "m/Pa", or empty for a relative error
    value : float                   estimated error of the measurement, in that unit
    std : float                     posterior standard deviation
    prior_std : float               prior standard deviation

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
        _check_not_negative(std=self.std, prior_std=self.prior_std)

    @property
    def is_surprising(self) -> bool:
        """True where it exceeds three prior standard deviations."""
        return abs(self.value) > SURPRISING * self.prior_std


@dataclass(frozen=True, slots=True)
class BudgetEntry:
    """Contribution of one error source to the standard deviations of the constants; NaN for
    constants that the data do not determine.

    Parameters
    ----------
    source : str                    e.g. "gain of the force sensor"
    shear_modulus, young_modulus : float [-]    relative standard deviation
    poisson_ratio : float [-]       absolute standard deviation

    Raises
    ------
    InputError                      a negative standard deviation
    """

    source: str
    shear_modulus: float
    poisson_ratio: float
    young_modulus: float

    def __post_init__(self) -> None:
        _check_not_negative(**{f"std of {name}": getattr(self, name) for name in CONSTANT_NAMES})


@dataclass(frozen=True, slots=True)
class ProbeEstimate:
    """The constants as determined by one probing alone, and the residuals of that probing.

    Parameters
    ----------
    name : str                      of the probing
    shear_modulus, poisson_ratio, young_modulus : Constant
    observed : int                  number of points used
    missing : int                   points that could not be measured (NaN rows)
    rejected : int                  outliers, with almost no weight in the robust loss
    rms_residual : float [m]        over the observed points, at the joint estimate
    prediction_error : float [m] or None    rms residual at the estimate without this probing
    supports : tuple of SupportEstimate     motions of the supports that move
    errors : tuple of ErrorEstimate         systematic errors of this probing alone
    identifiable : mapping                  constant's name -> whether this probing alone determines
                                            it; empty if that was not computed
    homogeneous_error : float [m] or None   where the body is not the same everywhere:
                                            `prediction_error` with one modulus
    prediction_score : float [-] or None    rms of that prediction's errors, each over its standard
                                            deviation, noise included
    prediction_within : float [-] or None   share of them within their 95 % intervals

    Raises
    ------
    InputError                      a blank name, a negative residual; inconsistent or impossible
                                    constants
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
    homogeneous_error: float | None = None
    prediction_score: float | None = None
    prediction_within: float | None = None

    def __post_init__(self) -> None:
        if not self.name.strip():
            raise InputError("name is blank; must be a text")
        _check_not_negative(
            rms_residual=self.rms_residual,
            prediction_error=self.prediction_error or 0.0,
            homogeneous_error=self.homogeneous_error or 0.0,
            prediction_score=self.prediction_score or 0.0,
            prediction_within=self.prediction_within or 0.0,
        )
        if self.identifiable:
            _check_identifiable(self.identifiable)
            _check_constants(self, self.identifiable)


@dataclass(frozen=True, slots=True)
class RegionEstimate:
    """The modulus of a region of the object; Poisson's ratio is that of the rest.

    Parameters
    ----------
    name : str
    ratio : Constant                shear modulus over that of the rest
    shear_modulus, young_modulus : Constant
    known : str                     what the session knew of it (`Region`); empty: nothing
    identifiable : bool             whether data and session determine it
    is_seen : bool                  False: the pushes say nothing about it
    """

    name: str
    ratio: Constant
    shear_modulus: Constant
    young_modulus: Constant
    known: str
    identifiable: bool
    is_seen: bool

    @property
    def note(self) -> str:
        """A sentence for the reader where the modulus is not determined; empty where it is."""
        if not self.is_seen:
            return (
                f"No push sees region {self.name!r}: the data say nothing about its modulus. Push"
                " closer to it, or give its modulus."
            )
        if self.identifiable:
            return ""
        return (
            f"The modulus of region {self.name!r} is not determined: pushes closer to it would tell"
            " more."
        )

    @property
    def without_interval(self) -> "RegionEstimate":
        """The estimate without intervals, as of a model that does not fit."""
        ratio, shear, young = (
            Constant(constant.value, math.nan, (math.nan, math.nan))
            for constant in (self.ratio, self.shear_modulus, self.young_modulus)
        )
        return replace(self, ratio=ratio, shear_modulus=shear, young_modulus=young)


@dataclass(frozen=True, slots=True)
class RelaxationPoint:
    """The relaxation modulus at one time.

    Parameters
    ----------
    time : float [s]                since the displacement began
    modulus : Constant              [Pa]
    """

    time: float
    modulus: Constant


@dataclass(frozen=True, slots=True)
class RelaxationTerm:
    """A term of the Prony series of the modulus.

    Parameters
    ----------
    time : Constant                 relaxation time [s]
    share : float [-]               of the unrelaxed modulus
    """

    time: Constant
    share: float


@dataclass(frozen=True, slots=True)
class LossPoint:
    """The loss angle at one frequency.

    Parameters
    ----------
    frequency : float [Hz]          of an oscillating push
    angle : Constant                by which the motion lags behind the force [rad]
    """

    frequency: float
    angle: Constant


@dataclass(frozen=True, slots=True)
class RelaxationEstimate:
    """The modulus of a body that creeps, as a function of time; Poisson's ratio is constant.

    Parameters
    ----------
    constant : str                  `shear_modulus`, or `young_modulus` where only that is known
    age : float [s]                 from the first contact to the displacement of the static fit
    rise, hold : float [s]          of the force; the window that is observed is in between
    unrelaxed : float [Pa]          modulus of the series at once, of which terms are shares
    terms : tuple of RelaxationTerm     shortest times first; none: elastic
    curve : tuple of RelaxationPoint    ten a decade, whole decades among them, inside the window
    instantaneous, long_term : Constant or None [Pa]   None: not shown by the window
    remarks : tuple of str          why not, whether Poisson's ratio is constant, in sentences
    loss : tuple of LossPoint       at whole decades inside the window, of a body that creeps

    Raises
    ------
    InputError                      another constant; a time, modulus or share that cannot be
    """

    constant: str
    age: float
    rise: float
    hold: float
    unrelaxed: float
    terms: tuple[RelaxationTerm, ...]
    curve: tuple[RelaxationPoint, ...]
    instantaneous: Constant | None
    long_term: Constant | None
    remarks: tuple[str, ...]
    loss: tuple[LossPoint, ...] = ()

    def __post_init__(self) -> None:
        if self.constant not in ("shear_modulus", "young_modulus"):
            raise InputError(f"constant is {self.constant!r}; must be shear_modulus, young_modulus")
        positive = [self.age, self.rise, self.hold, self.unrelaxed]
        positive += [term.time.value for term in self.terms]
        positive += [number for point in self.curve for number in (point.time, point.modulus.value)]
        shares = [term.share for term in self.terms]
        if not (
            all(0.0 < value < math.inf for value in positive)
            and all(share >= 0.0 for share in shares)
            and sum(shares) < 1.0
        ):
            raise InputError(
                "has a time or modulus that is not positive, or shares that are negative or sum to"
                " 1 or more; fit the session again"
            )


@dataclass(frozen=True, slots=True)
class LoadDependence:
    """How the modulus changes with the load: it is proportional to force^exponent.

    Parameters
    ----------
    exponent : Constant [-]         above 0 the object stiffens
    force : (float, float) [N]      smallest and largest
    factor : (float, float) [-]     the modulus at these over that of all pushes together
    """

    exponent: Constant
    force: tuple[float, float]
    factor: tuple[float, float]


@dataclass(frozen=True, slots=True)
class Estimate:
    """The elastic constants of the object, estimated from all its probings.

    Parameters
    ----------
    status : Status                 outcome: OK, or what is not identifiable or went wrong
    shear_modulus, poisson_ratio, young_modulus : Constant
    identifiable : mapping          constant's name -> whether the data determine it
    probes : tuple of ProbeEstimate one for each probing
    seconds : mapping               stage -> wall time [s]
    method : str                    method that minimised the misfit
    settings : mapping              all settings, to repeat the run
    notes : tuple of str            full sentences for the reader of the result, the most important
                                    first, at most three
    errors : tuple of ErrorEstimate     systematic errors common to all probings
    budget : tuple of BudgetEntry   uncertainty budget, whose squares sum to the variances; largest
                                    contribution to Young's modulus first
    details : tuple of str          further sentences, for those who want to know all
    reciprocity : Reciprocity or None    test of the pushes against each other; None: not made
    field : FieldEstimate or None   None: one modulus everywhere, or regions
    regions : tuple of RegionEstimate   parts with moduli of their own; the constants are then those
                                    of the rest
    relaxation : RelaxationEstimate or None     None: no probing has a series
    stiffening : Constant or None [-]   C2 / C1 of Yeoh's law, whose small strain has the constants
                                    above; None: the data do not show it, or small strain was taken
    load : LoadDependence or None   None: the data do not show that the modulus changes with it

    Raises
    ------
    InputError                      `identifiable` does not have exactly the three constants as
                                    keys; a status, names or constants that contradict each other
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
    details: tuple[str, ...] = ()
    reciprocity: Reciprocity | None = None
    field: FieldEstimate | None = None
    regions: tuple[RegionEstimate, ...] = ()
    relaxation: RelaxationEstimate | None = None
    stiffening: Constant | None = None
    load: LoadDependence | None = None

    def __post_init__(self) -> None:
        expected = Status.from_identifiable(self.identifiable)
        # The other statuses do not depend on which constants are identifiable.
        if self.status != expected and self.status.value.endswith(("ok", "identifiable")):
            raise InputError(f"status is '{self.status}'; `identifiable` asks for '{expected}'")
        names = [probe.name for probe in self.probes]
        if len(set(names)) < len(names):
            raise InputError(f"{len(names)} probings have {len(set(names))} names; each its own")
        _check_constants(self, self.identifiable)

    def __repr__(self) -> str:
        parts = []
        for name in CONSTANT_NAMES:
            constant: Constant = getattr(self, name)
            low, high = constant.ci95
            value = f"{constant.value:.4g} " if self.identifiable[name] else "not determined "
            parts.append(f"{name} {value}({low:.4g} to {high:.4g})")
        return f"Estimate: {self.status.sentence}; {', '.join(parts)}"


def _check_constants(estimate: ProbeEstimate | Estimate, identifiable: Mapping[str, bool]) -> None:
    """Refuse constants that contradict each other, or `identifiable`."""
    constants: dict[str, Constant] = {name: getattr(estimate, name) for name in CONSTANT_NAMES}
    for name, constant in constants.items():
        if identifiable[name] and not math.isfinite(constant.value):
            raise InputError(f"{name} is identifiable by `identifiable`, but has no value")
    values = [constant.value for constant in constants.values()]
    _check_ranges(*values)
    # A constant that is not determined is given for its whole range, independently of the others.
    if all(identifiable.values()):
        _check_product(*values)


def _check_ranges(shear: float, ratio: float, young: float) -> None:
    """Refuse constants out of the range of any material; NaN means unknown."""
    for name, modulus in (("shear_modulus", shear), ("young_modulus", young)):
        if modulus <= 0.0 or math.isinf(modulus):
            raise InputError(f"{name} is {modulus:g} Pa; must be positive and finite")
    if ratio <= -1.0 or ratio > 0.5:
        raise InputError(f"poisson_ratio is {ratio:g}; must be above -1, and 0.5 at most")


def _check_product(shear: float, ratio: float, young: float) -> None:
    """Refuse constants that violate E = 2 G (1 + nu)."""
    expected = 2.0 * shear * (1.0 + ratio)
    # All three may have been rounded by hand.
    tolerance = 2.0 * (1.0 + ratio) * _rounding(shear) + 2.0 * shear * _rounding(ratio)
    if abs(young - expected) > tolerance + _rounding(young) + _RELATIVE_ROUNDING * expected:
        raise InputError(
            f"young_modulus is {young:g} Pa, but 2 G (1 + nu) is {expected:g} Pa, with"
            f" G = {shear:g} Pa and nu = {ratio:g}"
        )


def _rounding(value: float) -> float:
    """Half a unit in the last written digit of a number."""
    exponent = Decimal(repr(value)).normalize().as_tuple().exponent
    return 0.5 * 10.0**exponent if isinstance(exponent, int) else math.nan
