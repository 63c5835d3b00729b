"""What really happened at the points of a range flow, by the truth beside a facility's session."""

import numpy as np

from palpate.errors import InputError, RecordError
from palpate.paper.motion import rigid_steps
from palpate.records import Session
from palpate.shapes import Points
from palpate.vision import RangeFlow


def true_displacement(session: Session, name: str, flow: RangeFlow) -> Points:
    """True displacement of the points of a range flow.

    Parameters
    ----------
    session : Session               made by the facility: `truth.toml` or truth maps beside its file
    name : str                      of a step after the first, or of a probing
    flow : RangeFlow                of that instant

    Returns
    -------
    (n, 3) float [m]                of a probing: at the pixel nearest to each point; NaN where the
                                    reference camera does not see the object there

    Raises
    ------
    InputError                      no such step or probing
    RecordError                     the truth cannot be read
    """
    if not session.steps:
        return _by_map(session, name, flow)
    names = [step.name for step in session.steps[1:]]
    if name not in names:
        raise InputError(f"there is no step '{name}' after the first; there are {', '.join(names)}")
    motion = rigid_steps(session)[names.index(name)].motion
    return flow.point @ (motion[:3, :3] - np.eye(3)).T + motion[:3, 3]


def _by_map(session: Session, name: str, flow: RangeFlow) -> Points:
    """From the truth map of a probing."""
    known = [probing.name for probing in session.probings]
    if name not in known:
        raise InputError(f"there is no probing '{name}'; there are {', '.join(known)}")
    file = session.path.parent / f"truth_{name}.npz"
    try:
        with np.load(file, allow_pickle=False) as content:
            pixel, moved = content["pixel"], content["U"].astype(float)
            rows, columns = content["shape"].tolist()
    except (OSError, ValueError, KeyError) as error:
        raise RecordError(
            f"{file}: cannot be read as a truth map; make the session anew with `palpate lab`"
        ) from error
    column, row = np.rint(flow.pixel).astype(int).T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    wanted = np.where(inside, row * columns + column, -1)
    place = np.minimum(np.searchsorted(pixel, wanted), len(pixel) - 1)
    return np.where((pixel[place] == wanted)[:, None], moved[place], np.nan)
