"""Records of measurements and estimates that are passed between rooms, and their files.

Purpose    : frozen dataclasses that validate themselves, with their readers and writers.
Takes      : session folders, displacement CSV, rig.toml, estimate.json, files of other programs.
Gives      : `Session`, `Probing`, `Contact`, `DisplacementField`, `Rig`, `Estimate`, in SI units.
Depends on : `geometry`, `arrays`, `optional_imports`, `shapes`, `errors`.
Read first : `probing.py`, `session.py`, then `files/session.py`.
"""

from palpate.records.checks.displacements import copied_rows as copied_rows
from palpate.records.contacts.contact import (
    CONE as CONE,
    CYLINDER as CYLINDER,
    FLAT as FLAT,
    MESH as MESH,
    SLIDES as SLIDES,
    SPHERE as SPHERE,
    STICKS as STICKS,
    Contact as Contact,
    Tool as Tool,
    mesh_tool as mesh_tool,
)
from palpate.records.contacts.pressure import (
    PRESSURES as PRESSURES,
    RIGID as RIGID,
    Pressure as Pressure,
    PressureMap as PressureMap,
)
from palpate.records.error_priors import EXACT as EXACT, ErrorPriors as ErrorPriors
from palpate.records.estimate import (
    BIASED as BIASED,
    CONSTANT_NAMES as CONSTANT_NAMES,
    IMPOSSIBLE as IMPOSSIBLE,
    SURPRISING as SURPRISING,
    BudgetEntry as BudgetEntry,
    Constant as Constant,
    ErrorEstimate as ErrorEstimate,
    Estimate as Estimate,
    ProbeEstimate as ProbeEstimate,
    Status as Status,
    SupportEstimate as SupportEstimate,
)
from palpate.records.files.displacement import (
    read_displacement as read_displacement,
    write_displacement as write_displacement,
)
from palpate.records.files.estimate import (
    read_estimate as read_estimate,
    write_estimate as write_estimate,
)
from palpate.records.files.import_pose import read_import_pose as read_import_pose
from palpate.records.files.results import (
    INPUTS_FILE as INPUTS_FILE,
    REPORT_FILE as REPORT_FILE,
    check_fit_result as check_fit_result,
    check_free as check_free,
    default_folder as default_folder,
    disk_errors as disk_errors,
    folder_changes as folder_changes,
    parts_folder as parts_folder,
    record_inputs as record_inputs,
    result_file as result_file,
    result_folder as result_folder,
    sealed as sealed,
)
from palpate.records.files.rig import read_rig as read_rig, write_rig as write_rig
from palpate.records.files.rig_covariance import (
    covariance_file as covariance_file,
    read_rig_covariance as read_rig_covariance,
    write_rig_covariance as write_rig_covariance,
)
from palpate.records.files.session import (
    SESSION_FORMAT as SESSION_FORMAT,
    read_object_mesh as read_object_mesh,
    read_session as read_session,
)
from palpate.records.files.session_import import (
    ImportItem as ImportItem,
    displacement_line as displacement_line,
    import_plan as import_plan,
    named_displacements as named_displacements,
    with_displacements as with_displacements,
)
from palpate.records.files.sums import (
    file_sum as file_sum,
    file_sums as file_sums,
    session_files as session_files,
    sums_in as sums_in,
    sums_text as sums_text,
)
from palpate.records.files.support import (
    read_support as read_support,
    read_supports as read_supports,
)
from palpate.records.measured_points import (
    ImportedField as ImportedField,
    MeasuredPoints as MeasuredPoints,
    in_object_frame as in_object_frame,
    on_surface as on_surface,
)
from palpate.records.probing import (
    INDEPENDENT as INDEPENDENT,
    DisplacementField as DisplacementField,
    Images as Images,
    Load as Load,
    PointCorrelation as PointCorrelation,
    Probing as Probing,
    SurfaceAverage as SurfaceAverage,
    measured_rows as measured_rows,
    observed_rows as observed_rows,
)
from palpate.records.program import (
    ProgramPoints as ProgramPoints,
    camera_matrix as camera_matrix,
    make_pose as make_pose,
)
from palpate.records.programs.registry import (
    import_kinds as import_kinds,
    kinds_text as kinds_text,
    read_measured as read_measured,
)
from palpate.records.quantities import (
    HIGHEST_PRESSURE as HIGHEST_PRESSURE,
    MODULUS_RANGE as MODULUS_RANGE,
    NOT_DETERMINED as NOT_DETERMINED,
    SYMBOLS as SYMBOLS,
    budget_text as budget_text,
    constant_row as constant_row,
    constant_text as constant_text,
    error_texts as error_texts,
    interval_text as interval_text,
    length_unit as length_unit,
    modulus_unit as modulus_unit,
    value_text as value_text,
    verdict_text as verdict_text,
)
from palpate.records.reciprocity import (
    ForceExcess as ForceExcess,
    Reciprocity as Reciprocity,
    WorkPair as WorkPair,
)
from palpate.records.rig import (
    DISTORTION_TERMS as DISTORTION_TERMS,
    Camera as Camera,
    PictureTracks as PictureTracks,
    Rig as Rig,
    RigCovariance as RigCovariance,
    camera_centre as camera_centre,
    lens_radius_limit as lens_radius_limit,
    picture_size as picture_size,
)
from palpate.records.session import (
    Session as Session,
    Step as Step,
    require_probings as require_probings,
)
from palpate.records.support import (
    FIXED as FIXED,
    FREE as FREE,
    GIVEN as GIVEN,
    RigidMotion as RigidMotion,
    Support as Support,
)
from palpate.records.text.csv_table import (
    Column as Column,
    TextTable as TextTable,
    make_table as make_table,
    read_text_table as read_text_table,
    split_cells as split_cells,
    spreadsheet_text as spreadsheet_text,
    text_lines as text_lines,
)
from palpate.records.text.file_names import (
    check_file_names as check_file_names,
    file_stems as file_stems,
    path_below as path_below,
)
from palpate.records.text.json_file import json_text as json_text
from palpate.records.text.text_file import read_text as read_text, write_text as write_text
from palpate.records.text.toml_table import TomlTable as TomlTable, read_toml as read_toml
from palpate.records.text.units import (
    FILE_LENGTH_UNITS as FILE_LENGTH_UNITS,
    FORCE_UNITS as FORCE_UNITS,
    LENGTH_UNITS as LENGTH_UNITS,
    MODULUS_UNITS as MODULUS_UNITS,
    STIFFNESS_UNITS as STIFFNESS_UNITS,
    TIME_UNITS as TIME_UNITS,
    Quantity as Quantity,
    quantities as quantities,
    quantity as quantity,
)
