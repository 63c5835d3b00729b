"""Generic file formats: TOML with errors that name the key, tables, XML and YAML, MATLAB, HDF5.

Purpose    : one reader for each file format, whichever program wrote the file.
Takes      : paths.
Gives      : `TomlTable`, `TextTable`, whole texts.
Depends on : `optional_imports`, `shapes`, `files`, `errors`.
Read first : `toml_table.py`, then `csv_table.py`.
"""
