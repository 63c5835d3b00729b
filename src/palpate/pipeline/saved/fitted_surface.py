"""Measured and predicted surface of a fitted object, in a file that other programs can read."""

import io
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from palpate.disk import write_bytes
from palpate.errors import RecordError
from palpate.estimation import FitResult, LikelihoodMap
from palpate.files import stored_arrays
from palpate.records import Session
from palpate.shapes import Indices, Points, Vector3

SURFACE_FILE = "surface.npz"
SURFACE_FORMAT = "palpate-fitted-surface/1"
# Earlier name of the format, which files of scanned meshes had as well.
_EARLIER_FORMAT = "palpate-surface/1"
# Enough for a hundred probings of fifty thousand vertices.
_MOST_BYTES = 2**30
# Arrays of a probing with one row for each point; their names follow `NUMBER/`.
_POINTS = ("points", "displacement", "predicted", "left_out", "sigma", "weight")


@dataclass(frozen=True, slots=True, eq=False)
class FittedProbing:
    """One probing of a fitted object; rows of points that were not measured hold NaN.

    Attributes
    ----------
    name : str
    contact : (3,) float [m]        centre of the tool's patch
    force : (3,) float [N]
    points : (n, 3) float [m]       at rest
    displacement : (n, 3) float [m] measured
    predicted : (n, 3) float [m]    by the fitted model
    left_out : (n, 3) float [m] or None     by the model fitted to all other probings
    sigma : (n, 3) float [m]        1 sigma of the measured displacement used in the estimate
    weight : (n, 3) float           robust weight, 0 to 1
    surface : (v, 3) float [m] or None      predicted displacement of every vertex
    """

    name: str
    contact: Vector3
    force: Vector3
    points: Points
    displacement: Points
    predicted: Points
    left_out: Points | None
    sigma: Points
    weight: Points
    surface: Float[np.ndarray, "v 3"] | None


@dataclass(frozen=True, slots=True, eq=False)
class FittedSurface:
    """A fitted object, its probings and the likelihood of its constants.

    Attributes
    ----------
    name : str                      of the session
    vertices : (v, 3) float [m]
    triangles : (m, 3) int
    held : (k,) int                 triangles of the supports
    probings : tuple of FittedProbing
    likelihood : LikelihoodMap
    """

    name: str
    vertices: Float[np.ndarray, "v 3"]
    triangles: Int[np.ndarray, "m 3"]
    held: Indices
    probings: tuple[FittedProbing, ...]
    likelihood: LikelihoodMap


def write_fitted_surface(folder: Path, session: Session, result: FitResult) -> None:
    """Write `surface.npz`; lengths in metres, forces in newtons, object frame.

    Parameters
    ----------
    folder : Path                   of the result
    session : Session               that was fitted
    result : FitResult

    Raises
    ------
    RecordError                     the file cannot be written
    """
    content: dict[str, Any] = {
        "format": np.array(SURFACE_FORMAT),
        "name": np.array(session.name),
        "probings": np.array([one.name for one in result.probes], dtype=str),
        "vertices": session.mesh.vertices,
        "triangles": session.mesh.triangles.astype(np.int32),
        "held": session.held_triangles.astype(np.int32),
        "likelihood/poisson_ratio": result.likelihood.poisson_ratio,
        "likelihood/shear_modulus": result.likelihood.shear_modulus,
        "likelihood/deviance": result.likelihood.deviance,
    }
    by_name = {probing.name: probing for probing in session.probings}
    for number, fit in enumerate(result.probes, start=1):
        probing = by_name[fit.name]
        field = probing.displacement
        if field is None:
            continue
        arrays = {
            "contact": probing.contact.point,
            "force": probing.force,
            "points": field.points,
            "displacement": field.displacement,
            "predicted": fit.predicted,
            "left_out": fit.left_out_predicted,
            "sigma": field.displacement * np.nan if fit.sigma is None else fit.sigma,
            "weight": fit.weight,
            "surface": fit.surface,
        }
        content |= {f"{number}/{name}": x for name, x in arrays.items() if x is not None}
    packed = io.BytesIO()
    np.savez_compressed(packed, **content)
    write_bytes(folder / SURFACE_FILE, packed.getvalue())


def read_fitted_surface(folder: Path) -> FittedSurface:
    """Read `surface.npz` back.

    Parameters
    ----------
    folder : Path                   of a result

    Returns
    -------
    FittedSurface

    Raises
    ------
    RecordError                     the file is missing, unreadable, of another version or
                                    inconsistent
    """
    path = folder / SURFACE_FILE
    if not path.is_file():
        raise RecordError(
            f"{path}: is not there; was {folder} written by `palpate fit` of an earlier version?"
            " fit the session again"
        )
    what = "is damaged or of another version"
    with stored_arrays(path, "fit the session again", what=what, max_bytes=_MOST_BYTES) as kept:
        return _surface(kept)


def _surface(kept: dict[str, np.ndarray]) -> FittedSurface:
    if str(kept["format"]) not in (SURFACE_FORMAT, _EARLIER_FORMAT):
        raise ValueError(f"format is '{kept['format']}', not '{SURFACE_FORMAT}'")
    vertices, triangles, held = kept["vertices"], kept["triangles"], kept["held"]
    for name, indices, count in (
        ("triangles", triangles, len(vertices)),
        ("held", held, len(triangles)),
    ):
        if indices.min(initial=0) < 0 or indices.max(initial=0) >= count:
            raise ValueError(f"its array '{name}' has numbers outside 0 to {count - 1}")
    if not np.isfinite(vertices).all():
        raise ValueError("its array 'vertices' has numbers that are not finite")
    probings = [
        _probing(
            str(name),
            {key[len(f"{number}/") :]: kept[key] for key in kept if key.startswith(f"{number}/")},
        )
        for number, name in enumerate(kept["probings"], start=1)
        if f"{number}/points" in kept
    ]
    if any(each.surface is not None and each.surface.shape != vertices.shape for each in probings):
        raise ValueError("surfaces of probings are those of another mesh")
    likelihood = LikelihoodMap(
        *(kept[f"likelihood/{key}"] for key in ("poisson_ratio", "shear_modulus", "deviance"))
    )
    return FittedSurface(str(kept["name"]), vertices, triangles, held, tuple(probings), likelihood)


def _probing(name: str, arrays: dict[str, np.ndarray]) -> FittedProbing:
    if len({len(arrays[key]) for key in _POINTS if key in arrays}) != 1:
        raise ValueError(f"arrays of probing '{name}' differ in length")
    return FittedProbing(
        name=name,
        left_out=arrays.get("left_out"),
        surface=arrays.get("surface"),
        **{key: arrays[key] for key in arrays if key not in ("left_out", "surface")},
    )
