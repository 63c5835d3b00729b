"""Bodies that creep: compliance and modulus as functions of time, from motion under a known force.

Purpose    : respond to any force exactly, choose the number of terms, convert creep to relaxation.
Takes      : arrays: times, forces, and the motion at some instants (`Motion`).
Gives      : `CreepCompliance`, `RelaxationModulus`, `CreepFit` with its covariance.
Depends on : nothing.
Read first : `creep.py`, then `creep_fit.py`.
"""

from palpate.relaxation.creep import (
    CreepCompliance as CreepCompliance,
    memory as memory,
)
from palpate.relaxation.creep_fit import (
    CreepFit as CreepFit,
    Motion as Motion,
    fit_creep as fit_creep,
)
