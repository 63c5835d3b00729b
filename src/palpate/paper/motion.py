"""The paper's tests of range flow, tables 1 and 2: measured in the virtual facility, and reduced.

A session is made from a configuration, its motion is measured by the paper's method and by the
default one, and every instant becomes a row of the table's columns. The rows have the types of the
paper's own ones.

Source: Lang and Pai, Estimation of elastic constants from 3D range-flow, 3DIM (2001), section 4.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from palpate.errors import InputError
from palpate.lab import LabConfig, Variant, make_session
from palpate.paper.published import FlowRow, Spread, VertexRow
from palpate.pipeline import FLOW_METHODS, MeasuredMotion, SessionFlow, measure_motion
from palpate.progress import Progress, part_of, silent
from palpate.records import Session, TomlTable, read_session, read_toml
from palpate.shapes import Points, PointScalars, Vector3, Vertices
from palpate.vision import RangeFlow, VertexDisplacement, is_valid

Method = Literal["lang-pai", "joint"]
METHODS: tuple[Method, ...] = ("lang-pai", "joint")
# Share of the time that goes into making a session; measuring it takes the rest.
_MAKING = 0.5
# A quick run: steps, and by how much pictures are smaller.
_QUICK_STEPS, _QUICK_SHRINK = 3, 2


@dataclass(frozen=True, slots=True, eq=False)
class PaperSession:
    """A session of the facility and its motion by several methods.

    Attributes
    ----------
    session : Session               `truth.toml` is beside its file
    found : mapping of method to SessionFlow
    """

    session: Session
    found: Mapping[Method, SessionFlow]


@dataclass(frozen=True, slots=True, eq=False)
class RigidStep:
    """True motion of a rigid object from the first instant to a later one.

    Attributes
    ----------
    motion : (4, 4) float [m]       x(step) = R x(first) + t, object frame
    encoder : float [m]             way of the stage by its encoder
    """

    motion: Float[np.ndarray, "4 4"]
    encoder: float


def quickened(config: LabConfig) -> LabConfig:
    """A configuration for a quick look: half the pixels a side, three steps or probings at most.

    The texture grows with the pixels, so that it can be matched as well.

    Parameters
    ----------
    config : LabConfig
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
    progress: Progress | None = None,
) -> PaperSession:
    """Make a session in the facility and measure its motion.

    The object's pose is taken as the session gives it.

    Parameters
    ----------
    config : LabConfig
    folder : Path                   an empty folder: the session stays there
    methods : sequence of Method
    variant : Variant               of Mitsuba
    progress : callable             told what is done (text) and how far it is (0 to 1)

    Returns
    -------
    PaperSession

    Raises
    ------
    InputError, RecordError         as `make_session` and `measure_motion`
    """
    say = progress or silent
    make_session(config, folder, variant=variant, progress=part_of(say, 0.0, _MAKING))
    session, found = read_session(folder), {}
    for k, method in enumerate(methods):
        begin, end = (_MAKING + (1.0 - _MAKING) * i / len(methods) for i in (k, k + 1))
        found[method] = measure_motion(
            session,
            method=FLOW_METHODS[method](),
            pose="given",
            progress=part_of(say, begin, end, prefix=f"{method}: "),
        )
    return PaperSession(session, found)


