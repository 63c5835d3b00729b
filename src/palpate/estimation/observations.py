"""What the estimation is given: measured displacements of each probing, their response in the
model, and the errors that points or probings share, as nuisance parameters."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int

from palpate.arrays import fixed_array
from palpate.errors import InputError
from palpate.records import INDEPENDENT, PointCorrelation
from palpate.shapes import Points, Vector3, Vertices


@runtime_checkable
class ResponseModel(Protocol):
    """Displacement of the observed points per unit force, as a function of Poisson's ratio.

    Rows are 3 * point + component for all points of the probing, then, where the tip was measured,
    three rows for the contact point. Columns 0 to 2 are for a unit force along x, y and z, column 3
    for all known loads together; they hold displacement times shear modulus. Further columns, if
    any, are for unit motions of the supports and hold displacements. The displacement is
    (value[:, :3] @ force + value[:, 3]) / shear_modulus + value[:, 4:] @ motion.
    """

    def value(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows c"]:
        """Response: columns 0 to 2 in m Pa / N, column 3 in m Pa, the others in m per unit."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class Settlement:
    """Dependence of a response on the shear modulus where supports are springs of known stiffness.

    How far the object sinks into the springs does not depend on its own modulus: displacement is
    nearly an affine function of 1 / G, and response(G) = response + (G / G_0 - 1) derivative.

    Parameters
    ----------
    shear_modulus : float [Pa]              G_0, at which the response was taken
    derivative : function                   Poisson's ratio -> (n_rows, c) float: derivative of the
                                            response with respect to log G at G_0
    """

    shear_modulus: float
    derivative: Callable[[float], Float[np.ndarray, "n_rows c"]]


@dataclass(frozen=True, slots=True)
class NuisanceParameter:
    """One nuisance parameter; those of the same name in several probings are one parameter.

    Parameters
    ----------
    name : str                      worded so that it can end a sentence: "gain of the force sensor"
    std : float                     of the prior, > 0
    unit : str                      of `std`: "m", "rad", "m/Pa", "m/N"; empty: a relative error
    of : str                        source in the uncertainty budget that it is part of, such as
                                    "pose of the object"; empty: it is a source of its own
    is_model_error : bool           an error of the model, whose shape is known only roughly: what
                                    it moves shows how large the model's own error is there
    is_material : bool              a parameter of the material, not an error
    """

    name: str
    std: float
    unit: str = ""
    of: str = ""
    is_model_error: bool = False
    is_material: bool = False

    @property
    def source(self) -> str:
        """Source of the uncertainty budget to which it belongs."""
        return self.of or self.name


@dataclass(frozen=True, slots=True, eq=False)
class ResponseTerms:
    """Response of some rows of a probing at one Poisson's ratio: what effects of errors depend on.

    The load on a body of shear modulus G is l = (force / G, 1 / G, motions), one entry for each
    column of `ResponseModel`. Term 0 multiplies l, so most of it scales with 1 / G; term 1, where
    there is one, multiplies G l.

    Parameters
    ----------
    rows : (r,) int                 rows of the probing (`ResponseModel`)
    value : (r, t, c) float         displacement per unit of each load, in t = 1 or 2 terms
    poisson_ratio : float [-]
    """

    rows: Int[np.ndarray, " r"]
    value: Float[np.ndarray, "r t c"]
    poisson_ratio: float


# What the budget calls errors of contacts' places, two a contact.
PLACES = "contact points"


