"""Accuracy and time, measured: one command writes BENCHMARK.md.

    python -m benchmarks.run [--only NAME ...] [--quick] [--peers]

Purpose    : every figure that is asked of the instrument, measured on one machine at one commit.
Takes      : the package, the shipped beam, the finite element truth in ../shared/data.
Gives      : BENCHMARK.md (a full run) or a table on the screen (`--only`, `--quick`).
Depends on : palpate; bempp-cl in an environment of its own where `--peers` is given.
Read first : `run.py` (the list of subjects), `figure.py`, then any subject.
"""
