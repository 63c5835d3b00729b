"""Tables of an estimate for the terminal."""

from math import isfinite

from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from palpate.records import (
    CONSTANT_NAMES,
    Estimate,
    constant_text,
    interval_text,
    modulus_unit,
    value_text,
)

_LABELS = {
    "shear_modulus": "shear modulus G",
    "poisson_ratio": "Poisson's ratio nu",
    "young_modulus": "Young's modulus E",
}


def constants_table(estimate: Estimate) -> Table:
    """The three constants with their intervals, and whether the data tell them."""
    table = Table(title="Elastic constants", box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("constant", no_wrap=True)
    for heading in ("value ± 1 sigma", "95 % interval"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("unit")
    table.add_column("told?")
    for name in CONSTANT_NAMES:
        constant = getattr(estimate, name)
        factor, unit = (1.0, "-") if name == "poisson_ratio" else modulus_unit(constant.value)
        table.add_row(
            _LABELS[name],
            constant_text(constant, factor=factor),
            interval_text(constant, factor=factor),
            unit,
            "yes" if estimate.identifiable[name] else "no",
        )
    return table


def probes_table(estimate: Estimate) -> Table:
    """Each probing alone: its constants, what was used of it, how well it was explained."""
    factor, unit = modulus_unit(estimate.young_modulus.value)
    table = Table(
        title=f"Each probing alone (moduli in {unit}, residuals in mm)",
        box=SIMPLE_HEAD,
        padding=(0, 1, 0, 0),
        pad_edge=False,
    )
    table.add_column("probing", no_wrap=True, min_width=4)
    for heading in ("nu", "G", "E", "seen", "nan", "off", "rms", "left out"):
        table.add_column(heading, justify="right", no_wrap=True)
    for probe in estimate.probes:
        table.add_row(
            escape(probe.name),
            constant_text(probe.poisson_ratio),
            value_text(probe.shear_modulus, factor=factor),
            constant_text(probe.young_modulus, factor=factor),
            str(probe.observed),
            str(probe.missing),
            str(probe.rejected),
            _millimetres(probe.rms_residual),
            _millimetres(probe.prediction_error),
        )
    table.caption = (
        "seen: points; nan: of them not measured; off: outliers left aside; rms: residual of the"
        " joint estimate; left out: residual of the prediction from the other probings"
    )
    return table


def _millimetres(metres: float | None) -> str:
    """A residual, or a dash where there is none."""
    return "-" if metres is None or not isfinite(metres) else f"{1e3 * metres:.3g}"
