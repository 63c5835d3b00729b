"""Contact of a tool with the object, and the uniaxial compression test of a cylinder.

Purpose    : the triangles under a tool and the pressure there; the contact of a tool;
             Young's modulus of a compressed cylinder, with a 95 % interval.
Takes      : a mesh and a `Contact`; files of testing machines, or shortening and force.
Gives      : `ContactPatch`, `ToolContact`, `dent`; `CompressionResult` per specimen,
             `CompressionSeries` over several.
Depends on : `records`, `geometry`, `shapes`, `errors`.
Read first : `contact_patch.py`, `tool_contact.py`, then `compression_test.py`.
"""

from palpate.probe.compression_files import (
    CompressionRecord as CompressionRecord,
    metres_from_text as metres_from_text,
    read_compression as read_compression,
)
from palpate.probe.compression_test import (
    CompressionResult as CompressionResult,
    compression_series as compression_series,
    compression_test as compression_test,
    gent_lindley_factor as gent_lindley_factor,
)
from palpate.probe.contact_patch import (
    ContactPatch as ContactPatch,
    find_contact_patch as find_contact_patch,
    named_tangents as named_tangents,
)
from palpate.probe.indentation import (
    dent as dent,
    on_flat as on_flat,
)
from palpate.probe.tool_contact import (
    LocalSurface as LocalSurface,
    ToolContact as ToolContact,
    local_surface as local_surface,
    tool_contact as tool_contact,
)
