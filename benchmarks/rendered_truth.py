"""True motion of the rendered sets at points of the object."""

import tomllib
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

__all__ = ["moved_by_pixels", "moved_by_steps"]

# Pixels around a vertex that a plane is laid through, and how near the nearest one must be: the
# pixels lie 0.31 mm apart, so farther away a vertex is outside of what the camera sees.
_AROUND, _NEAR = 12, 4e-4


def moved_by_steps(folder: Path, points: np.ndarray) -> list[np.ndarray]:
    """Displacement of points of a rigid object at every step after the first.

    Parameters
    ----------
    folder : Path             of the set, with truth.toml
    points : (n, 3) float [m]

    Returns
    -------
    list of (n, 3) float [m]
    """
    steps = tomllib.loads((folder / "truth.toml").read_text(encoding="utf-8"))["step"]
    return [points @ np.array(step["R"]).T + step["t"] - points for step in steps[1:]]


def moved_by_pixels(file: Path, points: np.ndarray) -> np.ndarray:
    """Displacement of points of the half ball from the pixels around them.

    Parameters
    ----------
    file : Path               truth_NAME.npz
    points : (n, 3) float [m]

    Returns
    -------
    (n, 3) float [m]          NaN where the reference camera does not see the point
    """
    truth = np.load(file)
    near, which = cKDTree(truth["X"]).query(points, k=_AROUND)
    moved = np.full(points.shape, np.nan)
    for v in np.flatnonzero(near[:, 0] < _NEAR):
        away = truth["X"][which[v]] - points[v]
        design = np.concatenate([np.ones((_AROUND, 1)), away], axis=1)
        moved[v] = np.linalg.lstsq(design, truth["U"][which[v]], rcond=1e-6)[0][0]
    return moved
