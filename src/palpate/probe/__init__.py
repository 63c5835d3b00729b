"""Probe: what a tool does to the object, and the plain compression test beside it.

Purpose    : Young's modulus of a cylinder pressed between plates, with an honest interval.
Takes      : shortening and force (arrays, or files of testing machines), diameter, height.
Gives      : `CompressionResult` per specimen, `CompressionSeries` over several.
Depends on : errors, shapes.
Read first : `compression_test.py`.
"""

from palpate.probe.compression_files import (
    CompressionRecord,
    metres_from_text,
    read_compression,
)
from palpate.probe.compression_test import (
    CompressionResult,
    CompressionSeries,
    compression_series,
    compression_test,
    gent_lindley_factor,
)
from palpate.probe.contact_patch import ContactPatch, find_contact_patch

__all__ = [
    "CompressionRecord",
    "CompressionResult",
    "CompressionSeries",
    "ContactPatch",
    "compression_series",
    "compression_test",
    "find_contact_patch",
    "gent_lindley_factor",
    "metres_from_text",
    "read_compression",
]
