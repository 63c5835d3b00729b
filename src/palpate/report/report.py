"""Report of a result folder: its files combined in one page."""

import base64
import io
import math
import re
import time
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from palpate.disk import write_bytes
from palpate.errors import InputError
from palpate.estimation import FitResult
from palpate.figures import write_plots
from palpate.files import read_bytes, read_errors
from palpate.pipeline import (
    FittedSurface,
    pooled,
    read_fitted_surface,
    write_fitted_surface,
    write_modulus,
    write_relaxation,
    write_residuals,
)
from palpate.records import (
    ErrorEstimate,
    Estimate,
    ProbeEstimate,
    Session,
    Status,
    constant_row,
    constant_text,
    error_texts,
    file_stems,
    law_rows,
    modulus_unit,
    read_estimate,
    read_text,
    region_row,
    relaxation_rows,
    verdict_text,
    without_pictures,
    write_estimate,
)
from palpate.report.scene import scene
from palpate.shapes import Points

_TEMPLATES = resources.files("palpate.report") / "templates"
# Figures that a report shows, with their captions.
_DRAWINGS = {
    "likelihood": "Pairs of Poisson's ratio and shear modulus that the data allow",
    "probings": "The constants as each probing alone gives them",
    "predictions": "Displacements predicted by the other probings against measured ones",
    "reciprocity": "Work of every two pushes in each other's motion: equal, whatever the material",
    "creep": "Force and motion over time; the modulus over time, with its 95 % interval",
    "modulus": "Modulus inside the body: half way to that of a part, and in three sections",
    "errors": "What the data say about the assumed errors",
    "budget": "What each source adds to the standard deviations of the constants",
}
# Size limit of the probings' pictures [bytes of base64], and their quality (WebP).
_MOST_BYTES, _QUALITY = 1_800_000, 82
_LABELS = {
    "young_modulus": ("Young's modulus", "E"),
    "shear_modulus": ("Shear modulus", "G"),
    "poisson_ratio": ("Poisson's ratio", "\N{GREEK SMALL LETTER NU}"),
}
_WORDS = {
    Status.OK: "Determined",
    Status.HETEROGENEOUS: "Not the same everywhere",
    Status.MODEL_CONTRADICTED: "Not to be trusted",
    Status.NOT_CONVERGED: "No estimate",
    Status.NOTHING_IDENTIFIABLE: "Not determined",
}
# Settings of an estimate that the report shows elsewhere.
_ELSEWHERE = ("versions", "command")
_STAGES = {
    "loading": "loading the program",
    "reading_and_motion": "reading, and motion in the pictures",
    "given_mesh": "model of the given mesh",
    "assembly": "integrals over the graded mesh",
    "factorisation": "factorisation and reduced model",
    "fit": "search and intervals",
    "drawing": "tables and pictures",
    "total": "total",
}


