"""The command line: thin, no numerics.

Purpose    : `palpate fit`, `palpate check`, `palpate compression`; tables, plots, result folders.
Takes      : arguments of a shell.
Gives      : text on the terminal, a result folder, an exit code (0, 2 bad input, 3 not ok).
Depends on : `pipeline`, `estimation`, `probe`, `records`, `geometry`, `errors`.
Read first : `cli.py`, then `fit_command.py`.

Nothing is imported here: `palpate --help` must not load the numerics.
"""
