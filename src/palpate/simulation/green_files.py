"""Green's functions as an NPZ file, `palpate-greens/2`: for haptic loops in any language.

Arrays, little endian, C order, SI units, object frame; v vertices, m triangles, n nodes:

format, name                       texts
vertices (v, 3), triangles (m, 3)  surface at rest [m]; counter-clockwise from outside
held_triangles (h,)                triangles of the support
nodes (n,)                         vertices that may be touched, ascending
compliance (n, 3, n, 3)            [m/N] [i, a, j, b]: component a at node i per force along b on j
surface (n, 3, v, 3)               [m/N] [j, b, i, a]: the same for every vertex i
slope (n, 3, n, 3)                 [m/N] derivative of compliance in Poisson's ratio, [i, a, j, b]
constants (2,), covariance (2, 2)  shear modulus [Pa], Poisson's ratio
asymmetry ()                       relative asymmetry of compliance before symmetrisation
left_out (l,)                      vertices that are no nodes: compliance would be indefinite
sha256                             of the bytes of all other arrays, in the order of their names

A force on a node is distributed over the linear hat function of its vertex. Displacements are
linear in the forces and proportional to 1 / shear modulus.
"""

import hashlib
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from palpate.disk import write_bytes, write_errors
from palpate.errors import PalpateError, RecordError
from palpate.files import stored_arrays
from palpate.geometry import TriangleMesh
from palpate.simulation.green_functions import GreenFunctions
from palpate.simulation.material import Material

GREENS_FORMAT = "palpate-greens/2"
_ARRAYS = ("held_triangles", "nodes", "compliance", "surface", "slope", "left_out", "asymmetry")
_KEYS = {
    "format", "name", "vertices", "triangles", "constants", "covariance", "sha256", *_ARRAYS,
}  # fmt: skip


def write_green_functions(path: Path, green: GreenFunctions) -> None:
    """Write Green's functions, atomically: the file holds all of them or its old content.

    Parameters
    ----------
    path : Path                     with suffix .npz; its folder must exist
    green : GreenFunctions

    Raises
    ------
    RecordError                     the file cannot be written
    """
    material = green.material
    content = {
        "format": np.array(GREENS_FORMAT),
        "name": np.array(green.name),
        "vertices": green.mesh.vertices,
        "triangles": green.mesh.triangles,
        "constants": np.array([material.shear_modulus, material.poisson_ratio]),
        "covariance": material.covariance,
        **{name: np.asarray(getattr(green, name)) for name in _ARRAYS},
    }
    packed = BytesIO()
    np.savez(packed, **content, sha256=np.array(_digest(content)))  # type: ignore[arg-type]
    with write_errors(path):
        write_bytes(path, packed.getvalue())


def read_green_functions(path: Path | str) -> GreenFunctions:
    """Read Green's functions and check them.

    Parameters
    ----------
    path : path

    Returns
    -------
    GreenFunctions

    Raises
    ------
    RecordError                     file missing, not of this format, of another version, damaged,
                                    or with inconsistent arrays; the message names the array
    """
    path = Path(path)
    cure = "make it again with `palpate export RESULT --to npz`"
    with stored_arrays(path, cure, what="is no NPZ file, or only a part of one") as content:
        return _green_functions(path, content)


def _green_functions(path: Path, content: dict[str, np.ndarray]) -> GreenFunctions:
    found = str(content.get("format", ""))
    if found != GREENS_FORMAT:
        raise RecordError(f"{path}: format is '{found}'; this version reads '{GREENS_FORMAT}'")
    if missing := sorted(_KEYS - set(content)):
        raise RecordError(f"{path}: the array '{missing[0]}' is missing")
    if str(content.pop("sha256")) != _digest(content):
        raise RecordError(
            f"{path}: its arrays are not as they were written (sha256 differs); make it again"
        )
    try:
        shear, ratio = content["constants"]
        return GreenFunctions(
            name=str(content["name"]),
            mesh=TriangleMesh(content["vertices"], content["triangles"]),
            material=Material(float(shear), float(ratio), content["covariance"]),
            **{name: content[name] for name in _ARRAYS[:-1]},
            asymmetry=float(content["asymmetry"]),
        )
    except (PalpateError, TypeError, ValueError) as error:
        raise RecordError(f"{path}: {error}") from error


def _digest(content: Mapping[str, Any]) -> str:
    """Checksum of the arrays, in the order of their names."""
    digest = hashlib.sha256()
    for name in sorted(content):
        array = np.ascontiguousarray(content[name])
        digest.update(f"{name} {array.dtype.str} {array.shape};".encode())
        digest.update(array.tobytes())
    return digest.hexdigest()