@dataclass(frozen=True, slots=True, eq=False)
class Nuisance:
    """An error that points or probings share, with its effect on one probing.

    Parameters
    ----------
    parameters : tuple of p NuisanceParameter
    effects : function              `ResponseTerms` of the probing -> (r, s, c, p) float: change of
                                    the response per prior standard deviation of each parameter, in
                                    s = 1 or 2 terms
    curvature : function or None    `ResponseTerms` -> (r, p, p) float [m Pa]: second derivative of
                                    displacement times shear modulus, per prior standard deviation
                                    of each; for errors so large that second order matters, which
                                    belong to one probing
    """

    parameters: tuple[NuisanceParameter, ...]
    effects: Callable[[ResponseTerms], Float[np.ndarray, "r s c p"]]
    curvature: Callable[[ResponseTerms], Float[np.ndarray, "r p p"]] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ProbeObservations:
    """One probing: measured displacements of the surface, the force, and the response model.

    Parameters
    ----------
    name : str
    position : (n, 3) float [m]             observed points at rest
    displacement : (n, 3) float [m]         measured; NaN = no measurement there
    std : (n, 3) float [m] or None          1 sigma per component; None = to be estimated
    force : (3,) float [N]                  measured force on the object
    force_std : (3,) float [N]              1 sigma per component, zero = exact
    tip_displacement : (3,) float [m] or None    of the contact point, NaN = not measured
    tip_displacement_std : (3,) float [m] or None
    response : ResponseModel                3 n rows, three more where the tip was measured
    motion : (q,) float                     motions of the supports (m, or rad for rotations), one
                                            for each response column from the fifth
    motion_std : (q,) float                 1 sigma of each, zero = exact; large for a free motion
    landmarks : name -> (k, 3) float [m]    named places used in messages, such as "the contact"
    nuisances : tuple of Nuisance           errors shared by its points or by all probings; fitted
    settlement : Settlement or None         None: the response does not depend on the modulus
    vertices : ResponseModel or None        response of all mesh vertices, where their displacement
                                            is wanted with the result
    covariance : (n, 3, 3) float [m^2] or None    of each point's displacement, in addition to
                                            `std`; each point then has all three components or none;
                                            None: errors of the components are independent
    correlation : PointCorrelation          error correlation of neighbouring points, up to a common
                                            factor that is estimated from the residuals
    reference : str or None                 identifies the reference pictures (at rest); points of
                                            probings with the same reference share its noise

    Raises
    ------
    InputError                              wrong shape, infinite entry, std not positive, negative
                                            force_std or motion_std, covariance not positive
                                            definite, without std or for partly measured points
    """

    name: str
    position: Points
    displacement: Points
    std: Points | None
    force: Vector3
    force_std: Vector3
    tip_displacement: Vector3 | None
    tip_displacement_std: Vector3 | None
    response: ResponseModel
    motion: Float[np.ndarray, " q"] = field(default_factory=lambda: np.zeros(0))
    motion_std: Float[np.ndarray, " q"] = field(default_factory=lambda: np.zeros(0))
    landmarks: Mapping[str, Float[np.ndarray, "_ 3"]] = field(default_factory=dict)
    nuisances: tuple[Nuisance, ...] = ()
    settlement: Settlement | None = None
    vertices: ResponseModel | None = None
    covariance: Float[np.ndarray, "n 3 3"] | None = None
    correlation: PointCorrelation = INDEPENDENT
    reference: str | None = None

    def __post_init__(self) -> None:
        label = f"probing {self.name!r}: "
        n = len(self.position)
        shapes = {
            "position": (n, 3),
            "displacement": (n, 3),
            "std": (n, 3),
            "covariance": (n, 3, 3),
            "force": (3,),
            "force_std": (3,),
            "tip_displacement": (3,),
            "tip_displacement_std": (3,),
            "motion": (None,),
            "motion_std": self.motion.shape,
        }
        for name, shape in shapes.items():
            value = getattr(self, name)
            if value is None:
                continue
            nan_allowed = "displacement" in name or name in ("std", "covariance")
            array = fixed_array(value, name=label + name, shape=shape, nan_allowed=nan_allowed)
            object.__setattr__(self, name, array)
        _check_std(label + "std", self.std, self.displacement)
        _check_std(label + "tip_displacement_std", self.tip_displacement_std, self.tip_displacement)
        for name in ("force_std", "motion_std"):
            if np.any(getattr(self, name) < 0):
                raise InputError(
                    f"{label}{name} is {getattr(self, name)}; every component must be >= 0 "
                    "(0 = exact)"
                )

    def load(self, shear_modulus: float) -> Float[np.ndarray, " c"]:
        """The load that was measured, one entry for each column of `ResponseModel`: force and 1
        over the shear modulus, and motions.

        Parameters
        ----------
        shear_modulus : float [Pa]
        """
        return np.concatenate([np.append(self.force, 1.0) / shear_modulus, self.motion])

    def surface(self, load: Float[np.ndarray, " c"], poisson_ratio: float) -> Vertices | None:
        """Displacement of all vertices, (v, 3) [m]; None without their response.

        Parameters
        ----------
        load : (c,) float               one entry for each column of `ResponseModel`
        poisson_ratio : float [-]
        """
        if self.vertices is None:
            return None
        moved = self.vertices.value(poisson_ratio) @ load
        # Rows of a measured contact point follow those of the vertices.
        return (moved if self.tip_displacement is None else moved[:-3]).reshape(-1, 3)

    def response_terms(self, poisson_ratio: float) -> Float[np.ndarray, "n_rows t c"]:
        """The response in t = 1 or 2 terms (`ResponseTerms`): two where it depends on the modulus.

        Parameters
        ----------
        poisson_ratio : float [-]

        Raises
        ------
        InputError                          it has another shape, or is not finite
        """
        response = self.response.value(poisson_ratio)
        rows = 3 * len(self.position) + 3 * (self.tip_displacement is not None)
        shape = (rows, 4 + len(self.motion))
        if response.shape != shape or not np.isfinite(response.sum()):
            raise InputError(
                f"probing {self.name!r}: the response at poisson_ratio {poisson_ratio:g} has shape"
                f" {response.shape} and must be finite with three rows a point (and three for a"
                f" measured tip) and {shape[1]} columns; check support, contact and mesh"
            )
        if self.settlement is None:
            return response[:, None]
        change = self.settlement.derivative(poisson_ratio)
        return np.stack([response - change, change / self.settlement.shear_modulus], axis=1)


