"""Palpate: elastic constants of a soft object from probings with a known force.

Purpose    : estimate shear modulus, Poisson's ratio and Young's modulus, each with an interval.
Takes      : a session folder (closed triangle mesh, support, probings with displacements).
Gives      : an estimate with intervals, a likelihood over the constants, residuals per probing.
Depends on : nothing of its own; numpy, scipy, numba and what else `pyproject.toml` names.
Read first : `api.py`, `records/session.py`, `pipeline/fit_session.py`; docs/developer/index.md.

    import palpate

    result = palpate.fit("examples/half_ball")
    print(result)

Importing this root is cheap: each of its names is loaded when it is first used. Everything else is
imported by the name of its room.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from palpate.api import Result as Result, fit as fit, read_result as read_result
    from palpate.errors import InputError as InputError, PalpateError as PalpateError
    from palpate.geometry import (
        TriangleMesh as TriangleMesh,
        read_mesh as read_mesh,
        write_mesh as write_mesh,
    )
    from palpate.records import (
        Constant as Constant,
        Contact as Contact,
        DisplacementField as DisplacementField,
        Estimate as Estimate,
        Probing as Probing,
        Rig as Rig,
        Session as Session,
        Status as Status,
        read_estimate as read_estimate,
        read_rig as read_rig,
        read_session as read_session,
    )

__version__ = "0.1.0"

# Room of every name, in the order in which a newcomer needs them.
_ROOMS = {
    "palpate.records": (
        "read_session", "Session", "Probing", "Contact", "DisplacementField", "Estimate",
        "Constant", "Status", "Rig", "read_estimate", "read_rig",
    ),
    "palpate.api": ("fit", "Result", "read_result"),
    "palpate.geometry": ("TriangleMesh", "read_mesh", "write_mesh"),
    "palpate.errors": ("PalpateError", "InputError"),
}  # fmt: skip
_ROOM_OF = {name: room for room, names in _ROOMS.items() for name in names}


def __getattr__(name: str) -> Any:
    room = _ROOM_OF.get(name)
    if room is None:
        raise AttributeError(f"module 'palpate' has no attribute {name!r}")
    value = getattr(import_module(room), name)
    # From now on found without this function.
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*_ROOM_OF, "__version__"])
