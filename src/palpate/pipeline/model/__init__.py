"""The boundary element model of a session: its object, its supports, and their errors.

Purpose    : one model for all probings, and the observations of each as functions of its solutions.
Takes      : a `Session`.
Gives      : `ObjectModel`, the rows of a probing, motions of supports, nuisance parameters.
Depends on : `pipeline.model.contacts`, `solids`, `bem`, `estimation`, `probe`, `records`,
             `geometry`.
Read first : `object_model.py`, then `shared_errors.py`.
"""