def padded(effects: Float[np.ndarray, "r s c p"], terms: int) -> Float[np.ndarray, "r t c p"]:
    """Effects with as many terms as asked for; those that are missing are zero.

    Parameters
    ----------
    effects : (r, s, c, p) float
    terms : int                     at least s

    Returns
    -------
    (r, terms, c, p) float
    """
    missing = terms - effects.shape[1]
    return effects if not missing else np.pad(effects, [(0, 0), (0, missing), (0, 0), (0, 0)])


def fixed_displacement(
    columns: Float[np.ndarray, "r p"], at: ResponseTerms
) -> Float[np.ndarray, "r 2 c p"]:
    """Effects that move points by given amounts, whatever the load and the material.

    Parameters
    ----------
    columns : (r, p) float [m]      per prior standard deviation of each parameter
    at : ResponseTerms

    Returns
    -------
    (r, 2, c, p) float
    """
    effects = np.zeros((len(columns), 2, at.value.shape[2], columns.shape[1]))
    # Entry 3 of G l is 1.
    effects[:, 1, 3] = columns
    return effects


def _check_std(name: str, std: np.ndarray | None, displacement: np.ndarray | None) -> None:
    """Refuse a standard deviation that is not positive where something was measured."""
    if std is None or displacement is None:
        return
    bad = np.isfinite(displacement) & ~(std > 0)
    if np.any(bad):
        where = tuple(int(i) for i in np.argwhere(bad)[0])
        raise InputError(
            f"{name} is {std[where]} at index {where}, and {int(bad.sum())} entries in all are not"
            " > 0 where a displacement was measured; give the true 1 sigma, or leave it out to have"
            " the noise level estimated"
        )
