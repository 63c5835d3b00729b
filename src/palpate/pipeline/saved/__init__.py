"""What a result keeps of a fit besides its numbers, and how the next fit takes it up.

Purpose    : the measured motion, reused for the same pictures; measured and predicted surfaces
             for reports and other programs.
Takes      : a `Session`, a `FitResult`, a result folder.
Gives      : `motion.npz` and `surface.npz`, and what is read back from them.
Depends on : `pipeline.motion`, `estimation`, `geometry`, `records`, `vision`.
Read first : `motion.py`, then `fitted_surface.py`.
"""

from palpate.pipeline.saved.fitted_surface import (
    SURFACE_FILE as SURFACE_FILE,
    FittedProbing as FittedProbing,
    FittedSurface as FittedSurface,
    read_fitted_surface as read_fitted_surface,
    write_fitted_surface as write_fitted_surface,
)
from palpate.pipeline.saved.motion import (
    MOTION_FILE as MOTION_FILE,
    keep_motion as keep_motion,
    kept_motion as kept_motion,
    kept_motion_keys as kept_motion_keys,
)
