"""Configurations of the virtual facility from files: `palpate-lab/1`, in TOML."""

from importlib.resources import files
from pathlib import Path

import numpy as np

from palpate.errors import InputError
from palpate.geometry import read_mesh, triangle_areas
from palpate.lab.bodies import SHAPES
from palpate.lab.config import (
    Arm,
    Calibration,
    ForceSensor,
    Head,
    LabConfig,
    Look,
    Material,
    Pictures,
    PositionSensor,
    Probe,
    Specimen,
    Stage,
)
from palpate.lab.config_table import settings_from_table
from palpate.records import TomlTable, read_support, read_toml

LAB_FORMAT = "palpate-lab/1"
_PLAIN = ("name", "seed")
_TABLES = (
    "specimen", "material", "support", "look", "arm", "force_sensor", "position_sensor", "probe",
    "stage", "head", "calibration", "pictures",
)  # fmt: skip


def read_lab_config(path: Path | str) -> LabConfig:
    """Read a configuration of the facility.

    Parameters
    ----------
    path : path                     a TOML file; files that it names are beside it

    Returns
    -------
    LabConfig

    Raises
    ------
    RecordError                     not readable, unknown or missing keys, values out of range; the
                                    text names file, table and key
    MeshError                       a mesh that is no closed surface
    """
    root = read_toml(Path(path))
    root.check_keys(("format", *_PLAIN, *_TABLES))
    if root.text("format") != LAB_FORMAT:
        root.fail("format", f"is '{root.text('format')}'; must be '{LAB_FORMAT}'")

    def part(key: str, kind: type) -> object:
        """Settings of a table that may be left out."""
        values = root.values.get(key, {})
        if not isinstance(values, dict):
            root.fail(key, "must be a table")
        return settings_from_table(TomlTable(root.file, f"[{key}]", values), kind)

    probes = root.tables("probe", "[[probe]]") if "probe" in root.values else ()
    kinds = {
        "material": Material, "look": Look, "arm": Arm, "force_sensor": ForceSensor,
        "position_sensor": PositionSensor, "head": Head, "calibration": Calibration,
        "pictures": Pictures,
    }  # fmt: skip
    plain = {"seed": 1, **{key: root.values[key] for key in _PLAIN if key in root.values}}
    return settings_from_table(
        TomlTable(root.file, "", plain),
        LabConfig,
        specimen=_specimen(root),
        probes=tuple(settings_from_table(one, Probe) for one in probes),
        stage=part("stage", Stage) if "stage" in root.values else None,
        **{key: part(key, kind) for key, kind in kinds.items()},
    )


def _specimen(root: TomlTable) -> Specimen:
    """The object of [specimen] and [support]."""
    table = root.table("specimen", "[specimen]")
    if "mesh" in table.values:
        table.check_keys(("mesh", "element"))
        mesh = body = read_mesh(table.existing_file("mesh"))
        edge = float(np.sqrt(np.median(triangle_areas(mesh)) * 4.0 / np.sqrt(3.0)))
    else:
        shape = SHAPES[table.choice("shape", tuple(SHAPES))]
        table.check_keys(("shape", *shape.lengths, "edge", "element"))
        edge = table.number("edge")
        lengths = {name: table.number(name) for name in shape.lengths}
        try:
            mesh = shape.make(edge=edge, **lengths)
        except InputError as error:
            table.fail("", str(error))
        body = shape.make(edge=edge / _ROUNDER, **lengths)
    element = table.number("element") if "element" in table.values else edge
    if not element > 0.0:
        table.fail("element", f"is {element:g} m; must be positive")
    support = dict(root.values.get("support", {"plane": _BASE}))
    held = read_support(TomlTable(root.file, "[support]", support), body, metres_per_unit=1.0)
    return Specimen(mesh, body, held, support, element)


# Chords cut off a round body by the square of their length: a ninth of what the mesh loses.
_ROUNDER = 3.0
# The facility's own specimens stand on this plane.
_BASE = {"point": [0, 0, 0], "normal": [0, 0, 1], "tolerance": 1e-9}


def built_in() -> dict[str, Path]:
    """Configurations that come with the program, by name."""
    folder = Path(str(files("palpate.lab"))) / "configs"
    return {file.stem: file for file in sorted(folder.glob("*.toml"))}
