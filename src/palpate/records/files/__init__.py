"""files."""

from palpate.records.files.displacement import (
    read_displacement as read_displacement,
    write_displacement as write_displacement,
)
from palpate.records.files.estimate import (
    ESTIMATE_FORMAT as ESTIMATE_FORMAT,
    read_estimate as read_estimate,
    write_estimate as write_estimate,
)
from palpate.records.files.placed import placed_files as placed_files
from palpate.records.files.result_folder import (
    default_folder as default_folder,
    disk_errors as disk_errors,
    result_folder as result_folder,
)
from palpate.records.files.rig import (
    read_rig as read_rig,
    rig_to_toml as rig_to_toml,
    write_rig as write_rig,
)
from palpate.records.files.session import (
    SESSION_FORMAT as SESSION_FORMAT,
    read_session as read_session,
)
from palpate.records.files.session_edit import (
    displacement_line as displacement_line,
    with_displacements as with_displacements,
)
from palpate.records.files.session_outline import (
    ImportItem as ImportItem,
    SessionOutline as SessionOutline,
    import_plan as import_plan,
    read_session_outline as read_session_outline,
)
