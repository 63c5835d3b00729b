"""Figures of measured motions: a table for the terminal, and flow.json."""

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from rich.box import SIMPLE_HEAD
from rich.markup import escape
from rich.table import Table

from palpate.records import Camera, Rig
from palpate.shapes import Flags, PointScalars
from palpate.vision import Outcome, RangeFlow, VertexDisplacement, is_valid

__all__ = [
    "FLOW_FORMAT",
    "MotionFigures",
    "camera_sigma",
    "cause_counts",
    "failed_figures",
    "flow_table",
    "length_unit",
    "measured_vertices",
    "motion_figures",
    "write_flow_document",
]

FLOW_FORMAT = "palpate-flow/1"
_SHORT = {"reprojection": "reproj.", "neighbours": "neighb."}
CAUSES = tuple(outcome for outcome in Outcome if outcome is not Outcome.VALID)


@dataclass(frozen=True, slots=True)
class MotionFigures:
    """What can be said about one measured motion in a line.

    Attributes
    ----------
    name : str
    probing : str or None           that it belongs to; None for a step of a sequence
    last : bool                     at the full force, or a step
    failure : str or None           why there is no motion, or no displacement of the vertices
    points, valid : int             of the range flow
    rejected : dict of str to int   points by cause, every cause in the order of `Outcome`
    vertices : int                  of the mesh, seen by the reference camera
    measured : int                  of these, with a displacement
    lateral, depth : float [m]      median 1 sigma of a valid point, see `camera_sigma`; NaN: none
    vertex_lateral, vertex_depth : float [m]    the same of the measured vertices
    displacement : float [m]        median length over the valid points; NaN: none
    reprojection : float [px]       median over the valid points; NaN: none
    through_last : int              valid points followed through the instant before
    drift : float [m]               rms difference between that way and the direct one; NaN: unknown
    noise : tuple of c float [grey levels]      of each camera, in the rig's order
    """

    name: str
    probing: str | None
    last: bool
    failure: str | None
    points: int
    valid: int
    rejected: Mapping[str, int]
    vertices: int
    measured: int
    lateral: float
    depth: float
    vertex_lateral: float
    vertex_depth: float
    displacement: float
    reprojection: float
    through_last: int
    drift: float
    noise: tuple[float, ...]


def camera_sigma(
    covariance: Float[np.ndarray, "n 3 3"], camera: Camera
) -> tuple[PointScalars, PointScalars]:
    """Standard deviations across and along the axis of a camera.

    Parameters
    ----------
    covariance : (n, 3, 3) float [m^2]  object frame
    camera : Camera

    Returns
    -------
    lateral : (n,) float [m]        rms of the components to the right and down
    depth : (n,) float [m]          component along the optical axis
    """
    rotation = camera.T_camera_object[:3, :3]
    variance = np.einsum("ai,nij,aj->na", rotation, covariance, rotation)
    return np.sqrt(0.5 * (variance[:, 0] + variance[:, 1])), np.sqrt(variance[:, 2])


def cause_counts(flow: RangeFlow) -> dict[str, int]:
    """How many points were rejected for each cause, by its name in lower case; zeros included."""
    return {cause.name.lower(): int((flow.outcome == cause).sum()) for cause in CAUSES}


def measured_vertices(vertices: VertexDisplacement) -> Flags:
    """True for vertices that have a displacement, (v,) bool."""
    return np.isfinite(vertices.displacement).all(axis=1)


def motion_figures(
    name: str,
    flow: RangeFlow,
    vertices: VertexDisplacement | None,
    *,
    seen: Flags,
    camera: Camera,
) -> MotionFigures:
    """Counts and medians of one motion, taken for a step that did not fail.

    Parameters
    ----------
    name : str
    flow : RangeFlow
    vertices : VertexDisplacement or None   None: not one vertex has a displacement
    seen : (v,) bool                vertices that the reference camera sees
    camera : Camera                 the reference camera
    """
    valid = is_valid(flow)
    lateral, depth = camera_sigma(flow.covariance[valid], camera)
    vertex_lateral = vertex_depth = np.zeros(0)
    measured = 0
    if vertices is not None:
        known = measured_vertices(vertices)
        measured = int(known.sum())
        seen = seen | known
        vertex_lateral, vertex_depth = camera_sigma(vertices.covariance[known], camera)
    return MotionFigures(
        name=name,
        probing=None,
        last=True,
        failure=None,
        points=len(valid),
        valid=int(valid.sum()),
        rejected=cause_counts(flow),
        vertices=int(seen.sum()),
        measured=measured,
        lateral=_median(lateral),
        depth=_median(depth),
        vertex_lateral=_median(vertex_lateral),
        vertex_depth=_median(vertex_depth),
        displacement=_median(np.linalg.norm(flow.displacement[valid], axis=1)),
        reprojection=_median(flow.reprojection[valid]),
        through_last=int(flow.through_last[valid].sum()),
        drift=float(flow.drift),
        noise=tuple(float(level) for level in flow.noise),
    )


