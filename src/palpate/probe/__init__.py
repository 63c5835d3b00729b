"""Probe: what a tool does to the object, and the plain compression test beside it.

Purpose    : Young's modulus of a cylinder pressed between plates, with an honest interval.
Takes      : shortening and force (arrays, or files of testing machines), diameter, height.
Gives      : `CompressionResult` per specimen, `CompressionSeries` over several.
Depends on : errors, shapes.
Read first : `compression_test.py`.
"""

from palpate.probe.compression_files import (
    CompressionRecord as CompressionRecord,
    metres_from_text as metres_from_text,
    read_compression as read_compression,
)
from palpate.probe.compression_test import (
    CompressionResult as CompressionResult,
    CompressionSeries as CompressionSeries,
    compression_series as compression_series,
    compression_test as compression_test,
    gent_lindley_factor as gent_lindley_factor,
)
from palpate.probe.contact_patch import (
    ContactPatch as ContactPatch,
    find_contact_patch as find_contact_patch,
)
