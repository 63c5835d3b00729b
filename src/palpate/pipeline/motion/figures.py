"""Summary figures of measured motions, and flow.json."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.arrays import known_median
from palpate.pipeline.motion.measure_motion import MeasuredMotion
from palpate.records import Camera, Rig, json_text, write_text
from palpate.shapes import Flags
from palpate.vision import CAUSES, camera_sigma, cause_counts, is_valid, measured_vertices

FLOW_FORMAT = "palpate-flow/1"


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionFigures:
    """Summary figures of one measured motion, named as in flow.json.

    Attributes
    ----------
    name : str
    probing : str or None           that it belongs to; None for a step of a sequence
    last : bool                     whether at full force; True for every step
    failure : str or None           why there is no motion, or no displacement of the vertices
    points, valid : int             of the range flow
    rejected : dict of str to int   points by cause, every cause in the order of `Outcome`
    vertices : dict of str to int   "seen" by the reference camera or measured, and "measured"
    median_displacement : float [m] median length over the valid points; NaN: none
    median_sigma : dict of str to float [m]     1 sigma of a valid point, "lateral" and in "depth",
                                    see `camera_sigma`; NaN: none
    median_vertex_sigma : dict of str to float [m]      the same of the measured vertices
    median_reprojection : float [px]    over the valid points; NaN: none
    through_last : int              valid points tracked through the preceding instant
    drift : float [m]               RMS difference of such motions from direct ones; NaN: unknown
    noise : dict of str to float [grey levels]  of each camera, in the rig's order
    """

    name: str
    probing: str | None
    last: bool
    failure: str | None
    points: int = 0
    valid: int = 0
    rejected: Mapping[str, int]
    vertices: Mapping[str, int]
    median_displacement: float = math.nan
    median_sigma: Mapping[str, float]
    median_vertex_sigma: Mapping[str, float]
    median_reprojection: float = math.nan
    through_last: int = 0
    drift: float = math.nan
    noise: Mapping[str, float]


def motion_figures(motion: MeasuredMotion, rig: Rig, seen: Flags) -> MotionFigures:
    """Counts and medians of one motion.

    Parameters
    ----------
    motion : MeasuredMotion
    rig : Rig                       with which it was measured
    seen : (v,) bool                vertices that the reference camera sees

    Returns
    -------
    MotionFigures                   with zeros and NaN where there is no flow
    """
    flow, camera = motion.flow, rig.cameras[rig.reference]
    cameras = [camera.name for camera in rig.cameras]
    none = np.zeros((0, 3, 3))
    if flow is None:
        return MotionFigures(
            name=motion.name,
            probing=motion.probing,
            last=motion.last,
            failure=motion.failure or "nothing was measured",
            rejected={cause.name.lower(): 0 for cause in CAUSES},
            vertices={"seen": 0, "measured": 0},
            median_sigma=_median_sigma(none, camera),
            median_vertex_sigma=_median_sigma(none, camera),
            noise=dict.fromkeys(cameras, math.nan),
        )
    valid = is_valid(flow)
    measured, covariance = np.zeros_like(seen), none
    if motion.vertices is not None:
        measured = measured_vertices(motion.vertices)
        covariance = motion.vertices.covariance[measured]
    return MotionFigures(
        name=motion.name,
        probing=motion.probing,
        last=motion.last,
        failure=motion.failure,
        points=len(valid),
        valid=int(valid.sum()),
        rejected=cause_counts(flow),
        vertices={"seen": int((seen | measured).sum()), "measured": int(measured.sum())},
        median_displacement=known_median(np.linalg.norm(flow.displacement[valid], axis=1)),
        median_sigma=_median_sigma(flow.covariance[valid], camera),
        median_vertex_sigma=_median_sigma(covariance, camera),
        median_reprojection=known_median(flow.reprojection[valid]),
        through_last=int(flow.through_last[valid].sum()),
        drift=float(flow.drift),
        noise=dict(zip(cameras, flow.noise.tolist(), strict=True)),
    )


def write_flow_document(
    path: Path,
    figures: Sequence[MotionFigures],
    files: Sequence[Mapping[str, str]],
    rig: Rig,
    heading: Mapping[str, Any],
) -> None:
    """Write flow.json: all figures in SI units; unknown ones (NaN) become null.

    Parameters
    ----------
    path : Path
    figures : sequence of k MotionFigures
    files : sequence of k mappings  files written for each: kind to file name
    rig : Rig
    heading : mapping               further keys of the document, with values valid in JSON

    Raises
    ------
    RecordError                     the file cannot be written; it is then unchanged
    """
    content = {
        "format": FLOW_FORMAT,
        "cameras": [camera.name for camera in rig.cameras],
        "reference": rig.cameras[rig.reference].name,
        **heading,
        "motions": [
            {**asdict(motion), "files": names} for motion, names in zip(figures, files, strict=True)
        ],
    }
    write_text(path, json_text(content))


def _median_sigma(covariance: Float[np.ndarray, "k 3 3"], camera: Camera) -> dict[str, float]:
    """Median standard deviations perpendicular to a camera's axis and along it [m]."""
    lateral, depth = camera_sigma(covariance, camera)
    return {"lateral": known_median(lateral), "depth": known_median(depth)}
