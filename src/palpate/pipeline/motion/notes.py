"""Notes on measured motions that look wrong: a surface without texture, images out of order."""

from collections.abc import Mapping

import numpy as np

from palpate.vision import Outcome, RangeFlow

# A few points without texture are at outlines or blots; a larger fraction means a surface without
# speckle.
_MAX_TEXTURELESS = 0.1
# An earlier image with more than this many times the motion of the last one is out of order.
_MAX_EARLIER_MOTION = 1.2


def texture_notes(name: str, flow: RangeFlow) -> tuple[str, ...]:
    """A note on where the surface has too little texture to be tracked, and how much it needs.

    Parameters
    ----------
    name : str                      of the motion
    flow : RangeFlow

    Returns
    -------
    tuple of str                    empty if hardly any points lack texture
    """
    poor = flow.outcome == Outcome.TEXTURE
    if len(poor) == 0 or poor.mean() <= _MAX_TEXTURELESS:
        return ()
    column, row = np.median(flow.pixel[poor], axis=0)
    needed = 3.0 * float(np.max(flow.noise))
    note = (
        f"'{name}': {100 * poor.mean():.0f} % of the points have too little texture to be followed"
        f" (around column {column:.0f}, row {row:.0f} of the reference camera); a window of"
        f" {flow.subset} px needs grey levels that vary by {needed:.1f} or more (1 sigma): speckle"
        " the surface, or light it better"
    )
    return (note,)


def order_notes(probing: str, sizes: Mapping[str, float]) -> tuple[str, ...]:
    """Notes where an earlier image of a probing shows more motion than the last one.

    Parameters
    ----------
    probing : str                   its name
    sizes : mapping of str to float [m]     name of every motion of the probing, the last at full
                                    force, to its `typical_motion`

    Returns
    -------
    tuple of str
    """
    *earlier, (_, last) = sizes.items()
    return tuple(
        f"probing '{probing}': image '{name}' shows more motion"
        f" ({1e3 * size:.3g} mm) than the last one ({1e3 * last:.3g} mm), which must be"
        " the one at full force; is their order right?"
        for name, size in earlier
        if size > _MAX_EARLIER_MOTION * last
    )


def typical_motion(flow: RangeFlow) -> float:
    """Root mean square of the displacement over the valid points.

    Parameters
    ----------
    flow : RangeFlow

    Returns
    -------
    float [m]                       0 if no point is valid
    """
    square = np.nansum(flow.displacement**2, axis=1)[np.isfinite(flow.displacement[:, 0])]
    return float(np.sqrt(square.mean())) if len(square) else 0.0
