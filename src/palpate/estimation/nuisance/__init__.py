"""Errors that points share, as parameters with a prior; each kind has its own file.

Purpose    : effect of a wrong gain, direction, contact, pose or scale on the displacements.
Takes      : `LoadedResponse`: the response of a probing and the load vector that multiplies it.
Gives      : `Nuisance` and `CurvedNuisance` (protocols); `ForceGain`, `ForceDirection`,
             `LengthScale`, `SpaceStretch`, `ContactError`, `ToolSlip`, `Pose`, `Discretisation`,
             `ModelStep`, `SupportCompliance`, `CorrectionError`; `contact_error`.
Depends on : nothing but the ground floor.
Read first : `nuisance.py`, then `force_gain.py`.
"""

from palpate.estimation.nuisance.contact import (
    ContactError as ContactError,
    ToolSlip as ToolSlip,
    contact_error as contact_error,
)
from palpate.estimation.nuisance.correction_error import CorrectionError as CorrectionError
from palpate.estimation.nuisance.discretisation import Discretisation as Discretisation
from palpate.estimation.nuisance.force_direction import ForceDirection as ForceDirection
from palpate.estimation.nuisance.force_gain import ForceGain as ForceGain
from palpate.estimation.nuisance.length_scale import LengthScale as LengthScale
from palpate.estimation.nuisance.model_step import ModelStep as ModelStep
from palpate.estimation.nuisance.nuisance import (
    CurvedNuisance as CurvedNuisance,
    LoadedResponse as LoadedResponse,
    Nuisance as Nuisance,
    NuisanceParameter as NuisanceParameter,
)
from palpate.estimation.nuisance.pose import Pose as Pose
from palpate.estimation.nuisance.space_stretch import SpaceStretch as SpaceStretch
from palpate.estimation.nuisance.support_compliance import (
    SupportCompliance as SupportCompliance,
)
