"""Prior standard deviations of measurement errors that points or probings have in common."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from palpate.errors import InputError
from palpate.records.quantities import ANGLE_UNITS, COMPLIANCE_UNITS, LENGTH_UNITS
from palpate.records.text.toml_table import TomlTable

_FRACTION_UNITS = {"%": 0.01}
_FRACTION_KEYS = ("force_gain", "force", "contact_radius", "touched_radius", "length_scale")
_COMPLIANCE_KEYS = ("support_compliance", "tool_compliance")
_TOOL_UNITS = {"m/N": 1.0, "mm/N": 1e-3, "um/N": 1e-6}

_LARGEST_FRACTION, _LARGEST_ANGLE, _LARGEST_LENGTH = 0.5, 0.5, 1.0
# One metre per pascal, or per newton: in effect no support.
_LARGEST_COMPLIANCE = 1.0


@dataclass(frozen=True, slots=True)
class ErrorPriors:
    """Prior standard deviations of systematic errors; 0 means exact.

    The defaults are what a careful laboratory can guarantee without measuring it.

    Parameters
    ----------
    force_gain : float [-]          gain of a force sensor, common to all probings that it measured
    force_direction : float [rad]   rotation of a force sensor, about each axis
    force : float [-]               force of a probing without `force_std`: each component, as a
                                    fraction of the force's length
    contact_point : float [m]       position of a contact, along each tangent, for each probing
    contact_radius : float [-]      given contact radius, relative, for each probing
    touched_radius : float [-]      contact radius computed from the tool, relative: partial
                                    friction, a tool that is not perfectly round
    pose_translation : float [m]    shift of the mesh relative to the measured points, along each
                                    axis
    pose_rotation : float [rad]     rotation of the mesh relative to the measured points, about each
                                    axis
    length_scale : float [-]        scale of the measured displacements, along each axis
    support_compliance : float [m/Pa]    compliance of each support beyond that in the session:
                                    displacement over traction
    tool_compliance : float [m/N]   of the arm, the tool and the base, along each measured
                                    displacement of a tool
    contact_points : mapping        name of a probing -> its own `contact_point` [m], where it
                                    differs
    force_gains : mapping           name of a force sensor -> its own `force_gain`, where it differs

    Raises
    ------
    InputError                      negative, or too large to be an error rather than a mistake
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
    tool_compliance: float = 0.0
    contact_points: Mapping[str, float] = field(default_factory=dict)
    force_gains: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        largest = {
            "force_direction": _LARGEST_ANGLE,
            "pose_rotation": _LARGEST_ANGLE,
            "contact_point": _LARGEST_LENGTH,
            "pose_translation": _LARGEST_LENGTH,
            "support_compliance": _LARGEST_COMPLIANCE,
            "tool_compliance": _LARGEST_COMPLIANCE,
        }
        for prior in fields(self):
            if prior.name not in ("contact_points", "force_gains"):
                limit = largest.get(prior.name, _LARGEST_FRACTION)
                _check_range(prior.name.replace("_", " "), getattr(self, prior.name), limit)
        for name, std in self.contact_points.items():
            _check_range(f"the contact point of '{name}'", std, _LARGEST_LENGTH)
        for name, std in self.force_gains.items():
            _check_range(f"the force gain of '{name}'", std, _LARGEST_FRACTION)

    def contact_std(self, name: str) -> float:
        """Prior standard deviation of one probing's contact point, along each tangent [m]."""
        return self.contact_points.get(name, self.contact_point)

    def gain_std(self, sensor: str) -> float:
        """Prior standard deviation of the gain of one force sensor [-]."""
        return self.force_gains.get(sensor, self.force_gain)


def _check_range(name: str, value: float, limit: float) -> None:
    if not 0.0 <= value <= limit:
        raise InputError(
            f"the standard deviation of {name} is {value:g}; must be at least 0 (exact) and at most"
            f" {limit:g} in SI units"
        )