def failed_figures(name: str, cameras: int) -> MotionFigures:
    """Figures of a motion that could not be measured at all, with some number of cameras."""
    blank = math.nan
    return MotionFigures(
        name=name,
        probing=None,
        last=True,
        failure="nothing was measured",
        points=0,
        valid=0,
        rejected={cause.name.lower(): 0 for cause in CAUSES},
        vertices=0,
        measured=0,
        lateral=blank,
        depth=blank,
        vertex_lateral=blank,
        vertex_depth=blank,
        displacement=blank,
        reprojection=blank,
        through_last=0,
        drift=blank,
        noise=(blank,) * cameras,
    )


def length_unit(length: float) -> tuple[float, str]:
    """Unit in which a length has one to three digits before the point: (metres a unit, name)."""
    size = abs(length) if math.isfinite(length) else 0.0
    return (1e-6, "µm") if size < 0.1e-3 else (1e-3, "mm")


def flow_table(figures: Sequence[MotionFigures], rig: Rig) -> Table:
    """A line for every motion: points, rejected by cause, sigma, noise, reprojection error."""
    factor, unit = length_unit(_median(np.array([f.depth for f in figures])))
    table = Table(
        title="Measured motion", box=SIMPLE_HEAD, padding=(0, 1, 0, 0), pad_edge=False,
        caption_justify="left",
    )  # fmt: skip
    table.add_column("name", no_wrap=True, min_width=4)
    table.add_column("points", justify="right", no_wrap=True)
    table.add_column("valid\n%", justify="right", no_wrap=True)
    # On a narrow terminal these two take several lines; no cause with its count is longer.
    table.add_column("rejected", overflow="fold", min_width=13)
    table.add_column("noise\ngrey", overflow="fold", min_width=5)
    for heading in (f"1 sigma\n{unit}", "reproj.\npx", "vertices"):
        table.add_column(heading, justify="right", no_wrap=True)
    for f in figures:
        if f.points == 0:
            table.add_row(escape(f.name), "-", "-", "failed", "-", "-", "-", "-")
            continue
        table.add_row(
            escape(f.name),
            str(f.points),
            f"{100.0 * f.valid / f.points:.1f}",
            _causes(f),
            " ".join(f"{level:.1f}" if math.isfinite(level) else "-" for level in f.noise),
            f"{_number(f.lateral / factor, 2)}, {_number(f.depth / factor, 2)}",
            _number(f.reprojection, 2),
            f"{f.measured}/{f.vertices}",
        )
    cameras = escape(", ".join(camera.name for camera in rig.cameras))
    table.caption = (
        f"noise: of a pixel in {cameras}; 1 sigma: median over the valid points, across and along"
        " the axis of the reference camera; reproj.: median over them; vertices: with a"
        " displacement, of those looked at"
    )
    return table


def write_flow_document(
    path: Path,
    figures: Sequence[MotionFigures],
    files: Sequence[Mapping[str, str]],
    rig: Rig,
    heading: Mapping[str, Any],
) -> None:
    """Write flow.json: all figures in SI units; what is not known (NaN) becomes null.

    Parameters
    ----------
    path : Path
    figures : sequence of k MotionFigures
    files : sequence of k mappings  what was written for each: kind to file name
    rig : Rig
    heading : mapping               further keys of the document, values that JSON knows

    Raises
    ------
    OSError                         the file cannot be written
    """
    content = {
        "format": FLOW_FORMAT,
        "cameras": [camera.name for camera in rig.cameras],
        "reference": rig.cameras[rig.reference].name,
        **heading,
        "motions": [_motion(f, rig, names) for f, names in zip(figures, files, strict=True)],
    }
    path.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _motion(f: MotionFigures, rig: Rig, files: Mapping[str, str]) -> dict[str, Any]:
    """One entry of `motions`."""
    noise = {camera.name: _known(level) for camera, level in zip(rig.cameras, f.noise, strict=True)}
    return {
        "name": f.name,
        "probing": f.probing,
        "last": f.last,
        "failure": f.failure,
        "points": f.points,
        "valid": f.valid,
        "rejected": dict(f.rejected),
        "vertices": {"seen": f.vertices, "measured": f.measured},
        "median_displacement": _known(f.displacement),
        "median_sigma": {"lateral": _known(f.lateral), "depth": _known(f.depth)},
        "median_vertex_sigma": {
            "lateral": _known(f.vertex_lateral),
            "depth": _known(f.vertex_depth),
        },
        "median_reprojection": _known(f.reprojection),
        "through_last": f.through_last,
        "drift": _known(f.drift),
        "noise": noise,
        "files": dict(files),
    }


def _causes(f: MotionFigures) -> str:
    """Causes and counts, the most frequent first."""
    found = [(count, cause) for cause, count in f.rejected.items() if count]
    found.sort(key=lambda item: -item[0])
    # Without a space, lest a line be broken between a cause and its count.
    return " ".join(f"{_SHORT.get(cause, cause)}:{count}" for count, cause in found) or "none"


def _median(values: Float[np.ndarray, " k"]) -> float:
    """Median of what is known; NaN of nothing."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}g}" if math.isfinite(value) else "-"
