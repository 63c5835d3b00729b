"""Palpate's own files: session.toml, displacement CSV, rig.toml, estimate.json, result folders.

Purpose    : read and write each format in one module, with errors that name file, table and key.
Takes      : paths, and records to write.
Gives      : records in SI units; files and folders that are written completely or not at all.
Depends on : `records.checks`, `records.contacts`, `records.text`, `records.programs`, `geometry`,
             `shapes`, `errors`.
Read first : `session.py`, then `results.py`.
"""

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
from palpate.records.files.rig import (
    read_rig as read_rig,
    write_rig as write_rig,
)
from palpate.records.files.rig_covariance import (
    covariance_file as covariance_file,
    read_rig_covariance as read_rig_covariance,
    write_rig_covariance as write_rig_covariance,
)
from palpate.records.files.session import (
    SESSION_FORMAT as SESSION_FORMAT,
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
    file_sums as file_sums,
    session_files as session_files,
    sums_in as sums_in,
    sums_text as sums_text,
)
from palpate.records.files.support import (
    read_support as read_support,
    read_supports as read_supports,
)
from palpate.records.files.verification import (
    Finding as Finding,
    verify_result as verify_result,
)
