"""Table 3 and figure 4 of the paper: constants by probing, and measured beside simulated motion."""

from collections.abc import Mapping

import matplotlib as mpl
import numpy as np

from palpate.errors import InputError
from palpate.figures import STYLE, displacement_figure, probings_figure
from palpate.lab import Material
from palpate.paper.constants import CompressionTest, EstimatedConstants
from palpate.paper.figures import Picture, drawn
from palpate.paper.motion import Method
from palpate.paper.published import PAPER_ALL_PROBES, PAPER_COMPRESSION_MODULUS, PAPER_PROBES
from palpate.paper.result_table import Cell, ResultTable
from palpate.paper.tables import PAPER
from palpate.records import Constant

_KPA = 1e-3
_NAMES = ("poisson_ratio", "shear_modulus", "young_modulus")


def constants_table(found: EstimatedConstants, title: str) -> ResultTable:
    """Constants of each probing alone and of all, with 95 % intervals.

    Parameters
    ----------
    found : EstimatedConstants
    title : str
    """
    estimate = found.result.estimate
    rows: list[tuple[Cell, ...]] = [(one.name, *_cells(one)) for one in estimate.probes]
    rows.append(("all", *_cells(estimate)))
    columns = ["probing"]
    for symbol in ("nu", "G", "E"):
        unit = "" if symbol == "nu" else " (kPa)"
        columns += [f"{symbol}{unit}", "from", "to"]
    decimals = (0, 4, 4, 4, 2, 2, 2, 2, 2, 2)
    return ResultTable(title, tuple(columns), decimals, tuple(rows))


def constants_summary(
    found: Mapping[Method, EstimatedConstants], truth: Material, test: CompressionTest
) -> ResultTable:
    """Spread over single probings, the joint estimate, and its error.

    The paper's error of E is against its compression test, ours against the truth.

    Parameters
    ----------
    found : mapping of method to EstimatedConstants
    truth : Material
    test : CompressionTest
    """
    own = [(row.poisson_ratio, row.shear_modulus) for row in PAPER_PROBES]
    rows: list[tuple[Cell, ...]] = [
        _summary(PAPER, np.array(own), PAPER_ALL_PROBES.poisson_ratio, None,
                 PAPER_ALL_PROBES.young_modulus / PAPER_COMPRESSION_MODULUS - 1.0, None, None),
    ]  # fmt: skip
    for method, one in found.items():
        estimate = one.result.estimate
        single = np.array([(p.poisson_ratio.value, p.shear_modulus.value) for p in estimate.probes])
        nu, young = estimate.poisson_ratio, estimate.young_modulus
        rows.append(
            _summary(method, single, nu.value, nu.value - truth.poisson_ratio,
                     young.value / truth.young_modulus - 1.0,
                     _holds(nu, truth.poisson_ratio), _holds(young, truth.young_modulus))
        )  # fmt: skip
    title = (
        f"Table 3: truth nu {truth.poisson_ratio:g}, E {_KPA * truth.young_modulus:g} kPa;"
        f" compression test of a cylinder {_KPA * test.young_modulus:.2f} kPa"
    )
    columns = (
        "source", "single", "nu from", "nu to", "sd nu", "sd G (%)", "all: nu", "nu off",
        "E off (%)", "nu in 95 %", "E in 95 %",
    )  # fmt: skip
    return ResultTable(title, columns, (0, 0, 3, 3, 4, 2, 4, 4, 2, 0, 0), tuple(rows))


def constants_picture(found: EstimatedConstants) -> Picture:
    """Constants of each probing with intervals, the joint ones as a band.

    Parameters
    ----------
    found : EstimatedConstants
    """
    with mpl.rc_context(STYLE):
        return drawn(probings_figure(found.result.estimate))


def motion_picture(found: EstimatedConstants, name: str) -> Picture:
    """Figure 4: measured and simulated displacement of a probing on the specimen.

    Parameters
    ----------
    found : EstimatedConstants
    name : str                      of the probing

    Raises
    ------
    InputError                      nothing was measured in it
    """
    (probing,) = (one for one in found.session.probings if one.name == name)
    (fit,) = (one for one in found.result.probes if one.name == name)
    with mpl.rc_context(STYLE):
        figure = displacement_figure(found.session.mesh, probing, fit)
        if figure is None:
            raise InputError(f"probing '{name}' cannot be drawn: nothing was measured in it")
        return drawn(figure)


def _cells(estimate: object) -> tuple[float, ...]:
    """Value and interval of each constant."""
    cells: list[float] = []
    for name in _NAMES:
        constant: Constant = getattr(estimate, name)
        factor = 1.0 if name == "poisson_ratio" else _KPA
        cells += [factor * value for value in (constant.value, *constant.ci95)]
    return tuple(cells)


def _summary(
    source: str, single: np.ndarray, nu: float, nu_error: float | None, young_error: float,
    nu_held: str | None, young_held: str | None,
) -> tuple[Cell, ...]:  # fmt: skip
    ratio, shear = single.T
    return (
        source, len(single), float(ratio.min()), float(ratio.max()), float(ratio.std(ddof=1)),
        float(100 * shear.std(ddof=1) / shear.mean()), nu, nu_error, 100 * young_error, nu_held,
        young_held,
    )  # fmt: skip


def _holds(constant: Constant, truth: float) -> str:
    """Whether the interval holds the truth."""
    low, high = constant.ci95
    return "yes" if low <= truth <= high else "no"
