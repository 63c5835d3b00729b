"""How well a laboratory knows what its points and its probings share."""

from collections.abc import Mapping
from dataclasses import dataclass, fields

import numpy as np

from palpate.errors import InputError
from palpate.records.quantities import COMPLIANCE_UNITS, LENGTH_UNITS
from palpate.records.text import TomlTable

_ANGLES = {"deg": float(np.radians(1.0)), "rad": 1.0}
_SHARES = {"%": 0.01}
_SHARE_KEYS = ("force_gain", "force", "contact_radius", "touched_radius", "length_scale")

_LARGEST_SHARE, _LARGEST_ANGLE, _LARGEST_LENGTH = 0.5, 0.5, 1.0
# A metre for each pascal: nothing holds any more.
_LARGEST_COMPLIANCE = 1.0


@dataclass(frozen=True, slots=True)
class ErrorPriors:
    """Standard deviations, before the fit, of errors that are no noise; 0 means exact.

    The defaults are what a careful laboratory can sign without measuring it.

    Parameters
    ----------
    force_gain : float [-]          gain of the force sensor, the same for all probings
    force_direction : float [rad]   turn of its axes, about each axis
    force : float [-]               force of a probing without `force_std`: of every component, over
                                    the length of the force
    contact_point : float [m]       place of a contact, along each tangent, for each probing
    contact_radius : float [-]      radius of the touched patch, for each probing
    touched_radius : float [-]      of a contact's radius, where it follows from the tool: friction
                                    that is neither free nor full, a tool that is not quite round
    pose_translation : float [m]    shift of the mesh against the measured points, along each axis
    pose_rotation : float [rad]     turn of the same, about each axis
    length_scale : float [-]        of measured displacements, along each axis
    support_compliance : float [m/Pa]    how much further than the session says each support gives:
                                    displacement over traction

    Raises
    ------
    InputError                      negative, or beyond what is an error and no mistake
    """

    force_gain: float = 0.01
    force_direction: float = float(np.radians(0.5))
    force: float = 0.01
    contact_point: float = 0.5e-3
    contact_radius: float = 0.1
    touched_radius: float = 0.05
    pose_translation: float = 0.2e-3
    pose_rotation: float = float(np.radians(0.2))
    length_scale: float = 0.002
    support_compliance: float = 0.0

    def __post_init__(self) -> None:
        largest = {
            "force_direction": _LARGEST_ANGLE,
            "pose_rotation": _LARGEST_ANGLE,
            "contact_point": _LARGEST_LENGTH,
            "pose_translation": _LARGEST_LENGTH,
            "support_compliance": _LARGEST_COMPLIANCE,
        }
        for field in fields(self):
            value, limit = getattr(self, field.name), largest.get(field.name, _LARGEST_SHARE)
            if not 0.0 <= value <= limit:
                raise InputError(
                    f"the standard deviation of {field.name.replace('_', ' ')} is {value:g}; must"
                    f" be at least 0 (exact) and at most {limit:g} in SI units"
                )


EXACT = ErrorPriors(*[0.0] * len(fields(ErrorPriors)))


def read_error_priors(root: TomlTable, *, metres_per_unit: float) -> ErrorPriors:
    """Priors of a session; those that it does not name have their defaults.

    Parameters
    ----------
    root : TomlTable                of the session
    metres_per_unit : float         of lengths that are written without a unit

    Returns
    -------
    ErrorPriors

    Raises
    ------
    RecordError                     an unknown key, no number, an unknown unit, beyond its range
    """
    table = root.optional("errors", root.table)
    if table is None:
        return ErrorPriors()
    table.check_keys(
        (*_SHARE_KEYS, "force_direction", "contact_point", "pose", "support_compliance")
    )
    found = {key: table.quantity(key, _SHARES, 1.0) for key in _SHARE_KEYS if key in table.values}
    if "force_direction" in table.values:
        found["force_direction"] = table.quantity("force_direction", _ANGLES)
    if "contact_point" in table.values:
        found["contact_point"] = table.quantity("contact_point", LENGTH_UNITS, metres_per_unit)
    if "support_compliance" in table.values:
        found["support_compliance"] = table.quantity("support_compliance", COMPLIANCE_UNITS, 1.0)
    found |= _pose(table, metres_per_unit)
    with table.blamed():
        return ErrorPriors(**found)


def _pose(table: TomlTable, metres_per_unit: float) -> Mapping[str, float]:
    pose = table.optional("pose", lambda key: table.table(key, "[errors] pose"))
    if pose is None:
        return {}
    pose.check_keys(("translation", "rotation"))
    found = {}
    if "translation" in pose.values:
        found["pose_translation"] = pose.quantity("translation", LENGTH_UNITS, metres_per_unit)
    if "rotation" in pose.values:
        found["pose_rotation"] = pose.quantity("rotation", _ANGLES)
    return found
