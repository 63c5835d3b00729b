"""A result for a paper: the paragraph on methods, and tables as LaTeX and CSV."""

from pathlib import Path

import numpy as np

from palpate.errors import counted
from palpate.geometry import TriangleMesh, triangle_areas
from palpate.pipeline import FittedSurface, read_fitted_surface
from palpate.records import (
    CONSTANT_NAMES,
    Estimate,
    TomlTable,
    budget_text,
    constant_row,
    read_estimate,
    spreadsheet_text,
    verdict_text,
    write_text,
)

_SYMBOLS = {"shear_modulus": "$G$", "poisson_ratio": r"$\nu$", "young_modulus": "$E$"}


def write_for_paper(folder: Path, result: Path) -> None:
    """Write methods.txt, constants.tex, constants.csv and probings.csv of a result.

    Parameters
    ----------
    folder : Path                   an existing folder
    result : Path                   result folder of `palpate fit`

    Raises
    ------
    RecordError                     a file of the result is missing, cannot be read, or does not
                                    say what the text needs
    """
    file = result / "estimate.json"
    estimate, surface = read_estimate(file), read_fitted_surface(result)
    settings = TomlTable(file, "[settings]", dict(estimate.settings))
    if not {"errors", "noise"} <= estimate.settings.keys():
        settings.fail("", "do not say the errors or the noise, as of an earlier version; fit again")
    write_text(folder / "methods.txt", _methods(estimate, surface, settings))
    write_text(folder / "constants.tex", _latex(estimate))
    rows = []
    for name in CONSTANT_NAMES:
        constant = getattr(estimate, name)
        unit, known = "1" if name == "poisson_ratio" else "Pa", estimate.identifiable[name]
        value = (constant.value, constant.std) if known else (None, None)
        rows.append((name, *value, *constant.ci95, unit, known))
    head = ("constant", "value", "std", "ci95_low", "ci95_high", "unit", "determined")
    write_text(folder / "constants.csv", _csv(head, rows))
    write_text(folder / "probings.csv", _probings(estimate, surface))


def _methods(estimate: Estimate, surface: FittedSurface, settings: TomlTable) -> str:
    """What was measured, with what model, how it was fitted, what came out, a paragraph each."""
    areas = triangle_areas(TriangleMesh(surface.vertices, surface.triangles))
    held = 100.0 * areas[surface.held].sum() / areas.sum()
    force = [float(np.linalg.norm(probing.force)) for probing in surface.probings]
    points, outliers = (
        sum(getattr(probe, name) for probe in estimate.probes) for name in ("observed", "rejected")
    )
    kind = "homogeneous"
    if estimate.field is not None or estimate.regions:
        kind = "inhomogeneous" + (", of one modulus in every region" if estimate.regions else "")
    strain = "at small strain"
    if estimate.settings.get("finite_strain"):
        law = "a neo-Hookean solid" if estimate.stiffening is None else "a solid of Yeoh's law"
        strain = f"corrected for finite strain by finite elements of {law}"
    sources = [
        f" Standard deviations of {symbol} come from: {text}."
        for name, symbol in (("young_modulus", "E"), ("poisson_ratio", "nu"))
        if (text := budget_text(estimate.budget, name))
    ]
    # Of a result that Python wrote nothing is known of the program.
    version = estimate.settings.get("versions", {}).get("palpate", "")
    return (
        f"{surface.name}\n\n"
        f"The elastic constants were estimated with {f'Palpate {version}'.strip()} from"
        f" {counted(len(force), 'probing')} with forces of {min(force):.3g} to {max(force):.3g} N,"
        f" in which the displacement of {points} points on the surface was measured. The object was"
        f" taken as {kind}, isotropic and linearly elastic, {strain}, and modelled by boundary"
        f" elements on a closed surface of {len(surface.vertices)} vertices, {held:.2g} % of which"
        " was held.\n\n"
        f"{_fitted_together(settings)} {outliers} outliers were excluded. Intervals hold the noise,"
        " these errors, the scatter between probings and the error of the mesh.\n\n"
        f"{verdict_text(estimate)}{''.join(sources)}\n"
    )


def _fitted_together(settings: TomlTable) -> str:
    """The errors that points and probings share, with their priors, and the noise."""
    std = settings.table("errors", f"{settings.name} errors").number
    turn = np.rad2deg(std("pose_rotation"))
    priors = (
        f"gain of the force sensor {100.0 * std('force_gain'):.2g} %",
        f"contact points {1e3 * std('contact_point'):.2g} mm",
        f"pose {1e3 * std('pose_translation'):.2g} mm, {turn:.2g} degrees",
        f"lengths {100.0 * std('length_scale'):.2g} %",
    )
    return (
        "Shear modulus and Poisson's ratio were fitted together with the errors that points and"
        f" probings share, which had priors (1 sigma): {', '.join(priors)}. The size of the noise"
        f" ({settings.text('noise')}) was estimated from the residuals;"
    )


def _latex(estimate: Estimate) -> str:
    """The constants as a tabular."""
    lines = [
        r"\begin{tabular}{lccc}",
        r"\hline",
        r" & value & 95\,\% interval & unit \\",
        r"\hline",
    ]
    for name, symbol in _SYMBOLS.items():
        value, interval, unit = constant_row(estimate, name)
        value = value.replace("±", r"$\pm$")
        interval = interval.replace(" to ", "--")
        lines.append(rf"{symbol} & {value} & {interval} & {unit or '--'} \\")
    return "\n".join([*lines, r"\hline", r"\end{tabular}", ""])


def _probings(estimate: Estimate, surface: FittedSurface) -> str:
    """Each probing alone, in SI units."""
    head = (
        "probing", "force_N", "points", "missing", "outliers", "rms_residual_m",
        "prediction_error_m", "prediction_score", "prediction_within", *CONSTANT_NAMES,
    )  # fmt: skip
    forces = {probing.name: float(np.linalg.norm(probing.force)) for probing in surface.probings}
    rows = [
        (
            probe.name, forces.get(probe.name), probe.observed, probe.missing, probe.rejected,
            probe.rms_residual, probe.prediction_error, probe.prediction_score,
            probe.prediction_within,
            *(
                getattr(probe, name).value
                if probe.identifiable.get(name, estimate.identifiable[name]) else None
                for name in CONSTANT_NAMES
            ),
        )
        for probe in estimate.probes
    ]  # fmt: skip
    return _csv(head, rows)


def _csv(head: tuple[str, ...], rows: list[tuple[object, ...]]) -> str:
    """A table with headings; numbers to nine digits, what is not known left empty."""
    cells = [[_number(x) if isinstance(x, float) else x for x in row] for row in rows]
    return spreadsheet_text([head, *cells])


def _number(value: float) -> str | None:
    return f"{value:.9g}" if np.isfinite(value) else None
