"""Reads configurations of the virtual facility from TOML files, format `palpate-lab/1`."""

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass, replace
from importlib.resources import files
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from palpate.errors import quoted
from palpate.geometry import (
    TriangleMesh,
    bounding_diagonal,
    triangle_areas,
)
from palpate.lab.config import LabConfig, Probe, Specimen
from palpate.lab.head import make_head
from palpate.lab.render_mesh import dot_count
from palpate.lab.specimens import SHAPES
from palpate.machine import check_memory_for, usable_memory
from palpate.records import (
    STIFFNESS_UNITS,
    TomlTable,
    read_object_mesh,
    read_support,
    read_toml,
)
from palpate.shapes import Indices
from palpate.solids import Tip, body_memory, node_count

LAB_FORMAT = "palpate-lab/1"
# Keys that are not fields of `LabConfig`, or are converted before they become fields.
_APART = ("format", "specimen", "support", "probe")
# The body's surface is this many times finer than the session's mesh. The error of a faceted
# surface grows with the square of its edge, so the body has a ninth of the mesh's.
_BODY_REFINEMENT = 3.0
# Largest number of the surface's triangles.
_MOST_SQUARES = 30_000
# Smallest and largest permitted size of a specimen [m].
_SMALLEST, _LARGEST = 1e-4, 50.0
# Lengths that may not exceed the size of the specimen.
_WITHIN = (
    ("specimen", "element"), ("look", "size"), ("arm", "radius"), ("arm", "placement"),
    ("position_sensor", "noise"), ("position_sensor", "bias"), ("position_sensor", "resolution"),
    ("calibration", "translation"), ("calibration", "object_translation"),
)  # fmt: skip
_DOWN = np.array([0.0, 0.0, -1.0])
# The facility's own specimens stand on this plane.
_BASE = {"point": [0, 0, 0], "normal": [0, 0, 1], "tolerance": 1e-9}

Settings = TypeVar("Settings")


def read_lab_config(path: Path | str) -> LabConfig:
    """Read a configuration of the facility.

    Parameters
    ----------
    path : path                     a TOML file; files named in it are relative to its folder

    Returns
    -------
    LabConfig

    Raises
    ------
    RecordError                     not readable, unknown or missing keys, values out of range; the
                                    text names file, table and key
    MeshError                       a mesh that is not a closed surface
    InputError                      the optional package for the mesh's format is missing
    """
    root = read_toml(Path(path))
    known = (field.name for field in fields(LabConfig) if field.name not in ("probes", "specimen"))
    root.check_keys((*_APART, *known))
    if root.text("format") != LAB_FORMAT:
        root.fail("format", f"is '{root.text('format')}'; must be '{LAB_FORMAT}'")
    probes = root.tables("probe", "[[probe]]") if "probe" in root.values else ()
    plain = {key: value for key, value in root.values.items() if key not in _APART}
    config = _settings(
        TomlTable(root.file, "", plain),
        LabConfig,
        specimen=_specimen(root),
        probes=tuple(_settings(probe, Probe) for probe in probes),
    )
    if config.head.file is not None:
        beside = replace(config.head, file=str(root.file.parent / config.head.file))
        config = replace(config, head=beside)
    _check_sizes(root.file, config)
    return config


def built_in() -> dict[str, Path]:
    """Configurations that are distributed with the program.

    Returns
    -------
    dict of str to Path             file by name
    """
    folder = Path(str(files("palpate.lab"))) / "configs"
    return {file.stem: file for file in sorted(folder.glob("*.toml"))}


def _specimen(root: TomlTable) -> Specimen:
    """The specimen that [specimen] and [support] describe."""
    table = root.table("specimen", "[specimen]")
    if "mesh" in table.values:
        table.check_keys(("mesh", "element"))
        mesh, _ = read_object_mesh(table, 1.0)
        body = mesh
        edge = float(np.sqrt(np.median(triangle_areas(mesh)) * 4.0 / np.sqrt(3.0)))
    else:
        shape = SHAPES[table.choice("shape", tuple(SHAPES))]
        table.check_keys(("shape", *shape.lengths, "edge", "element"))
        edge = table.number("edge")
        lengths = {name: table.number(name) for name in shape.lengths}
        _check_edge(table, edge, lengths)
        with table.error_context():
            mesh = shape.make(edge=edge, **lengths)
            body = shape.make(edge=edge / _BODY_REFINEMENT, **lengths)
    size = bounding_diagonal(mesh)
    if not _SMALLEST <= size <= _LARGEST:
        table.fail(
            "",
            f"the object is {size:.3g} m across; must be {_SMALLEST:g} to {_LARGEST:g} m: lengths"
            " are in metres",
        )
    element = table.number("element") if "element" in table.values else edge
    if not element > 0.0:
        table.fail("element", f"is {element:g} m; must be positive")
    nodes = node_count(body, element)
    # The memory goes with the edge to the power -4; as much longer as rounding may shorten.
    least = 1.05 * element * (body_memory(nodes) / usable_memory()) ** 0.25
    with table.error_context():
        check_memory_for(
            f"element is {element:g} m: the factor of a stiffness matrix of some {nodes:.2g} nodes",
            body_memory(nodes),
            f"use {least:.2g} m or more (missing: the edge)",
        )
    held, support, stiffness = _support(root, body)
    return Specimen(mesh, body, held, support, element, stiffness)


