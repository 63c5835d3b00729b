"""Palpate's own files: session.toml, displacement CSV, rig.toml, estimate.json, result folders.

Purpose    : read and write each format in one module, with errors that name file, table and key.
Takes      : paths, and records to write.
Gives      : records in SI units; files and folders that are written completely or not at all.
Depends on : `records.text`, `geometry`, `shapes`, `errors`.
Read first : `session.py`, then `results.py`.
"""
