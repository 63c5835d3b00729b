"""`palpate compression`: Young's modulus of cylinders pressed between plates."""

import math
import re
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from cyclopts import Parameter
from rich.table import Table

from palpate.app.tables import terminal_table
from palpate.app.terminal import print_file_notes, print_tables
from palpate.errors import InputError
from palpate.figures import compression_figure, save_figure
from palpate.probe import (
    CompressionRecord,
    CompressionResult,
    compression_series,
    compression_test,
    metres_from_text,
    read_compression,
)
from palpate.records import (
    Constant,
    check_free,
    constant_text,
    copied_rows,
    file_sums,
    interval_text,
    json_text,
    modulus_unit,
    write_text,
)

# Sizes that differ by less are one, rounded.
_SAME_SIZE = 0.01


def compression(
    files: Annotated[list[Path], Parameter(consume_multiple=True)],
    /,
    *,
    diameter: str | None = None,
    height: str | None = None,
    strain: str = "0..10%",
    preload: float | None = None,
    displacement_unit: str | None = None,
    force_unit: str | None = None,
    displacement_column: str | None = None,
    force_column: str | None = None,
    group: Annotated[list[str] | None, Parameter(consume_multiple=True)] = None,
    plot: Path | None = None,
    out: Path | None = None,
    force: bool = False,
) -> int:
    """Young's modulus E = F l / (A delta) of one or more cylinders pressed between plates.

    Several files give the mean over the specimens and their spread.

    Parameters
    ----------
    files
        Records of testing machines, or two columns: displacement (mm) and force (N).
    diameter
        Diameter of the cylinder with its unit, like 50mm; default: what the file says.
    height
        Height of the cylinder before loading, with its unit; default: what the file says.
    strain
        Range of strain over which to fit the straight line: 0..10% or 0..0.1, of the height.
    preload
        Force [N] above which the plates count as in contact.
    displacement_unit
        um, mm, cm, m or in; default: what the file says, else mm.
    force_unit
        mN, N, kN, gf, kgf or lbf; default: what the file says, else N.
    displacement_column
        Name of the column, or a part of it; default: compression, displacement, extension, ...
    force_column
        Name of the column, or a part of it; default: load or force.
    group
        Specimens, each by a part of the names of its files; default: every file is a specimen.
    plot
        Picture of the curves and their lines: .png.
    out
        JSON file for the result.
    force
        Replace files of these names.
    """
    strain_range = _strain_range(strain)
    if out is not None and any(out.exists() and out.samefile(f) for f in files if f.exists()):
        raise InputError(f"{out}: --out names one of the records; give the result its own name")
    specimens = _specimens(files, group)
    for target in filter(None, (plot, out)):
        check_free(target, force=force)
    records: list[CompressionRecord] = []
    results: list[CompressionResult] = []
    earlier: list[tuple[Path, set[bytes]]] = []
    notes: list[tuple[str, str]] = []
    for file in files:
        record = read_compression(
            file,
            displacement_unit=displacement_unit,
            force_unit=force_unit,
            displacement_column=displacement_column,
            force_column=force_column,
        )
        earlier.append((file, _checked_rows(record, earlier)))
        result = compression_test(
            record.displacement,
            record.force,
            diameter=_size(diameter, "diameter", record, record.diameter),
            height=_size(height, "height", record, record.height),
            strain_range=strain_range,
            preload=preload,
            source=str(file),
        )
        records.append(record)
        results.append(result)
        notes += [(file.name, note) for note in (*record.notes, *result.notes)]
    if out is not None:
        content = _content(results, specimens) | {"inputs": file_sums(files, start=out.parent)}
        write_text(out, json_text(content))
    if plot is not None:
        save_figure(compression_figure(records, results), plot)
    print_tables(_table(results, specimens))
    print_file_notes(notes, files=len(files))
    return 0


