"""Sessions of the virtual facility, their motion measured by each method, and the ground truth."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.files import stored_arrays
from palpate.lab import LabConfig, Material, Variant, make_session
from palpate.pipeline import FLOW_METHODS, MeasuredMotion, SessionFlow, measure_motion
from palpate.progress import Progress, part_of, silent
from palpate.records import Session, TomlTable, read_session, read_toml
from palpate.shapes import Points
from palpate.threads import Distribute
from palpate.vision import RangeFlow

Method = Literal["lang-pai", "joint"]
METHODS: tuple[Method, ...] = ("lang-pai", "joint")
# Fraction of the time for making a session; the rest is for measuring its motion.
_MAKING = 0.5
# Quick runs: largest number of steps or probings, and divisor of the picture size.
_QUICK_STEPS, _QUICK_SHRINK = 3, 2


@dataclass(frozen=True, slots=True, eq=False)
class PaperSession:
    """A session of the facility and its motion by several methods.

    Attributes
    ----------
    session : Session               with `truth.toml` in its folder
    found : mapping                 method -> SessionFlow
    """

    session: Session
    found: Mapping[Method, SessionFlow]

    def motion(self, method: Method, name: str) -> MeasuredMotion:
        """The motion of a step or probing, by one method.

        Parameters
        ----------
        method : str                one of `METHODS` that was measured
        name : str                  of the step or probing

        Returns
        -------
        MeasuredMotion

        Raises
        ------
        InputError                  no motion of that name
        """
        motions = {motion.name: motion for motion in self.found[method].motions}
        if name not in motions:
            raise InputError(f"there is no motion '{name}'; there are {', '.join(motions)}")
        return motions[name]


@dataclass(frozen=True, slots=True, eq=False)
class RigidStep:
    """True motion of a rigid object from the first instant to a later one.

    Attributes
    ----------
    motion : (4, 4) float           x(step) = R x(first) + t, object frame, t in metres
    encoder : float [m]             travel of the stage from its encoder
    """

    motion: Float[np.ndarray, "4 4"]
    encoder: float


def reduced(config: LabConfig) -> LabConfig:
    """Reduced configuration for a quick run: half the picture size, up to three steps or probings.

    The texture is enlarged with the pixels, so that it can be matched equally well.

    Parameters
    ----------
    config : LabConfig

    Returns
    -------
    LabConfig
    """
    head, look, stage = config.head, config.look, config.stage
    small = replace(
        head,
        columns=head.columns // _QUICK_SHRINK,
        rows=head.rows // _QUICK_SHRINK,
        focal=None if head.focal is None else head.focal / _QUICK_SHRINK,
    )
    if stage is not None:
        stage = replace(stage, steps=min(stage.steps, _QUICK_STEPS))
    coarse = replace(look, size=_QUICK_SHRINK * look.size)
    probes = config.probes[:_QUICK_STEPS]
    return replace(config, head=small, look=coarse, stage=stage, probes=probes)


def measured_session(
    config: LabConfig,
    folder: Path,
    *,
    methods: Sequence[Method] = METHODS,
    variant: Variant,
    progress: Progress = silent,
    parts: Path | None = None,
    distribute: Distribute = map,
) -> PaperSession:
    """Make a session in the facility and measure its motion.

    The object's pose in the session is used without refinement.

    Parameters
    ----------
    config : LabConfig
    folder : Path                   an empty folder, in which the session is kept
    methods : sequence of Method
    variant : Variant               of Mitsuba
    progress : callable             called with the current step (text) and the fraction done, 0..1
    parts, distribute               as in `make_session`

    Returns
    -------
    PaperSession

    Raises
    ------
    PalpateError                    as in `make_session` and `measure_motion`
    """
    making = part_of(progress, 0.0, _MAKING)
    make_session(
        config, folder, variant=variant, progress=making, parts=parts, distribute=distribute
    )
    session, found = read_session(folder), {}
    for k, method in enumerate(methods):
        begin, end = (_MAKING + (1.0 - _MAKING) * i / len(methods) for i in (k, k + 1))
        found[method] = measure_motion(
            session,
            method=FLOW_METHODS[method](),
            pose="given",
            progress=part_of(progress, begin, end, prefix=f"{method}: "),
            parts=parts,
        )
    return PaperSession(session, found)


def rigid_steps(session: Session) -> tuple[RigidStep, ...]:
    """True motions of a session's steps after the first, from its `truth.toml`.

    Parameters
    ----------
    session : Session               made by the facility, with steps

    Returns
    -------
    tuple of RigidStep

    Raises
    ------
    RecordError                     no readable `truth.toml`, a step without its motion
    InputError                      a number of steps that differs from the session's
    """
    root = read_toml(session.path.parent / "truth.toml")
    tables = root.tables("step", "[[step]]")
    if len(tables) != len(session.steps):
        raise InputError(
            f"{root.file}: has {len(tables)} steps, the session {len(session.steps)}; they must"
            " come from the same run of the facility: make the session anew"
        )
    start = tables[0].vector("encoder")
    return tuple(
        RigidStep(_motion(table), float(np.linalg.norm(table.vector("encoder") - start)))
        for table in tables[1:]
    )


def true_material(session: Session) -> Material:
    """True constants of the specimen in a session of the facility.

    Parameters
    ----------
    session : Session               with `truth.toml` in its folder

    Returns
    -------
    Material                        the law is not read: always "linear"

    Raises
    ------
    RecordError                     `truth.toml` cannot be read
    """
    truth = read_toml(session.path.parent / "truth.toml")
    return Material(truth.number("young_modulus"), truth.number("poisson_ratio"))


def true_displacement(session: Session, name: str, flow: RangeFlow) -> Points:
    """True displacement of the points of a range flow.

    Parameters
    ----------
    session : Session               made by the facility, with `truth.toml` or truth maps in its
                                    folder
    name : str                      of a step after the first, or of a probing
    flow : RangeFlow                of that instant

    Returns
    -------
    (n, 3) float [m]                in a probing that of the pixel nearest to each point; NaN where
                                    the reference camera does not see the object there

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
    return rigid_displacement(rigid_steps(session)[names.index(name)].motion, flow.point)