def write_report(folder: Path, target: Path) -> None:
    """Write the report of a result.

    Parameters
    ----------
    folder : Path                   result folder of `palpate fit`
    target : Path                   the page; an existing file is replaced

    Raises
    ------
    InputError                      a name that does not end in .html
    RecordError                     a file of the result is missing or cannot be read, or the page
                                    cannot be written
    """
    if target.suffix.lower() not in (".html", ".htm"):
        raise InputError(f"{target}: a report is an HTML file; its name must end in .html")
    estimate = read_estimate(folder / "estimate.json")
    surface = read_fitted_surface(folder)
    environment = Environment(
        loader=PackageLoader("palpate.report"), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    # Of `tojson`, which leaves no character in the text that could end or change a script.
    environment.policies["json.dumps_kwargs"] = {"separators": (",", ":")}
    page = environment.get_template("page.html").render(_content(folder, estimate, surface))
    write_bytes(target, page.encode())


def _content(folder: Path, estimate: Estimate, surface: FittedSurface) -> dict[str, Any]:
    """All variables of the page's template."""
    shown = scene(surface)
    pictures, missing = _pictures(folder, [probing.name for probing in surface.probings])
    return {
        "name": surface.name,
        "verdict": _verdict(estimate),
        "constants": _constant_rows(estimate),
        "probings": _probing_rows(estimate),
        "predictions": _prediction_rows(estimate, surface),
        "errors": _error_rows(estimate),
        "budget": _budget_rows(estimate),
        "rejected": _rejection_rows(estimate),
        "reciprocity": "" if estimate.reciprocity is None else estimate.reciprocity.text,
        "field": estimate.field,
        "regions": [region_row(region) for region in estimate.regions],
        "relaxation": _relaxation(estimate),
        "notes": [_with_greek(note) for note in (*estimate.notes, *estimate.details)],
        "seconds": _second_rows(estimate),
        "settings": _setting_rows(estimate),
        "inputs": _input_rows(folder),
        "log": read_text(folder / "log.txt") if (folder / "log.txt").is_file() else "",
        "drawings": {name: _drawing(folder / f"{name}.svg") for name in _DRAWINGS},
        "drawn": _DRAWINGS,
        "pictures": pictures,
        "missing": missing,
        "scene": shown,
        "shown": [probing["name"] for probing in shown["probings"]],
        "left_out": shown["left_out"],
        "unit": _unit_of_moduli(estimate),
        "style": _style(shown["colours"]),
        "script": (_TEMPLATES / "viewer.js").read_text(encoding="utf-8"),
    }


def _style(colours: list[str]) -> str:
    """The style sheet, with the bands of the colour bar filled in."""
    text = (_TEMPLATES / "style.css").read_text(encoding="utf-8")
    share = 100 / len(colours)
    bands = (f"{c} {share * k:g}% {share * (k + 1):g}%" for k, c in enumerate(colours))
    return text.replace("{{ bands }}", ", ".join(bands))


def _drawing(path: Path) -> str:
    """An SVG figure as a data URL; empty if it is missing."""
    if not path.is_file():
        return ""
    return "data:image/svg+xml;base64," + base64.b64encode(read_bytes(path)).decode()


def _pictures(folder: Path, names: list[str]) -> tuple[dict[str, str], int]:
    """Pictures of the probings as data URLs, in the order of `names`, and the number of those left
    out for lack of room."""
    order = {stem: k for k, stem in enumerate(file_stems(names, kind="probing"))}
    pictures: dict[str, str] = {}
    size = 0
    every = (folder / "displacement").glob("*.png")
    files = sorted(every, key=lambda file: (order.get(file.stem, math.inf), file.name))
    for number, file in enumerate(files):
        packed = io.BytesIO()
        content = io.BytesIO(read_bytes(file))
        with (
            read_errors(file, "fit the session again", what="is no whole picture"),
            Image.open(content) as picture,
        ):
            picture.convert("RGB").save(packed, "WEBP", quality=_QUALITY, method=4)
        text = base64.b64encode(packed.getvalue()).decode()
        size += len(text)
        if size > _MOST_BYTES:
            return pictures, len(files) - number
        pictures[file.stem] = "data:image/webp;base64," + text
    return pictures, 0


def write_result_files(folder: Path, session: Session, result: FitResult) -> Estimate:
    """Write all files that a report is made from: estimate.json, residuals, surface.npz, pictures.

    Parameters
    ----------
    folder : Path                   result folder
    session : Session               the fitted session
    result : FitResult

    Returns
    -------
    Estimate                        as written, with the time for drawing added to its seconds

    Raises
    ------
    OSError, RecordError            a file cannot be written
    """
    start = time.perf_counter()
    if without_pictures(session):
        session = pooled(session)
    write_residuals(folder, session, result)
    write_fitted_surface(folder, session, result)
    write_plots(folder, session, result)
    if result.map is not None:
        write_modulus(folder / "modulus.npz", result.map)
    if result.estimate.relaxation is not None:
        write_relaxation(folder / "relaxation.csv", result.estimate.relaxation)
    seconds = dict(result.estimate.seconds)
    drawing = time.perf_counter() - start
    total = seconds.pop("total", 0.0) + drawing
    seconds |= {"drawing": drawing, "total": total}
    estimate = replace(result.estimate, seconds=seconds)
    write_estimate(folder / "estimate.json", estimate)
    return estimate


def _relaxation(estimate: Estimate) -> dict[str, Any] | None:
    """The modulus over time: rows of its table, and what is said of it."""
    relaxation = estimate.relaxation
    if relaxation is None:
        return None
    remarks = [_with_greek(remark) for remark in relaxation.remarks]
    return {"rows": relaxation_rows(relaxation), "age": f"{relaxation.age:.3g}", "remarks": remarks}


def _with_greek(text: str) -> str:
    """Poisson's ratio by the letter that the figures have, too."""
    return re.sub(r"\bnu\b", "\N{GREEK SMALL LETTER NU}", text)


def _verdict(estimate: Estimate) -> dict[str, Any]:
    """The head of a report: a word, a sentence, what to do, and whether all is determined."""
    status = estimate.status
    cure = _with_greek(status.cure)
    # No line break between a number and its unit.
    sentence = re.sub(r"(?<=\d) (?=[kMG]?Pa\b)", "\N{NO-BREAK SPACE}", verdict_text(estimate))
    return {
        "word": _WORDS.get(status, "Partly determined"),
        "sentence": _with_greek(sentence),
        "cure": cure[:1].upper() + cure[1:] + "." if cure else "",
        "good": status is Status.OK,
    }


def _constant_rows(estimate: Estimate) -> list[dict[str, str]]:
    """Rows of the constants with their intervals.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of dict                    label, symbol, value, interval, unit
    """
    rows = []
    for name, (label, symbol) in _LABELS.items():
        value, interval, unit = constant_row(estimate, name)
        rows.append(
            {"label": label, "symbol": symbol, "value": value, "interval": interval, "unit": unit}
        )
    for label, value, interval, unit in law_rows(estimate):
        shown = {"value": value, "interval": interval.strip("-"), "unit": unit.strip("-")}
        rows.append({"label": label, "symbol": ""} | shown)
    return rows


def _probing_rows(estimate: Estimate) -> list[list[str]]:
    """Rows of each probing alone; moduli in the unit of the joint Young's modulus.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of list of str             name, E, G, nu, number of points, rms residual [mm]
    """
    return [
        [
            probe.name,
            *(_alone(estimate, probe, name) for name in _LABELS),
            str(probe.observed),
            _millimetres(probe.rms_residual),
        ]
        for probe in estimate.probes
    ]


def _alone(estimate: Estimate, probe: ProbeEstimate, name: str) -> str:
    factor = 1.0
    if name != "poisson_ratio":
        factor, _ = modulus_unit(estimate.young_modulus.value)
    # By default a probing alone determines no more than all together.
    if not probe.identifiable.get(name, estimate.identifiable[name]):
        return "\N{EN DASH}"
    return constant_text(getattr(probe, name), factor=factor)


def _prediction_rows(estimate: Estimate, surface: FittedSurface) -> list[list[str]]:
    """Rows of each probing's prediction from the other probings.

    Parameters
    ----------
    estimate : Estimate
    surface : FittedSurface

    Returns
    -------
    list of list of str             name, rms displacement, prediction error (with a field, and with
                                    one modulus where both were fitted) and noise [mm], errors
                                    over their standard deviation, share within 95 % [%]
    """
    rows = []
    measured = {probing.name: probing for probing in surface.probings}
    for probe in estimate.probes:
        if probe.prediction_error is None or probe.name not in measured:
            continue
        typical = _rms(measured[probe.name].displacement)
        seen = measured[probe.name]
        noise = _rms(np.where(np.isfinite(seen.displacement), seen.sigma, np.nan))
        errors = [probe.prediction_error]
        if probe.homogeneous_error is not None:
            errors.append(probe.homogeneous_error)
        rows.append(
            [
                probe.name, _millimetres(typical), *map(_millimetres, errors),
                _millimetres(noise), _number(probe.prediction_score, ".2f"),
                _number(probe.prediction_within, ".0%").rstrip("%"),
            ]
        )  # fmt: skip
    return rows


def _number(value: float | None, form: str) -> str:
    return "\N{EN DASH}" if value is None else format(value, form)


def _rms(vectors: Points) -> float:
    """Root mean square length of the finite vectors; NaN if there are none."""
    known = np.isfinite(vectors).all(axis=1)
    return float(np.sqrt((vectors[known] ** 2).sum(axis=1).mean())) if known.any() else math.nan


def _error_rows(estimate: Estimate) -> list[list[str]]:
    """Rows of the systematic errors: prior, estimate, and estimate over prior standard deviation.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of list of str             name, prior, estimate, ratio
    """
    return [_error_row(error) for error in every_error(estimate)]


def _budget_rows(estimate: Estimate) -> list[list[str]]:
    """Rows of the uncertainty budget.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of list of str             source, its contribution to the standard deviations of E [%],
                                    G [%] and nu
    """
    return [
        [
            entry.source, _part(100.0 * entry.young_modulus), _part(100.0 * entry.shear_modulus),
            _part(entry.poisson_ratio),
        ]
        for entry in estimate.budget
    ]  # fmt: skip


def _part(std: float) -> str:
    return "\N{EN DASH}" if math.isnan(std) else f"{std:.2g}"


def every_error(estimate: Estimate) -> list[ErrorEstimate]:
    """Systematic errors common to all probings, then those of single probings.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of ErrorEstimate
    """
    return [*estimate.errors, *(error for probe in estimate.probes for error in probe.errors)]


def _error_row(error: ErrorEstimate) -> list[str]:
    value, std, prior = error_texts(error)
    return [
        error.name, f"\N{PLUS-MINUS SIGN} {prior}", f"{value} \N{PLUS-MINUS SIGN} {std}",
        f"{error.value / error.prior_std:+z.1f}" if error.prior_std else "\N{EN DASH}",
    ]  # fmt: skip


def _rejection_rows(estimate: Estimate) -> list[list[str]]:
    """Rows of the points of each probing that were not measured or were rejected.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of list of str             name, all points, not measured, rejected as outliers, used
    """
    rows = []
    for probe in estimate.probes:
        every = probe.observed + probe.missing
        rows.append(
            [
                probe.name, str(every), _counted(probe.missing, every),
                _counted(probe.rejected, every), str(probe.observed - probe.rejected),
            ]
        )  # fmt: skip
    return rows


def _counted(count: int, every: int) -> str:
    return f"{count} ({100 * count / every:.0f} %)" if every else "0"


def _second_rows(estimate: Estimate) -> list[list[str]]:
    """Rows of the wall time of every stage [s].

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    list of list of str             stage, time
    """
    return [
        [_STAGES.get(name, name.replace("_", " ")), f"{seconds:.1f} s"]
        for name, seconds in estimate.seconds.items()
    ]


def _setting_rows(estimate: Estimate) -> dict[str, Any]:
    """The settings of an estimate: `command`, `versions`, and all `others` as rows.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    dict
    """
    settings = estimate.settings
    return {
        "command": settings.get("command", ""),
        "versions": list(settings.get("versions", {}).items()),
        "others": [
            [name.replace("_", " "), _setting(value)]
            for name, value in settings.items()
            if name not in _ELSEWHERE
        ],
    }


def _setting(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{key} = {_setting(item)}" for key, item in value.items()) or "none"
    if isinstance(value, (list, tuple)):
        return ", ".join(map(_setting, value)) or "none"
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _input_rows(folder: Path) -> list[list[str]]:
    """Rows of the input files of a result, with their SHA-256 checksums.

    Parameters
    ----------
    folder : Path                   of the result

    Returns
    -------
    list of list of str             file name, checksum

    Raises
    ------
    RecordError                     the list of inputs cannot be read
    """
    path = folder / "inputs.txt"
    lines = read_text(path).splitlines() if path.is_file() else []
    pairs = [line.partition("  ") for line in lines if line and not line.startswith("#")]
    return [[Path(name).name, digest] for digest, _, name in pairs]


def _unit_of_moduli(estimate: Estimate) -> str:
    """Unit of the moduli in `_probing_rows`.

    Parameters
    ----------
    estimate : Estimate

    Returns
    -------
    str                             "kPa" and the like
    """
    return modulus_unit(estimate.young_modulus.value)[1]


def _millimetres(metres: float | None) -> str:
    known = metres is not None and math.isfinite(metres)
    return f"{1e3 * metres:#.3g}".rstrip(".") if known and metres is not None else "\N{EN DASH}"
