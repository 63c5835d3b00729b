"""What the kernels of contact work on: tools as arrays, and what is known of every node.

Vectors are in the object's frame unless said otherwise. A force is that of the tool on the node.
"""

from typing import NamedTuple

import numpy as np

# States of a node.
OPEN, SLIDES, STICKS = 0, 1, 2
# What is given of a node in the response.
ABSENT, BY_FORCE, BY_DISPLACEMENT = 0, 1, 2
# Kinds of tools.
SPHERE, FACES = 0, 1
# Of the largest force: what is less than nothing by so little is nothing.
ROUNDING = 1e-12
# Coefficients of friction from which on nothing slides.
NO_SLIP = 1e9


class Nodal(NamedTuple):
    """What is known of all n nodes; the kernels change it in place.

    Attributes
    ----------
    force, displacement : (n, 3) float [N], [m]
    tool_of, face, status, given : (n,) int         as in `ContactState`
    anchor, normal, slide : (n, 3) float
    gap : (n,) float [m]
    """

    force: np.ndarray
    displacement: np.ndarray
    tool_of: np.ndarray
    face: np.ndarray
    status: np.ndarray
    given: np.ndarray
    anchor: np.ndarray
    normal: np.ndarray
    slide: np.ndarray
    gap: np.ndarray


class ToolArrays(NamedTuple):
    """Tools as the kernels see them; `planes` are those of all tools, one after the other.

    Attributes
    ----------
    kind, start : (t,), (t + 1,) int
    radius, bounding_radius : (t,) float [m]    of the sphere; of a ball about the position that
                                        holds the tool
    planes : (p, 4) float               outward normal, and the offset along it [m]
    friction : (t,) float               coefficient; 0 slides freely, infinite sticks
    position, rotation : (t, 3), (t, 3, 3)   pose; a point y of the tool is at position + rotation y
    previous_position, previous_rotation    the pose at the tick before
    """

    kind: np.ndarray
    start: np.ndarray
    radius: np.ndarray
    bounding_radius: np.ndarray
    planes: np.ndarray
    friction: np.ndarray
    position: np.ndarray
    rotation: np.ndarray
    previous_position: np.ndarray
    previous_rotation: np.ndarray
