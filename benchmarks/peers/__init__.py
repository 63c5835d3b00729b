"""Other programs, each in an environment of its own.

Purpose    : times of other programs on the same mesh, from the same run.
Takes      : a mesh; the package index, where an environment is to be made.
Gives      : wall times, or the reason why there are none.
Depends on : geometry; `requirements.txt` pins what is installed.
Read first : `environment.py`, `laplace.py`.
"""

from benchmarks.peers.environment import laplace_times

__all__ = ["laplace_times"]
