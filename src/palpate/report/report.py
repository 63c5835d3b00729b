"""Report of a result folder: its files combined in one page."""

import base64
import io
import math
import time
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from PIL import Image

from palpate.disk import write_bytes
from palpate.estimation import FitResult
from palpate.figures import write_plots
from palpate.files import read_bytes
from palpate.pipeline import (
    FittedSurface,
    read_fitted_surface,
    write_fitted_surface,
    write_residuals,
)
from palpate.records import Estimate, Session, file_stems, read_estimate, read_text, write_estimate
from palpate.report.content import (
    budget_rows,
    constant_rows,
    error_rows,
    input_rows,
    prediction_rows,
    probing_rows,
    rejection_rows,
    second_rows,
    setting_rows,
    unit_of_moduli,
    verdict,
)
from palpate.report.scene import scene

_TEMPLATES = resources.files("palpate.report") / "templates"
# Figures that a report shows, with their captions.
_DRAWINGS = {
    "likelihood": "Pairs of Poisson's ratio and shear modulus that the data allow",
    "probings": "The constants as each probing alone gives them",
    "predictions": "Displacements predicted by the other probings against measured ones",
    "reciprocity": "Work of every two pushes in each other's motion: equal, whatever the material",
    "errors": "What the data say about the assumed errors",
    "budget": "What each source adds to the standard deviations of the constants",
}
# Size limit of the probings' pictures [bytes of base64], and their quality (WebP).
_MOST_BYTES, _QUALITY = 1_800_000, 82


def write_report(folder: Path, target: Path) -> None:
    """Write the report of a result.

    Parameters
    ----------
    folder : Path                   result folder of `palpate fit`
    target : Path                   the page; an existing file is replaced

    Raises
    ------
    RecordError                     a file of the result is missing or cannot be read, or the page
                                    cannot be written
    """
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
        "verdict": verdict(estimate),
        "constants": constant_rows(estimate),
        "probings": probing_rows(estimate),
        "predictions": prediction_rows(estimate, surface),
        "errors": error_rows(estimate),
        "budget": budget_rows(estimate),
        "rejected": rejection_rows(estimate),
        "reciprocity": "" if estimate.reciprocity is None else estimate.reciprocity.text,
        "notes": (*estimate.notes, *estimate.details),
        "seconds": second_rows(estimate),
        "settings": setting_rows(estimate),
        "inputs": input_rows(folder),
        "log": read_text(folder / "log.txt") if (folder / "log.txt").is_file() else "",
        "drawings": {name: _drawing(folder / f"{name}.svg") for name in _DRAWINGS},
        "drawn": _DRAWINGS,
        "pictures": pictures,
        "missing": missing,
        "scene": shown,
        "shown": [one["name"] for one in shown["probings"]],
        "left_out": shown["left_out"],
        "unit": unit_of_moduli(estimate),
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
    found: dict[str, str] = {}
    size = 0
    every = (folder / "displacement").glob("*.png")
    files = sorted(every, key=lambda file: (order.get(file.stem, math.inf), file.name))
    for number, file in enumerate(files):
        packed = io.BytesIO()
        with Image.open(io.BytesIO(read_bytes(file))) as picture:
            picture.convert("RGB").save(packed, "WEBP", quality=_QUALITY, method=4)
        text = base64.b64encode(packed.getvalue()).decode()
        size += len(text)
        if size > _MOST_BYTES:
            return found, len(files) - number
        found[file.stem] = "data:image/webp;base64," + text
    return found, 0


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
    write_residuals(folder, session, result)
    write_fitted_surface(folder, session, result)
    write_plots(folder, session, result)
    seconds = dict(result.estimate.seconds)
    drawing = time.perf_counter() - start
    total = seconds.pop("total", 0.0) + drawing
    seconds |= {"drawing": drawing, "total": total}
    estimate = replace(result.estimate, seconds=seconds)
    write_estimate(folder / "estimate.json", estimate)
    return estimate