def _support(
    root: TomlTable, body: TriangleMesh
) -> tuple[Indices, Mapping[str, object], float | None]:
    """Held triangles of [support], the session's table [support], and the foundation modulus."""
    table = root.table("support") if "support" in root.values else replace(root, values={})
    table = replace(table, name="[support]")
    stiffness = None
    if "stiffness" in table.values:
        stiffness = table.quantity("stiffness", STIFFNESS_UNITS, 1.0)
        if not 0.0 < stiffness < np.inf:
            table.fail("stiffness", f"is {stiffness:g} N/m^3; must be positive")
    selectors = {key: value for key, value in table.values.items() if key != "stiffness"}
    if not selectors and (stiffness is not None or "support" not in root.values):
        selectors = {"plane": _BASE}
    held = read_support(replace(table, values=selectors), body, metres_per_unit=1.0)
    layer = {} if stiffness is None else {"stiffness": stiffness}
    return held, selectors | layer, stiffness


def _check_edge(table: TomlTable, edge: float, lengths: Mapping[str, float]) -> None:
    """Refuse an edge so short that the surface mesh would not fit into memory."""
    # Area of a bounding box; a radius stands for two of its sides.
    sides = [s for name, x in lengths.items() for s in ([2 * x] * 2 if "radius" in name else [x])]
    area = sum(sides) ** 2 - sum(side**2 for side in sides)
    least = np.sqrt(area / _MOST_SQUARES)
    if 0.0 < edge < least and min(sides) > 0.0:
        table.fail(
            "edge",
            f"is {edge:g} m, which makes more than {_MOST_SQUARES} triangles of the surface; must"
            f" be {least:.2g} m or more",
        )


def _check_sizes(file: Path, config: LabConfig) -> None:
    """Refuse inconsistent lengths before any long computation begins."""
    mesh, look, arm = config.specimen.mesh, config.look, config.arm
    size = bounding_diagonal(mesh)

    def part(name: str) -> TomlTable:
        return TomlTable(file, name, {})

    for name, key in _WITHIN:
        length = float(np.linalg.norm(getattr(getattr(config, name), key)))
        if length > size:
            part(f"[{name}]").fail(
                key, f"is {length:g} m; must be {size:.2g} m at most, the object's size"
            )
    if config.head.file is None:
        with part("[head]").error_context():
            make_head(config.head, mesh)
    if look.texture == "speckle":
        with part("[look]").error_context():
            dot_count(mesh, look.size)
    modulus = config.material.young_modulus / (1.0 - config.material.poisson_ratio**2)
    for probe in config.probes:
        tip = Tip(arm.tool, probe.point, _DOWN)
        with part(f"[[probe]] '{probe.name}'").error_context():
            tip.check_depth(probe.depth or 0.0)
            tip.check_force(probe.force or 0.0, modulus)


def _settings(table: TomlTable, kind: type[Settings], **given: Any) -> Settings:
    """A dataclass filled from a table, key by field; fields with a default may be left out."""
    known = [field for field in fields(kind) if field.name not in given]  # type: ignore[arg-type]
    table.check_keys([field.name for field in known])
    hints = get_type_hints(kind)
    values = dict(given)
    for field in known:
        needed = field.default is MISSING and field.default_factory is MISSING
        if needed or field.name in table.values:
            values[field.name] = _value(table, field.name, hints[field.name])
    with table.error_context():
        return kind(**values)


def _value(table: TomlTable, key: str, hint: Any) -> Any:
    """Value of a key, converted to the type of the field."""
    if get_origin(hint) in (Union, UnionType):
        (hint,) = (kind for kind in get_args(hint) if kind is not NoneType)
    if isinstance(hint, type) and is_dataclass(hint):
        inner = table.table(key, f"[{key}]") if key in table.values else None
        return _settings(inner or TomlTable(table.file, f"[{key}]", {}), hint)
    if get_origin(hint) is Literal:
        return table.choice(key, get_args(hint))
    value = table.get(key)
    for kind, text in ((bool, "true or false"), (int, "a whole number")):
        if hint is kind and type(value) is not kind:
            table.fail(key, f"is {quoted(value)}; must be {text}")
    if hint is float:
        return table.number(key)
    if hint is str:
        return table.text(key)
    return value if hint in (bool, int) else table.vector(key)
