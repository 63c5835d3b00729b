"""What a result keeps of a fit besides its numbers, and how the next fit takes it up.

Purpose    : the measured motion, reused for the same pictures; measured and predicted surfaces
             for reports and other programs.
Takes      : a `Session`, a `FitResult`, a result folder.
Gives      : `motion.npz` and `surface.npz`, and what is read back from them.
Depends on : `pipeline.motion`, `estimation`, `geometry`, `records`, `vision`.
Read first : `motion.py`, then `fitted_surface.py`.
"""
