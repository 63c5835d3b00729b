"""Accuracy and time, measured: one command writes every figure and the page that sums them up.

    python -m benchmarks.run [--part NAME ...] [--only NAME ...] [--quick] [--peers]

Purpose    : every figure of accuracy, honesty and speed, measured on one machine at one commit.
Takes      : the package, the shipped beam, the finite element truth in ../shared/data.
Gives      : figures.csv with all figures, BENCHMARK.md with twenty of them beside their anchors,
             plots/ (a full run, `--part`); or a table on the screen (`--only`, `--quick`).
Depends on : palpate; bempp-cl in an environment of its own where `--peers` is given.
Read first : `run.py` (the list of subjects), `figure.py`, then any subject; `report.py` for the
             page.
"""
