"""What commands write on the terminal.

Purpose    : tables, notes and a progress bar that look alike in every command, or as JSON.
Takes      : texts; `Estimate`, `MotionFigures`.
Gives      : rich tables; lines on stdout and stderr.
Depends on : `pipeline`, `records`.
Read first : `tables.py`.
"""
