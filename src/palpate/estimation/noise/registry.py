"""Noise models by their name in the settings; a new one needs its own file and a line here."""

from palpate.estimation.noise.gaussian import Gaussian
from palpate.estimation.noise.noise_model import NoiseModel
from palpate.estimation.noise.student_t import StudentT

NOISE_MODELS: dict[str, NoiseModel] = {
    "student-t": StudentT(degrees=8.0),
    "gaussian": Gaussian(),
}
