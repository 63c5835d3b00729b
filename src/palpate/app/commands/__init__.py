"""The commands, a file for each subject.

Purpose    : read what a command needs, call the pipeline, print and write what it gives.
Takes      : arguments of the command line, already of the right types.
Gives      : an exit code.
Depends on : `paper`, `report`, `viewer`, `campaign`, `bench`, `figures`, `simulation`,
             `pipeline`, `calibration`, `scanning`, `recording`, `lab`, `field`, `estimation`,
             `bem`, `probe`, `records`, `geometry`.
Read first : `fit.py`.

Nothing is imported here: `palpate --help` must not load the numerics.
"""
