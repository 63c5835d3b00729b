"""Commands that put an estimate to use.

Purpose    : read what a command needs, have it made, print what was done.
Takes      : arguments of the command line, already of the right types.
Gives      : an exit code; folders for simulators; a viewer, pictures, films.
Depends on : `app.terminal`, `viewer`, `simulation`, `records`.
Read first : `export.py`.

Nothing is imported here: `palpate --help` must not load the numerics.
"""
