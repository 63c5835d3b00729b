"""Noise models by the name that settings use; a new one is one new file and its line here."""

from palpate.estimation.noise.gaussian import Gaussian
from palpate.estimation.noise.noise_model import NoiseModel
from palpate.estimation.noise.student_t import StudentT

NOISE_MODELS: dict[str, NoiseModel] = {
    "student-t": StudentT(degrees=8.0),
    "gaussian": Gaussian(),
}