def rigid_displacement(motion: Float[np.ndarray, "4 4"], points: Points) -> Points:
    """Displacement of points under a rigid motion.

    Parameters
    ----------
    motion : (4, 4) float           homogeneous matrix, translation in metres
    points : (n, 3) float [m]       positions before the motion

    Returns
    -------
    (n, 3) float [m]
    """
    return points @ (motion[:3, :3] - np.eye(3)).T + motion[:3, 3]


def _by_map(session: Session, name: str, flow: RangeFlow) -> Points:
    """True displacement from the truth map of a probing."""
    known = [probing.name for probing in session.probings]
    if name not in known:
        raise InputError(f"there is no probing '{name}'; there are {', '.join(known)}")
    file = session.path.parent / f"truth_{name}.npz"
    cure = "make the session anew with `palpate lab`"
    with stored_arrays(file, cure, what="cannot be read as a truth map") as content:
        pixel, displacement = content["pixel"], content["U"].astype(float)
        rows, columns = content["shape"].tolist()
    column, row = np.rint(flow.pixel).astype(int).T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    target = np.where(inside, row * columns + column, -1)
    position = np.minimum(np.searchsorted(pixel, target), len(pixel) - 1)
    return np.where((pixel[position] == target)[:, None], displacement[position], np.nan)


def _motion(table: TomlTable) -> Float[np.ndarray, "4 4"]:
    """Rotation and translation of a step."""
    rows = table.get("R")
    if not (isinstance(rows, list) and len(rows) == 3):
        table.fail("R", f"is {rows!r}; must be three rows of three numbers")
    motion = np.eye(4)
    motion[:3, :3] = [TomlTable(table.file, table.name, {"R": row}).vector("R") for row in rows]
    motion[:3, 3] = table.vector("t")
    return motion