def _specimens(files: Sequence[Path], groups: Sequence[str] | None) -> list[str]:
    """The specimen that each file is a test of."""
    if groups is None:
        return [str(file) for file in files]
    specimens = []
    for file in files:
        matching = [name for name in groups if name in file.name]
        if len(matching) != 1:
            raise InputError(
                f"{file}: its name holds {len(matching)} of --group {' '.join(groups)}; must"
                " hold one"
            )
        specimens += matching
    return specimens


def _checked_rows(
    record: CompressionRecord, earlier: Sequence[tuple[Path, set[bytes]]]
) -> set[bytes]:
    """Readings of a record, one entry each; refused where they are a copy of an earlier one's."""
    readings = np.stack([record.displacement, record.force], axis=1)
    rows = {row.tobytes() for row in readings if row.any()}
    for file, others in earlier:
        if shared := copied_rows(rows, others):
            raise InputError(
                f"{record.source}: holds the same readings as {file}, {shared} of {len(rows)}; a"
                " specimen that counts twice makes the mean look surer than it is: name each"
                " record once"
            )
    return rows


def _size(given: str | None, name: str, record: CompressionRecord, recorded: float | None) -> float:
    """A size of the cylinder from the command line, else from the file."""
    if given is None:
        if recorded is None:
            raise InputError(
                f"{record.source}: does not say the {name}; give it, e.g. --{name} 50mm"
            )
        return recorded
    requested = metres_from_text(given, name=f"--{name}")
    if recorded is not None and abs(requested - recorded) > _SAME_SIZE * recorded:
        raise InputError(
            f"{record.source}: says that the {name} is {1e3 * recorded:g} mm, and --{name} that it"
            f" is {1e3 * requested:g} mm; leave the option out, or correct the file"
        )
    return requested


def _strain_range(text: str) -> tuple[float, float]:
    """Both ends of `0..10%`, `0%..10%` or `0..0.1` as fractions of the height."""
    match = re.fullmatch(r"\s*([\d.]+?)\s*(%?)\s*\.\.\s*([\d.]+)\s*(%?)\s*", text)
    try:
        low, high = (float(match[1]), float(match[3])) if match else (math.nan, math.nan)
    except ValueError:
        low = high = math.nan
    if match is None or math.isnan(low) or (match[2] and not match[4]):
        raise InputError(f'--strain is "{text}"; write both ends, like 0..10% or 0.02..0.1')
    return (low / 100.0, high / 100.0) if match[4] else (low, high)


def _content(results: list[CompressionResult], specimens: list[str]) -> dict[str, Any]:
    """The series and each test, moduli in Pa."""
    series = compression_series(results, specimens)
    return {
        "format": "palpate-compression/1",
        "young_modulus": {
            "value": series.young_modulus,
            "spread": None if math.isnan(series.spread) else series.spread,
            "ci95": list(series.ci95),
        },
        "specimens": [asdict(result) for result in results],
    }


def _table(results: list[CompressionResult], specimens: list[str]) -> Table:
    """One line per test, and the mean of the specimens where there are several tests."""
    series = compression_series(results, specimens)
    factor, unit = modulus_unit(series.young_modulus)
    lines = [
        (
            Path(result.source).name,
            Constant(result.young_modulus, result.std, result.ci95),
            str(result.readings),
            f"{100.0 * result.nonlinearity:.1f}",
        )
        for result in results
    ]
    if len(results) > 1:
        mean = Constant(series.young_modulus, series.spread, series.ci95)
        lines.append((f"mean and spread of {len(set(specimens))}", mean, "", ""))
    columns = (f"E ± 1 sigma ({unit})", f"95 % interval ({unit})", "readings", "off the line %")
    rows = [
        (name, constant_text(young, factor=factor), interval_text(young, factor=factor), *rest)
        for name, young, *rest in lines
    ]
    return terminal_table("Compression tests", ("file", *columns), rows, total=len(results) > 1)
