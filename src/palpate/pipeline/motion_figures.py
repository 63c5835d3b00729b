"""What can be said about measured motions in numbers, and flow.json."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.pipeline.measure_motion import MeasuredMotion
from palpate.records import Rig, json_text
from palpate.shapes import Flags
from palpate.vision import (
    CAUSES,
    camera_sigma,
    cause_counts,
    is_valid,
    measured_vertices,
)

FLOW_FORMAT = "palpate-flow/1"


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
    drift : float [m]               rms difference of such motions from direct ones; NaN: unknown
    noise : tuple of c float [grey levels]      of each camera, in the rig's order
    """

    name: str
    probing: str | None
    last: bool
    failure: str | None
    noise: tuple[float, ...]
    rejected: Mapping[str, int]
    points: int = 0
    valid: int = 0
    vertices: int = 0
    measured: int = 0
    lateral: float = math.nan
    depth: float = math.nan
    vertex_lateral: float = math.nan
    vertex_depth: float = math.nan
    displacement: float = math.nan
    reprojection: float = math.nan
    through_last: int = 0
    drift: float = math.nan


def motion_figures(motion: MeasuredMotion, rig: Rig, seen: Flags) -> MotionFigures:
    """Counts and medians of one motion.

    Parameters
    ----------
    motion : MeasuredMotion
    rig : Rig                       that it was measured with
    seen : (v,) bool                vertices that the reference camera sees
    """
    flow, camera = motion.flow, rig.cameras[rig.reference]
    if flow is None:
        return MotionFigures(
            name=motion.name,
            probing=motion.probing,
            last=motion.last,
            failure=motion.failure or "nothing was measured",
            noise=(math.nan,) * len(rig.cameras),
            rejected={cause.name.lower(): 0 for cause in CAUSES},
        )
    valid = is_valid(flow)
    lateral, depth = camera_sigma(flow.covariance[valid], camera)
    known = np.zeros_like(seen)
    vertex_lateral = vertex_depth = np.zeros(0)
    if motion.vertices is not None:
        known = measured_vertices(motion.vertices)
        vertex_lateral, vertex_depth = camera_sigma(motion.vertices.covariance[known], camera)
    return MotionFigures(
        name=motion.name,
        probing=motion.probing,
        last=motion.last,
        failure=motion.failure,
        noise=tuple(float(level) for level in flow.noise),
        rejected=cause_counts(flow),
        points=len(valid),
        valid=int(valid.sum()),
        vertices=int((seen | known).sum()),
        measured=int(known.sum()),
        lateral=_median(lateral),
        depth=_median(depth),
        vertex_lateral=_median(vertex_lateral),
        vertex_depth=_median(vertex_depth),
        displacement=_median(np.linalg.norm(flow.displacement[valid], axis=1)),
        reprojection=_median(flow.reprojection[valid]),
        through_last=int(flow.through_last[valid].sum()),
        drift=float(flow.drift),
    )


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
    path.write_text(json_text(content), encoding="utf-8")


def _motion(f: MotionFigures, rig: Rig, files: Mapping[str, str]) -> dict[str, Any]:
    """One entry of `motions`."""
    names = [camera.name for camera in rig.cameras]
    return {
        "name": f.name,
        "probing": f.probing,
        "last": f.last,
        "failure": f.failure,
        "points": f.points,
        "valid": f.valid,
        "rejected": f.rejected,
        "vertices": {"seen": f.vertices, "measured": f.measured},
        "median_displacement": f.displacement,
        "median_sigma": {"lateral": f.lateral, "depth": f.depth},
        "median_vertex_sigma": {"lateral": f.vertex_lateral, "depth": f.vertex_depth},
        "median_reprojection": f.reprojection,
        "through_last": f.through_last,
        "drift": f.drift,
        "noise": dict(zip(names, f.noise, strict=True)),
        "files": files,
    }


def _median(values: Float[np.ndarray, " k"]) -> float:
    """Median of what is known; NaN of nothing."""
    known = values[np.isfinite(values)]
    return float(np.median(known)) if len(known) else math.nan