EXACT = ErrorPriors(*(0.0,) * 11)


def read_error_priors(
    root: TomlTable, *, metres_per_unit: float, calibrated: bool = False
) -> ErrorPriors:
    """Priors from the table [errors] of a session; keys that are missing have their defaults.

    Parameters
    ----------
    root : TomlTable                whole session.toml
    metres_per_unit : float         for lengths that are written without a unit
    calibrated : bool               the rig has a covariance, which then accounts for the scale
                                    error: `length_scale` is 0 unless the session gives it

    Returns
    -------
    ErrorPriors

    Raises
    ------
    RecordError                     an unknown key, not a number, an unknown unit, out of range
    """
    priors: dict[str, Any] = {"length_scale": 0.0} if calibrated else {}
    priors["contact_points"] = _contact_points(root, metres_per_unit)
    table = root.optional("errors", root.table) or TomlTable(root.file, "", {})
    table.check_keys(
        (*_FRACTION_KEYS, "force_direction", "contact_point", "pose", *_COMPLIANCE_KEYS)
    )
    fractions = [key for key in _FRACTION_KEYS if key in table.values]
    if isinstance(table.values.get("force_gain"), dict):
        fractions.remove("force_gain")
        priors["force_gains"] = _force_gains(root, table)
    priors |= {key: table.quantity(key, _FRACTION_UNITS, 1.0) for key in fractions}
    if "force_direction" in table.values:
        priors["force_direction"] = table.quantity("force_direction", ANGLE_UNITS)
    if "contact_point" in table.values:
        priors["contact_point"] = table.quantity("contact_point", LENGTH_UNITS, metres_per_unit)
    if "support_compliance" in table.values:
        priors["support_compliance"] = table.quantity("support_compliance", COMPLIANCE_UNITS, 1.0)
    if "tool_compliance" in table.values:
        priors["tool_compliance"] = table.quantity("tool_compliance", _TOOL_UNITS, 1.0)
    priors |= _pose(table, metres_per_unit)
    with table.error_context():
        return ErrorPriors(**priors)


def _force_gains(root: TomlTable, errors: TomlTable) -> dict[str, float]:
    """Standard deviations of the gains of force sensors, by their names."""
    table = errors.table("force_gain", "[errors] force_gain")
    probes = root.optional("probe", root.tables) or ()
    sensors = dict.fromkeys(
        probe.label("force_sensor") for probe in probes if "force_sensor" in probe.values
    )
    if not sensors:
        errors.fail(
            "force_gain",
            "is a table by sensor, but no probing names its sensor; give every probing its"
            ' force_sensor, such as force_sensor = "gauge", or one number for all',
        )
    table.check_keys(tuple(sensors))
    return {name: table.quantity(name, _FRACTION_UNITS, 1.0) for name in table.values}


def _contact_points(root: TomlTable, metres_per_unit: float) -> dict[str, float]:
    """Standard deviations of contact points that single probings give, [m] by name."""
    priors = {}
    for probe in root.optional("probe", root.tables) or ():
        contact = probe.values.get("contact")
        if isinstance(contact, dict) and "point_std" in contact:
            name = probe.text("name")
            table = TomlTable(root.file, f"[[probe]] '{name}' contact", contact)
            priors[name] = table.quantity("point_std", LENGTH_UNITS, metres_per_unit)
    return priors


def _pose(table: TomlTable, metres_per_unit: float) -> Mapping[str, float]:
    pose = table.optional("pose", lambda key: table.table(key, "[errors] pose"))
    if pose is None:
        return {}
    pose.check_keys(("translation", "rotation"))
    priors = {}
    if "translation" in pose.values:
        priors["pose_translation"] = pose.quantity("translation", LENGTH_UNITS, metres_per_unit)
    if "rotation" in pose.values:
        priors["pose_rotation"] = pose.quantity("rotation", ANGLE_UNITS)
    return priors
