"""How measured displacements and forces scatter about the truth.

Purpose    : loss and robust weights of each noise model, and noise levels from the residuals.
Takes      : squared residuals in sigmas with their numbers of components; residuals of probings.
Gives      : `NoiseModel` (a protocol), `StudentT`, `Gaussian`, moments of their scores, levels.
Depends on : nothing but the ground floor; the observations of its room.
Read first : `noise_model.py`, then `levels.py`.
"""

from palpate.estimation.noise.gaussian import Gaussian as Gaussian
from palpate.estimation.noise.levels import noise_levels as noise_levels
from palpate.estimation.noise.noise_model import (
    NoiseModel as NoiseModel,
    gaussian_moments as gaussian_moments,
    relative_weight as relative_weight,
    score_moments as score_moments,
)
from palpate.estimation.noise.registry import NOISE_MODELS as NOISE_MODELS
