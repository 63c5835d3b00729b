"""A motion stage: rigid steps of an object."""

import cv2
import numpy as np
from jaxtyping import Float

from palpate.lab.config import Stage


def stage_motions(stage: Stage) -> Float[np.ndarray, "s 4 4"]:
    """Motion of the object from the first instant to each, the first included.

    Parameters
    ----------
    stage : Stage                   s - 1 steps

    Returns
    -------
    (s, 4, 4) float [m]             x(step) = R x(first) + t, object frame
    """
    axis = stage.axis / np.linalg.norm(stage.axis)
    motions = np.tile(np.eye(4), (stage.steps + 1, 1, 1))
    for k, motion in enumerate(motions):
        turn = cv2.Rodrigues(np.deg2rad(k * stage.rotation) * axis)[0]
        motion[:3, :3] = turn
        motion[:3, 3] = stage.centre - turn @ stage.centre + k * stage.translation
    return motions
