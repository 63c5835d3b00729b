"""Generic file formats: TOML with errors that name the key, tables, XML and YAML, MATLAB, HDF5.

Purpose    : one reader for each file format, whichever program wrote the file.
Takes      : paths.
Gives      : `TomlTable`, `TextTable`, whole texts.
Depends on : `optional_imports`, `shapes`, `files`, `errors`.
Read first : `toml_table.py`, then `csv_table.py`.
"""

from palpate.records.text.csv_table import (
    Column as Column,
    TextTable as TextTable,
    make_table as make_table,
    missing_depth as missing_depth,
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
from palpate.records.text.hdf5 import (
    HDF5_SIGNATURE as HDF5_SIGNATURE,
    checked_size as checked_size,
    open_hdf5 as open_hdf5,
)
from palpate.records.text.json_file import json_text as json_text, read_json as read_json
from palpate.records.text.mat_file import open_mat as open_mat, read_mat as read_mat
from palpate.records.text.nearest import (
    nearest_file as nearest_file,
    nearest_word as nearest_word,
    not_allowed as not_allowed,
)
from palpate.records.text.text_file import read_text as read_text, write_text as write_text
from palpate.records.text.toml_table import (
    TomlTable as TomlTable,
    is_list_of as is_list_of,
    read_toml as read_toml,
)
from palpate.records.text.tree_file import TREE_SUFFIXES as TREE_SUFFIXES, read_tree as read_tree
from palpate.records.text.units import (
    ANGLE_UNITS as ANGLE_UNITS,
    COMPLIANCE_UNITS as COMPLIANCE_UNITS,
    FILE_LENGTH_UNITS as FILE_LENGTH_UNITS,
    FORCE_UNITS as FORCE_UNITS,
    LENGTH_UNITS as LENGTH_UNITS,
    MODULUS_UNITS as MODULUS_UNITS,
    STIFFNESS_UNITS as STIFFNESS_UNITS,
    TIME_UNITS as TIME_UNITS,
    Quantity as Quantity,
    quantities as quantities,
    quantity as quantity,
    unit_name as unit_name,
)
