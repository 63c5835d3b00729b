"""The dent of a half space under a rigid tool, in closed form.

Its depth is A F^(1 - q), with A in proportion to (shear modulus)^(q - 1) and q = 0 under a flat
face, 1/3 under a sphere, whose circle of contact grows with the force.
"""

from dataclasses import replace

from palpate.probe.tool_contact import reduced_modulus
from palpate.records import FlatFace, Sphere, Tool

# A hollow surface counts as at most this share of a sphere's curvature: else it would fit the tool.
_HOLLOW = 0.9


def on_flat(tool: Tool, curvature: float) -> Tool:
    """The tool that dents a flat surface as this one dents a curved one.

    Parameters
    ----------
    tool : Tool                     a ball or a flat round face
    curvature : float [1/m]         mean curvature of the surface, > 0 where it is convex; counts
                                    under a sphere

    Returns
    -------
    Tool

    Source
    ------
    Johnson, Contact Mechanics (1985), equation 4.18
    """
    if tool.is_flat:
        return tool
    return replace(tool, radius=tool.radius / max(1.0 + tool.radius * curvature, 1.0 - _HOLLOW))


def dent(
    tool: Sphere | FlatFace, force: float, *, shear_modulus: float, poisson_ratio: float
) -> float:
    """Depth to which a ball or a flat round face dents a half space (`Sphere.dent`).

    Parameters
    ----------
    tool : Sphere or FlatFace
    force : float [N]               along the inward normal, > 0
    shear_modulus : float [Pa]      > 0
    poisson_ratio : float [-]       -1 < nu <= 0.5

    Returns
    -------
    float [m]
    """
    modulus = reduced_modulus(tool, shear_modulus=shear_modulus, poisson_ratio=poisson_ratio)
    return tool.dent(force / modulus)