def rigid_steps(session: Session) -> tuple[RigidStep, ...]:
    """What the truth beside a session says of its steps after the first.

    Parameters
    ----------
    session : Session               made by the facility, with steps

    Returns
    -------
    tuple of RigidStep

    Raises
    ------
    RecordError                     no `truth.toml` that can be read, a step without its motion
    InputError                      another number of steps than the session's
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


def flow_rows(measured: PaperSession, method: Method) -> tuple[FlowRow, ...]:
    """Table 1 of one method: a row for each step after the first.

    Parameters
    ----------
    measured : PaperSession         of a translation
    method : Method                 one that was measured

    Returns
    -------
    tuple of FlowRow                `command` is the true way: the virtual stage goes where it is
                                    sent. Steps whose pictures could not be used have no points

    Raises
    ------
    RecordError, InputError         as `rigid_steps`
    """
    found = measured.found[method]
    axis = found.rig.cameras[found.rig.reference].T_camera_object[2, :3]
    return tuple(
        flow_row(
            motion.flow,
            axis,
            step=k,
            encoder=true.encoder,
            command=float(np.linalg.norm(true.motion[:3, 3])),
        )
        for k, (motion, true) in enumerate(_instants(measured, method), start=1)
    )


def flow_row(
    flow: RangeFlow | None, axis: Vector3, *, step: int, encoder: float, command: float
) -> FlowRow:
    """A row of table 1 from the range flow of its instant.

    Parameters
    ----------
    flow : RangeFlow or None
    axis : (3,) float [-]           optical axis of the reference camera, unit, object frame
    step, encoder, command          see `FlowRow`
    """
    moved = np.zeros((0, 3)) if flow is None else flow.displacement[is_valid(flow)]
    length = np.linalg.norm(moved, axis=1)
    angle = _angle(moved, np.broadcast_to(axis, moved.shape))
    return FlowRow(step, _spread(angle), _spread(length), encoder, command, len(moved))


def vertex_rows(measured: PaperSession, method: Method) -> tuple[VertexRow, ...]:
    """Table 2 of one method: a row for each step after the first.

    Parameters
    ----------
    measured : PaperSession         of a rigid motion
    method : Method                 one that was measured

    Returns
    -------
    tuple of VertexRow

    Raises
    ------
    RecordError, InputError         as `rigid_steps`
    """
    place = measured.session.mesh.vertices
    return tuple(
        vertex_row(motion.vertices, place, true.motion, step=k)
        for k, (motion, true) in enumerate(_instants(measured, method), start=1)
    )


def vertex_row(
    vertices: VertexDisplacement | None,
    place: Vertices,
    motion: Float[np.ndarray, "4 4"],
    *,
    step: int,
) -> VertexRow:
    """A row of table 2 from the displacement of the vertices at its instant.

    Parameters
    ----------
    vertices : VertexDisplacement or None
    place : (v, 3) float [m]        of the vertices at the first instant
    motion : (4, 4) float [m]       what really happened to them
    step : int

    Returns
    -------
    VertexRow                       a vertex on the axis of a turn has no direction: it counts for
                                    the lengths only
    """
    moved = np.full(place.shape, np.nan) if vertices is None else vertices.displacement
    known = np.isfinite(moved).all(axis=1)
    true = place[known] @ (motion[:3, :3] - np.eye(3)).T + motion[:3, 3]
    return VertexRow(
        step,
        _spread(_angle(moved[known], true)),
        _spread(np.linalg.norm(moved[known], axis=1)),
        _spread(np.linalg.norm(true, axis=1)).mean,
        int(known.sum()),
    )


def _instants(measured: PaperSession, method: Method) -> list[tuple[MeasuredMotion, RigidStep]]:
    """Measured and true motion of each step after the first."""
    found = measured.found[method]
    return list(zip(found.motions, rigid_steps(measured.session), strict=True))


def _motion(table: TomlTable) -> Float[np.ndarray, "4 4"]:
    """Rotation and translation of a step."""
    rows = table.get("R")
    if not (isinstance(rows, list) and len(rows) == 3):
        table.fail("R", f"is {rows!r}; must be three rows of three numbers")
    motion = np.eye(4)
    motion[:3, :3] = [TomlTable(table.file, table.name, {"R": row}).vector("R") for row in rows]
    motion[:3, 3] = table.vector("t")
    return motion


def _angle(vectors: Points, others: Points) -> PointScalars:
    """Angle between rows [rad]; NaN where one of them is zero."""
    # Not from the cosine, which knows no angle below 1e-8.
    across = np.linalg.norm(np.cross(vectors, others), axis=1)
    along = np.einsum("na,na->n", vectors, others)
    lost = (across == 0.0) & (along == 0.0)
    return np.where(lost, np.nan, np.arctan2(across, along))


def _spread(values: PointScalars) -> Spread:
    """Mean and standard deviation of what is known."""
    known = values[np.isfinite(values)]
    if len(known) == 0:
        return Spread(np.nan, np.nan)
    return Spread(float(known.mean()), float(known.std()))
