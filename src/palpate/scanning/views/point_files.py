"""Reading point clouds: PLY, PCD, E57, NPY, XYZ and other columns of text."""

from io import BytesIO
from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import RecordError
from palpate.files import parse_array, read_bytes, read_errors
from palpate.optional_imports import late_import
from palpate.shapes import Points

POINT_SUFFIXES = (".ply", ".pcd", ".e57", ".npy", ".xyz", ".txt", ".csv", ".asc")
_MAX_BYTES = 2**30
# Smallest plausible extent and largest plausible coordinate [m]; otherwise the unit is wrong.
_SPAN = (1e-6, 1e4)
_PCD_TYPES = {"F": "f", "I": "i", "U": "u"}


def read_points(path: Path, *, metres_per_unit: float = 1.0) -> Points:
    """Read a point cloud in metres, without points marked as not measured.

    Parameters
    ----------
    path : Path                     .ply .pcd .e57 .npy, or text with columns x y z: .xyz .txt .csv
                                    .asc
    metres_per_unit : float         length unit of the file [m], > 0; E57 is always in metres

    Returns
    -------
    (n, 3) float [m]                n > 0; rows that are not finite are left out, and rows at
                                    0, 0, 0 if there is more than one

    Raises
    ------
    RecordError                     the file is missing, not readable, of an unknown type, has no
                                    points, or an implausible size
    InputError                      the optional package for E57 is missing
    """
    suffix = path.suffix.lower()
    if suffix not in POINT_SUFFIXES:
        raise RecordError(
            f"{path}: point files of type '{suffix}' are not read; convert it to one of"
            f" {' '.join(POINT_SUFFIXES)}"
        )
    content = read_bytes(path, max_bytes=_MAX_BYTES)
    if suffix == ".e57":
        late_import("pye57", extra="e57", purpose=f"reading {path.name}")
        metres_per_unit = 1.0
    what = f"cannot be read as points of type {suffix[1:].upper()}"
    with read_errors(path, "three columns x y z of text are read, too", what=what):
        points = np.asarray(_read(path, content, suffix), dtype=np.float64)
        if points.ndim != 2 or points.shape[1] < 3:
            raise ValueError(f"its numbers have the shape {points.shape}, not three columns")
    points = points[:, :3]
    points = points[np.isfinite(points).all(axis=1)]
    # Scanners write the origin for rays without a return.
    nothing = (points == 0.0).all(axis=1)
    points = points[~nothing] if nothing.sum() > 1 else points
    if len(points) == 0:
        raise RecordError(f"{path}: holds no points with three finite coordinates")
    points = points * metres_per_unit
    span, place = float(np.ptp(points, axis=0).max()), float(abs(points).max())
    if place > _SPAN[1] or (len(points) > 1 and span < _SPAN[0]):
        raise RecordError(
            f"{path}: its points are {span:.3g} m across, up to {place:.3g} m from the origin; an"
            f" object must be {_SPAN[0]:g} m across or more, within {_SPAN[1]:g} m: check the unit"
        )
    return points


def _read(path: Path, content: bytes, suffix: str) -> np.ndarray:
    if suffix == ".e57":
        return _e57(path)
    if suffix == ".npy":
        return parse_array(content)
    if suffix == ".pcd":
        return _pcd(content)
    if suffix == ".ply":
        trimesh = late_import("trimesh", extra=None, purpose="reading a PLY")
        loaded = trimesh.load(BytesIO(content), file_type="ply", process=False)
        return np.asarray(loaded.vertices)
    return _text(content.decode("utf-8", errors="replace"))


def _e57(path: Path) -> Float[np.ndarray, "n 3"]:
    """The only scan of a file, in the file's frame, without points marked as invalid."""
    pye57 = late_import("pye57", extra="e57", purpose=f"reading {path.name}")
    file = pye57.E57(str(path))
    try:
        if file.scan_count != 1:
            raise ValueError(
                f"it has {file.scan_count} scans, each from a place of its own; export each as a"
                " file, and give each its [[view]]"
            )
        found = file.read_scan(0, ignore_missing_fields=True)
    finally:
        file.close()
    return np.stack([found[f"cartesian{axis}"] for axis in "XYZ"], axis=1)


def _text(text: str) -> Float[np.ndarray, "n 3"]:
    """The first three columns, below any heading; separated by blanks, commas or semicolons."""
    rows: list[list[float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.partition("#")[0].replace(",", " ").replace(";", " ").split()
        if len(words) < 3:
            continue
        try:
            # Python's float would accept 1_0 as ten.
            rows.append([float(word.replace("_", "?")) for word in words[:3]])
        except ValueError:
            # Headings stand above the first row.
            if rows:
                raise ValueError(f"line {number}: '{line[:40]}' is no row of numbers") from None
    return np.array(rows).reshape(-1, 3)


def _pcd(content: bytes) -> Float[np.ndarray, "n 3"]:
    """Point Cloud Library's format, as text or binary; compressed data are not read.

    Source: https://pointclouds.org/documentation/tutorials/pcd_file_format.html
    """
    head, _, rest = content.partition(b"\nDATA ")
    kind, _, data = rest.partition(b"\n")
    field = {}
    for line in head.decode("ascii", errors="replace").splitlines():
        word, _, value = line.partition(" ")
        field[word] = value.split()
    names, sizes, types = field["FIELDS"], field["SIZE"], field["TYPE"]
    counts = [int(word) for word in field.get("COUNT", ["1"] * len(names))]
    if kind.strip() == b"ascii":
        lines = data.decode().replace("_", "?").splitlines()
        table = np.array([line.split() for line in lines if line.strip()])
        first = np.cumsum([0, *counts[:-1]])
        return table[:, [first[names.index(axis)] for axis in "xyz"]].astype(np.float64)
    if kind.strip() != b"binary":
        raise ValueError(f"its data are {kind.strip().decode()!r}; save it as ascii or binary")
    layout = np.dtype(
        [
            (f"{name}_{k}", f"<{_PCD_TYPES[kind_]}{size}", (count,))
            for k, (name, kind_, size, count) in enumerate(
                zip(names, types, sizes, counts, strict=True)
            )
        ]
    )
    table = np.frombuffer(data, layout, int(field["POINTS"][0]))
    place = [names.index(axis) for axis in "xyz"]
    return np.stack([table[f"{names[k]}_{k}"][:, 0] for k in place], axis=1).astype(np.float64)
