"""Commands that make a session of what a bench has: recordings, or a folder of files.

Purpose    : read what a command needs, have the session made, print what was found.
Takes      : arguments of the command line, already of the right types.
Gives      : an exit code; a session folder, session.toml or recording.toml; a rig before an object;
             the recordings of the tutorial.
Depends on : `app.terminal`, `figures`, `recording`, `calibration`, `lab`, `geometry`,
             `records`.
Read first : `record.py`.

Nothing is imported here: `palpate --help` must not load the numerics.
"""
