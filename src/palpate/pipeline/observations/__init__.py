"""Observations of a session's probings, with the responses of their model.

Purpose    : measurement and model of every probing as the one object that the estimation takes, and
             the errors of the mesh; what fits of one body share, before anything is measured.
Takes      : a `Session`, its `ObjectModel`.
Gives      : `ProbeObservations` of the estimation, one for each probing.
Depends on : `pipeline.model`, `pipeline.model.contacts`, `estimation`, `records`, `bem`,
             `geometry`; errors, shapes.
Read first : `session_observations.py`, `converged_observations.py`, then `mesh_errors.py`.
"""
