"""Records that cross rooms, and their files.

Purpose    : frozen dataclasses for what was measured and what was estimated; read and write them.
Takes      : session folders, displacement files, camera calibrations, estimate.json.
Gives      : `Session`, `Probing`, `DisplacementField`, `Rig`, `Estimate`.
Depends on : `geometry`, `errors`, `shapes`.
Read first : `probing.py`, `session.py`, then `session_files.py`.
"""

from palpate.records.estimate import (
    CONSTANT_NAMES as CONSTANT_NAMES,
    Constant as Constant,
    Estimate as Estimate,
    ProbeEstimate as ProbeEstimate,
    Status as Status,
)
from palpate.records.files import (
    ESTIMATE_FORMAT as ESTIMATE_FORMAT,
    SESSION_FORMAT as SESSION_FORMAT,
    ImportItem as ImportItem,
    SessionOutline as SessionOutline,
    default_folder as default_folder,
    disk_errors as disk_errors,
    displacement_line as displacement_line,
    import_plan as import_plan,
    placed_files as placed_files,
    read_displacement as read_displacement,
    read_estimate as read_estimate,
    read_rig as read_rig,
    read_session as read_session,
    read_session_outline as read_session_outline,
    result_folder as result_folder,
    rig_to_toml as rig_to_toml,
    with_displacements as with_displacements,
    write_displacement as write_displacement,
    write_estimate as write_estimate,
    write_rig as write_rig,
)
from palpate.records.import_displacement import (
    ImportedField as ImportedField,
    on_object as on_object,
    on_surface as on_surface,
    read_measured as read_measured,
)
from palpate.records.import_pose import read_import_pose as read_import_pose
from palpate.records.probing import (
    Contact as Contact,
    ContactProfile as ContactProfile,
    DisplacementField as DisplacementField,
    Images as Images,
    Probing as Probing,
    observed_rows as observed_rows,
)
from palpate.records.quantities import (
    constant_text as constant_text,
    interval_text as interval_text,
    length_unit as length_unit,
    modulus_unit as modulus_unit,
    value_text as value_text,
)
from palpate.records.rig import (
    DISTORTION_TERMS as DISTORTION_TERMS,
    Camera as Camera,
    Rig as Rig,
    camera_centre as camera_centre,
    picture_size as picture_size,
)
from palpate.records.session import Session as Session, require_probings as require_probings
from palpate.records.step import Step as Step
from palpate.records.support import read_support as read_support
from palpate.records.text import TomlTable as TomlTable, read_toml as read_toml
