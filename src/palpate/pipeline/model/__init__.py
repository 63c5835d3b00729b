"""The boundary element model of a session: its object, its supports, and their errors.

Purpose    : one model for all probings, and the observations of each as functions of its solutions.
Takes      : a `Session`.
Gives      : `ObjectModel`, the rows of a probing, motions of supports, loads of a tool's contact
             with its errors, nuisance parameters.
Depends on : `solids`, `bem`, `vision`, `estimation`, `probe`, `records`, `geometry`.
Read first : `object_model.py`, then `shared_errors.py`.
"""
