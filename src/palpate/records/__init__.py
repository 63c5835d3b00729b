"""Records of measurements and estimates that are passed between rooms, and their files.

Purpose    : frozen dataclasses that validate themselves, with their readers and writers.
Takes      : session folders, displacement CSV, rig.toml, estimate.json, files of other programs.
Gives      : `Session`, `Probing`, `Contact`, `DisplacementField`, `Rig`, `Estimate`, in SI units.
Depends on : `geometry`, `arrays`, `optional_imports`, `shapes`, `errors`.
Read first : `probing.py`, `session.py`, then `files/session.py`.
"""

from palpate.records.contact import (
    RIGID as RIGID,
    SPREAD as SPREAD,
    Contact as Contact,
    GridTraction as GridTraction,
    Pressure as Pressure,
    ToolTraction as ToolTraction,
    grid_traction as grid_traction,
)
from palpate.records.error_priors import EXACT as EXACT, ErrorPriors as ErrorPriors
from palpate.records.estimate import (
    BIASED as BIASED,
    CONSTANT_NAMES as CONSTANT_NAMES,
    HALF_95 as HALF_95,
    IMPOSSIBLE as IMPOSSIBLE,
    SURPRISING as SURPRISING,
    BudgetEntry as BudgetEntry,
    Constant as Constant,
    ErrorEstimate as ErrorEstimate,
    Estimate as Estimate,
    LoadDependence as LoadDependence,
    LossPoint as LossPoint,
    ProbeEstimate as ProbeEstimate,
    RegionEstimate as RegionEstimate,
    RelaxationEstimate as RelaxationEstimate,
    RelaxationPoint as RelaxationPoint,
    RelaxationTerm as RelaxationTerm,
    Status as Status,
    SupportEstimate as SupportEstimate,
)
from palpate.records.files.displacement import (
    displacement_text as displacement_text,
    read_displacement as read_displacement,
    write_displacement as write_displacement,
)
from palpate.records.files.estimate import (
    read_estimate as read_estimate,
    write_estimate as write_estimate,
)
from palpate.records.files.results import (
    INPUTS_FILE as INPUTS_FILE,
    REPORT_FILE as REPORT_FILE,
    check_fit_result as check_fit_result,
    check_free as check_free,
    default_folder as default_folder,
    disk_errors as disk_errors,
    file_sum as file_sum,
    file_sums as file_sums,
    folder_changes as folder_changes,
    parts_folder as parts_folder,
    record_inputs as record_inputs,
    result_folder as result_folder,
    session_files as session_files,
    sums_in as sums_in,
    sums_text as sums_text,
)
from palpate.records.files.session import (
    SESSION_FORMAT as SESSION_FORMAT,
    ImportItem as ImportItem,
    displacement_line as displacement_line,
    import_plan as import_plan,
    named_displacements as named_displacements,
    read_object_mesh as read_object_mesh,
    read_session as read_session,
    with_displacements as with_displacements,
)
from palpate.records.load_checks import copied_rows as copied_rows
from palpate.records.measured_points import (
    ImportedField as ImportedField,
    MeasuredPoints as MeasuredPoints,
    in_object_frame as in_object_frame,
    on_surface as on_surface,
    read_import_pose as read_import_pose,
)
from palpate.records.modulus_field import (
    FieldEstimate as FieldEstimate,
    ModulusMap as ModulusMap,
    StiffPart as StiffPart,
)
from palpate.records.probing import (
    INDEPENDENT as INDEPENDENT,
    DisplacementField as DisplacementField,
    Images as Images,
    Load as Load,
    PointCorrelation as PointCorrelation,
    Probing as Probing,
    SurfaceAverage as SurfaceAverage,
    lengths as lengths,
    measured_rows as measured_rows,
    observed_rows as observed_rows,
)
from palpate.records.program import (
    ProgramPoints as ProgramPoints,
    camera_matrix as camera_matrix,
    make_pose as make_pose,
)
from palpate.records.programs.poke_table import (
    PokeTable as PokeTable,
    read_poke_table as read_poke_table,
)
from palpate.records.programs.registry import (
    import_kinds as import_kinds,
    kinds_text as kinds_text,
    read_measured as read_measured,
    read_rig as read_rig,
    write_rig as write_rig,
)
from palpate.records.quantities import (
    FILE_LENGTH_UNITS as FILE_LENGTH_UNITS,
    FORCE_UNITS as FORCE_UNITS,
    HIGHEST_PRESSURE as HIGHEST_PRESSURE,
    LENGTH_UNITS as LENGTH_UNITS,
    MODULUS_RANGE as MODULUS_RANGE,
    MODULUS_UNITS as MODULUS_UNITS,
    NOT_DETERMINED as NOT_DETERMINED,
    STIFFNESS_UNITS as STIFFNESS_UNITS,
    TIME_UNITS as TIME_UNITS,
    Quantity as Quantity,
    budget_text as budget_text,
    constant_row as constant_row,
    constant_text as constant_text,
    error_texts as error_texts,
    interval_text as interval_text,
    law_rows as law_rows,
    length_unit as length_unit,
    load_text as load_text,
    modulus_unit as modulus_unit,
    quantities as quantities,
    quantity as quantity,
    region_row as region_row,
    relaxation_rows as relaxation_rows,
    stiffening_text as stiffening_text,
    value_text as value_text,
    verdict_text as verdict_text,
)
from palpate.records.reciprocity import (
    ForceExcess as ForceExcess,
    Reciprocity as Reciprocity,
    WorkPair as WorkPair,
)
from palpate.records.region import (
    RATIO as RATIO,
    YOUNG as YOUNG,
    Box as Box,
    Insert as Insert,
    Layer as Layer,
    Region as Region,
    Skin as Skin,
)
from palpate.records.rig import (
    DISTORTION_TERMS as DISTORTION_TERMS,
    Camera as Camera,
    PictureTracks as PictureTracks,
    Rig as Rig,
    RigCovariance as RigCovariance,
    camera_centre as camera_centre,
    covariance_file as covariance_file,
    lens_radius_limit as lens_radius_limit,
    picture_size as picture_size,
    read_rig_covariance as read_rig_covariance,
    write_rig_covariance as write_rig_covariance,
)
from palpate.records.series import Series as Series
from palpate.records.session import (
    Session as Session,
    Step as Step,
    require_probings as require_probings,
    without_pictures as without_pictures,
)
from palpate.records.support import (
    FIXED as FIXED,
    FREE as FREE,
    GIVEN as GIVEN,
    HeldObject as HeldObject,
    RigidMotion as RigidMotion,
    Support as Support,
    read_support as read_support,
    read_supports as read_supports,
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
from palpate.records.text.text_file import (
    check_file_names as check_file_names,
    file_stems as file_stems,
    path_below as path_below,
    read_text as read_text,
    write_text as write_text,
)
from palpate.records.text.toml_table import (
    TomlTable as TomlTable,
    json_text as json_text,
    nearest_file as nearest_file,
    read_toml as read_toml,
)
from palpate.records.tools import (
    FRICTIONS as FRICTIONS,
    SLIDES as SLIDES,
    STICKS as STICKS,
    TOOLS as TOOLS,
    Cone as Cone,
    ConvexMesh as ConvexMesh,
    FlatFace as FlatFace,
    Ring as Ring,
    RoundTool as RoundTool,
    ShapedTool as ShapedTool,
    Sphere as Sphere,
    Tool as Tool,
    mesh_tool as mesh_tool,
)
