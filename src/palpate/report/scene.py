"""Data of the report's interactive 3-D view, compact enough to embed in the page."""

import base64
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_hex

from palpate.figures import MOST_SIGMAS, OUTLIER_WEIGHT, best_direction, rms_of_known
from palpate.geometry import TriangleMesh, closest_points, unit_normals
from palpate.pipeline import FittedProbing, FittedSurface
from palpate.shapes import Points, PointScalars, Vector3

# Size limit of the view [bytes of base64], for a page of 5 MB.
_MOST_BYTES = 2_200_000
# Lengths are stored as 16-bit integers: the largest value, and the one that means "unknown".
_STEPS, _UNKNOWN = 32767, -32768
_BANDS = 10


def scene(surface: FittedSurface) -> dict[str, Any]:
    """The view of a fitted object as data for JSON; lengths in mm.

    Parameters
    ----------
    surface : FittedSurface

    Returns
    -------
    dict                            probings for which the page has no room are left out; `left_out`
                                    is their number
    """
    centre = 0.5 * (surface.vertices.min(axis=0) + surface.vertices.max(axis=0))
    vertices = 1e3 * (surface.vertices - centre)
    held = np.zeros(len(surface.triangles), dtype=np.uint8)
    held[surface.held] = 1
    mesh = TriangleMesh(surface.vertices, surface.triangles)
    direction = _direction(surface, mesh)
    content: dict[str, Any] = {
        "radius": float(np.linalg.norm(vertices, axis=1).max()),
        "azimuth": float(np.arctan2(direction[1], direction[0])),
        "elevation": float(np.arcsin(direction[2])),
        "most_sigmas": MOST_SIGMAS,
        "colours": [to_hex(c) for c in mpl.colormaps["viridis"](np.linspace(0.0, 1.0, _BANDS))],
        "vertices": _packed(vertices),
        "triangles": _text(surface.triangles.astype("<u4")),
        "held": _text(held),
        "probings": [],
    }
    size = sum(_size(value) for value in content.values())
    for probing in surface.probings:
        shown = _probing(probing, centre, mesh)
        size += sum(_size(value) for value in shown.values())
        if size > _MOST_BYTES and content["probings"]:
            break
        content["probings"].append(shown)
    return content | {"left_out": len(surface.probings) - len(content["probings"])}


def in_sigmas(probing: FittedProbing) -> PointScalars:
    """Normalised residual of every point: rms over the components of residual over sigma.

    About 1 if model and noise levels are right.

    Parameters
    ----------
    probing : FittedProbing

    Returns
    -------
    (n,) float [-]                  NaN where not measured
    """
    return rms_of_known((probing.displacement - probing.predicted) / probing.sigma)


def _moved(probing: FittedProbing) -> Points:
    """Measured displacements; what one camera does not see, as predicted."""
    missing = np.isnan(probing.displacement)
    unseen = missing & ~missing.all(axis=1, keepdims=True)
    return np.where(unseen, probing.predicted, probing.displacement)


def _direction(surface: FittedSurface, mesh: TriangleMesh) -> Vector3:
    """Direction toward the viewer from which most points of the first probing are visible."""
    normals, first = unit_normals(mesh), surface.probings[0]
    seen = np.isfinite(_moved(first)).all(axis=1)
    places = closest_points(mesh, np.vstack([first.contact, first.points[seen]])).triangle
    return best_direction(normals[places[1:]], normals[places[0]])


def _probing(probing: FittedProbing, centre: Vector3, mesh: TriangleMesh) -> dict[str, Any]:
    """One probing, without points that were not measured and without outliers."""
    moved = _moved(probing)
    seen = np.isfinite(moved).all(axis=1)
    used = seen & (probing.weight.max(axis=1) >= OUTLIER_WEIGHT)
    seen, surface = used if used.any() else seen, probing.surface
    places = closest_points(mesh, probing.points[seen]).triangle
    length = 1e3 * np.linalg.norm(moved[seen], axis=1)
    return {
        "name": probing.name,
        # Upper end of the colour scale [mm].
        "top": max(float(np.quantile(length, 0.99)), 1e-6) if seen.any() else 1.0,
        "force": probing.force.tolist(),
        "contact": (1e3 * (probing.contact - centre)).tolist(),
        "rows": (np.flatnonzero(seen) + 1).tolist(),
        "points": _packed(1e3 * (probing.points[seen] - centre)),
        "normals": _packed(unit_normals(mesh)[places]),
        "measured": _packed(1e3 * moved[seen]),
        "predicted": _packed(1e3 * probing.predicted[seen]),
        "sigmas": _packed(in_sigmas(probing)[seen]),
        "surface": None if surface is None else _packed(1e3 * surface),
    }


def _packed(values: Points | PointScalars) -> dict[str, Any]:
    """Numbers as 16-bit integers with their unit; rounding error 1.5e-5 of the largest."""
    known = np.isfinite(values)
    largest = float(np.abs(values[known]).max()) if known.any() else 0.0
    unit = max(largest, 1e-12) / _STEPS
    whole = np.where(known, np.rint(np.where(known, values, 0.0) / unit), _UNKNOWN)
    return {"unit": unit, "data": _text(whole.astype("<i2"))}


def _text(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()


def _size(value: Any) -> int:
    """Approximate size in bytes of a part of the scene."""
    if isinstance(value, dict):
        return len(value["data"])
    return (
        len(value) if isinstance(value, str) else 8 * len(value) if isinstance(value, list) else 0
    )
