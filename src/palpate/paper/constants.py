"""The paper's table 3 and figure 4 on the virtual bench: constants from pictures and forces,
compared with a compression test of the same material."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from palpate.errors import InputError
from palpate.estimation import FitResult
from palpate.figures import Picture, displacement_figure, figure_pixels
from palpate.lab import Material, cylinder
from palpate.paper.motion import PAPER
from palpate.paper.result import Cell, ResultTable
from palpate.paper.sessions import (
    PAPER_ALL_PROBES,
    PAPER_COMPRESSION_MODULUS,
    PAPER_PROBES,
    Method,
    PaperSession,
)
from palpate.pipeline import fit_session, with_measured_displacement
from palpate.records import Constant, Estimate, FlatFace, ProbeEstimate, Session
from palpate.solids import Tip, held_nodes, make_body, make_solid, press

# Cylinder cut from foam [m], and the strain of the compression test.
_RADIUS, _HEIGHT, _STRAIN = 0.015, 0.03, 0.01
_ELEMENT = 0.005
_KPA = 1e-3
# Constants by their symbols in tables.
CONSTANTS = {"nu": "poisson_ratio", "G": "shear_modulus", "E": "young_modulus"}


def estimated_constants(measured: PaperSession, method: Method) -> tuple[Session, FitResult]:
    """Estimate the constants from the motion measured by one method.

    Parameters
    ----------
    measured : PaperSession         with probings
    method : Method                 a method whose motion was measured

    Returns
    -------
    Session, FitResult              with the measured displacements, and the fit to them

    Raises
    ------
    InputError                      a motion that could not be measured
    SingularSystemError, NotConvergedError    as in `fit_session`
    """
    session = with_measured_displacement(measured.session, measured.flows[method])
    return session, fit_session(session)


def compressed_modulus(material: Material) -> float:
    """Apparent Young's modulus of a finite element cylinder that is compressed by one per cent.

    The cylinder sticks to its lower plate; the upper plate is frictionless.

    Parameters
    ----------
    material : Material

    Returns
    -------
    float [Pa]                      a few per cent too high, because one end sticks

    Raises
    ------
    InputError, MeshError           as in `make_solid` and `make_body`
    NotConvergedError               as in `press`

    Source
    ------
    Lang and Pai (2001), section 5: E = F l / (A dl).
    """
    mesh = cylinder(radius=_RADIUS, height=_HEIGHT, edge=_ELEMENT / 5.0)
    solid = make_solid(mesh, edge=_ELEMENT)
    base = np.flatnonzero((np.abs(mesh.vertices[mesh.triangles][:, :, 2]) < 1e-9).all(axis=1))
    body = make_body(
        solid,
        held_nodes(solid, base),
        shear_modulus=material.shear_modulus,
        poisson_ratio=material.poisson_ratio,
    )
    plate = Tip(FlatFace(2.0 * _RADIUS), np.array([0.0, 0.0, _HEIGHT]), np.array([0.0, 0.0, -1.0]))
    (state,) = press(body, plate, np.array([_STRAIN * _HEIGHT]))
    return float(-state.force[2]) / (np.pi * _RADIUS**2 * _STRAIN)


def constants_table(estimate: Estimate, title: str) -> ResultTable:
    """Table of the constants of each probing alone and of all together, with 95 % intervals.

    Parameters
    ----------
    estimate : Estimate
    title : str

    Returns
    -------
    ResultTable                     moduli in kPa
    """
    rows: list[tuple[Cell, ...]] = []
    lines: list[tuple[str, Estimate | ProbeEstimate]] = [(p.name, p) for p in estimate.probes]
    for name, fitted in [*lines, ("all", estimate)]:
        nu = _value_and_ends(fitted, "nu", 1.0)
        rows.append(
            (name, *nu, *_value_and_ends(fitted, "G", _KPA), *_value_and_ends(fitted, "E", _KPA))
        )
    columns = (
        "probing", "nu", "from", "to", "G (kPa)", "from", "to", "E (kPa)", "from", "to",
    )  # fmt: skip
    return ResultTable(title, columns, (0, 4, 4, 4, 2, 2, 2, 2, 2, 2), tuple(rows))


def constants_summary(
    estimates: Mapping[Method, Estimate], truth: Material, compressed: float
) -> ResultTable:
    """Table of the spread over single probings, the joint estimate, and its error.

    The paper's error of E is relative to its compression test, ours to the truth.

    Parameters
    ----------
    estimates : mapping                 method -> Estimate
    truth : Material
    compressed : float [Pa]         Young's modulus of a compression test of the same material

    Returns
    -------
    ResultTable                     the paper's row first; errors of E in per cent; whether an
                                    interval covers the truth is None where none is stated
    """
    published = np.array(list(PAPER_PROBES.values()))[:, :2]
    ratio, _, young = PAPER_ALL_PROBES
    error = young / PAPER_COMPRESSION_MODULUS - 1.0
    rows: list[tuple[Cell, ...]] = [
        (PAPER, *_spread(published), ratio, None, 100 * error, None, None)
    ]
    for method, estimate in estimates.items():
        single = np.array([(p.poisson_ratio.value, p.shear_modulus.value) for p in estimate.probes])
        ((nu_error, _, young_error),) = constant_errors([estimate], truth)
        ((nu_held, _, young_held),) = intervals_hold([estimate], truth).tolist()
        rows.append(
            (method, *_spread(single), estimate.poisson_ratio.value, float(nu_error),
             float(100 * young_error), _yes_or_no(estimate.poisson_ratio, nu_held),
             _yes_or_no(estimate.young_modulus, young_held))
        )  # fmt: skip
    title = (
        f"Table 3: truth nu {truth.poisson_ratio:g}, E {_KPA * truth.young_modulus:g} kPa;"
        f" compression test of a cylinder {_KPA * compressed:.2f} kPa"
    )
    columns = (
        "source", "single", "nu from", "nu to", "sd nu", "sd G (%)", "all: nu", "nu off",
        "E off (%)", "nu in 95 %", "E in 95 %",
    )  # fmt: skip
    return ResultTable(title, columns, (0, 0, 3, 3, 4, 2, 4, 4, 2, 0, 0), tuple(rows))


def constant_errors(
    estimates: Sequence[Estimate | ProbeEstimate], truth: Material
) -> Float[np.ndarray, "k 3"]:
    """Errors of estimated constants.

    Parameters
    ----------
    estimates : sequence of k Estimate or ProbeEstimate
    truth : Material

    Returns
    -------
    (k, 3) float [-]                error of nu, relative error of G, relative error of E
    """
    true = np.array([getattr(truth, name) for name in CONSTANTS.values()])
    value = np.array([[getattr(e, name).value for name in CONSTANTS.values()] for e in estimates])
    return (value - true) / [1.0, true[1], true[2]]


def intervals_hold(
    estimates: Sequence[Estimate | ProbeEstimate], truth: Material
) -> Bool[np.ndarray, "k 3"]:
    """Whether the 95 % intervals cover the truth.

    Parameters
    ----------
    estimates : sequence of k Estimate or ProbeEstimate
    truth : Material

    Returns
    -------
    (k, 3) bool                     of nu, G and E
    """
    true = np.array([getattr(truth, name) for name in CONSTANTS.values()])
    ends = np.array([[getattr(e, name).ci95 for name in CONSTANTS.values()] for e in estimates])
    return (ends[..., 0] <= true) & (true <= ends[..., 1])


def motion_picture(session: Session, result: FitResult, name: str) -> Picture:
    """Figure 4: measured and simulated displacement of a probing on the specimen.

    Parameters
    ----------
    session : Session
    result : FitResult              of it
    name : str                      of the probing

    Returns
    -------
    Picture                         as drawn by `displacement_figure`

    Raises
    ------
    InputError                      nothing was measured in it
    """
    (probing,) = (candidate for candidate in session.probings if candidate.name == name)
    (fit,) = (candidate for candidate in result.probes if candidate.name == name)
    figure = displacement_figure(session.mesh, probing, fit)
    if figure is None:
        raise InputError(f"probing '{name}' cannot be drawn: nothing was measured in it")
    return figure_pixels(figure)


def _value_and_ends(
    estimate: Estimate | ProbeEstimate, symbol: str, factor: float
) -> tuple[float, ...]:
    """Value and ends of the interval of a constant, times a factor."""
    constant: Constant = getattr(estimate, CONSTANTS[symbol])
    return tuple(factor * value for value in (constant.value, *constant.ci95))


def _yes_or_no(constant: Constant, held: bool) -> Cell:
    """Whether a constant's interval holds the truth; None where there is no interval."""
    return ("yes" if held else "no") if np.isfinite(constant.ci95).all() else None


def _spread(single: Float[np.ndarray, "k 2"]) -> tuple[Cell, ...]:
    """Number of single probings, minimum and maximum of nu, standard deviations of nu and G [%]."""
    ratio, shear = single.T
    return (
        len(single), float(ratio.min()), float(ratio.max()), float(ratio.std(ddof=1)),
        float(100 * shear.std(ddof=1) / shear.mean()),
    )  # fmt: skip
