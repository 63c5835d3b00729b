"""Depth maps of RGB-D cameras and range scanners."""

from pathlib import Path

import numpy as np
from jaxtyping import Float

from palpate.errors import RecordError
from palpate.files import checked_file, parse_array, read_bytes, read_errors
from palpate.records import Camera
from palpate.shapes import Points
from palpate.vision import normalised, read_stored

DEPTH_SUFFIXES = (".png", ".tif", ".tiff", ".npy")
_MAX_BYTES = 2**28
# Plausible range of depth [m].
_NEAREST, _FARTHEST = 0.02, 30.0
# More points per view add nothing for a mesh of some thousand vertices.
_MAX_POINTS = 20_000
# Neighbouring pixels whose depths differ by more than this fraction lie on two surfaces.
_JUMP = 0.01


def depth_points(path: Path, camera: Camera, *, metres_per_level: float) -> Points:
    """Points of a depth map in the camera's frame, z along its axis.

    Pixels that are zero, not finite, or beside a discontinuity of depth are left out. If more than
    20 000 remain, only every k-th row and column is used.

    Parameters
    ----------
    path : Path                     16-bit PNG or TIFF, or NPY: depth along the axis
    camera : Camera
    metres_per_level : float        depth per grey level [m], usually 0.001

    Returns
    -------
    (n, 3) float [m]

    Raises
    ------
    RecordError                     the file is missing, not readable, or not of the camera's size;
                                    it has no depths, or their median is not between 0.02 and 30 m
    """
    depth = _levels(path) * metres_per_level
    if camera.size is not None and depth.shape[::-1] != camera.size:
        size = "{} x {}".format(*camera.size)
        raise RecordError(
            f"{path}: has {depth.shape[1]} x {depth.shape[0]} pixels, the camera {size}"
        )
    seen = np.isfinite(depth) & (depth > 0.0)
    if not seen.any():
        raise RecordError(f"{path}: no pixel holds a depth; 0 means not measured")
    middle = float(np.median(depth[seen]))
    if not _NEAREST <= middle <= _FARTHEST:
        raise RecordError(
            f"{path}: its middle depth is {middle:.3g} m; cameras measure {_NEAREST:g} to"
            f" {_FARTHEST:g} m: check the scale, {metres_per_level:g} m a level here (most cameras"
            " write millimetres: 0.001 m)"
        )
    seen &= ~_beside_jump(depth, seen)
    step = max(1, int(np.ceil(np.sqrt(seen.sum() / _MAX_POINTS))))
    rows, columns = np.nonzero(seen[::step, ::step])
    pixels = step * np.stack([columns, rows], axis=1).astype(np.float64)
    z = depth[::step, ::step][rows, columns]
    return np.column_stack([normalised(camera, pixels) * z[:, None], z])


def _levels(path: Path) -> Float[np.ndarray, "rows columns"]:
    with read_errors(path, "write it again", what="cannot be read as a depth map"):
        checked_file(path, max_bytes=_MAX_BYTES)
        if path.suffix.lower() == ".npy":
            levels = parse_array(read_bytes(path))
        else:
            levels, _ = read_stored(path, "depth map", None)
        if levels.ndim != 2:
            raise ValueError("it must be one number a pixel")
        if levels.dtype == np.uint8:
            raise ValueError("it has 8 bits a pixel; depth needs 16")
        return np.asarray(levels, dtype=np.float64)


def _beside_jump(depth: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Pixels beside a discontinuity of depth, whose values may mix two surfaces."""
    beside = np.zeros_like(seen)
    for axis in (0, 1):
        first, second = (
            np.take(depth, range(depth.shape[axis] - 1), axis),
            np.take(depth, range(1, depth.shape[axis]), axis),
        )
        known = np.take(seen, range(depth.shape[axis] - 1), axis) & np.take(
            seen, range(1, depth.shape[axis]), axis
        )
        jump = known & (abs(first - second) > _JUMP * np.minimum(first, second))
        pad = [(0, 0), (0, 0)]
        pad[axis] = (0, 1)
        beside |= np.pad(jump, pad)
        pad[axis] = (1, 0)
        beside |= np.pad(jump, pad)
    return beside
