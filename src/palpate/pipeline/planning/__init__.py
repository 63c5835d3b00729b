"""What to measure, and what to expect of it, before it is measured.

Purpose    : expected precision of probings still to be made, and the most informative next places.
Takes      : a `Session`, with a guess of its constants or with measurements.
Gives      : `MeasurementPlan`, `NextProbings`.
Depends on : `pipeline.model`, `pipeline.model.contacts`, `pipeline.motion`,
             `pipeline.observations`, `lab`, `estimation`, `vision`, `records`, `geometry`.
Read first : `measurement_plan.py`, then `next_probings.py`.
"""
