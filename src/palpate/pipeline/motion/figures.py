"""Measured motions in figures: their summary for flow.json, and the vertices that were lost."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from palpate.arrays import known_median
from palpate.geometry import unit_normals
from palpate.pipeline.motion.measure_motion import MeasuredMotion
from palpate.records import (
    Camera,
    Probing,
    Rig,
    Session,
    camera_centre,
    json_text,
    observed_rows,
    read_rig,
    write_text,
)
from palpate.shapes import Flags, Points
from palpate.vision import CAUSES, camera_sigma, cause_counts, is_valid, measured_vertices

FLOW_FORMAT = "palpate-flow/1"
# Distance within which the tool and its shadow hide the surface, in contact radii. On the virtual
# bench half of the vertices within it are lost.
TOOL_RADII = 6.0
# Cosine between the surface normal and the line of sight: beyond 60 degrees a window is twice as
# long on the surface as in the picture. On the bench nearly all vertices lost elsewhere are so
# inclined to all cameras but one.
OBLIQUE = 0.5
# Fraction of the vertices in full view that may be lost before the pictures are to blame; 0 to 3 %
# on the bench.
_USUAL = 0.1


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


@dataclass(frozen=True, slots=True)
class Rejections:
    """Counts of one probing's observed vertices, and of the lost ones by location.

    Attributes
    ----------
    name : str                      of the probing
    seen : int                      vertices that were observed, measured or not
    near_tool : int                 lost within six contact radii of the contact
    oblique : int                   lost elsewhere, where fewer than two cameras look at the surface
                                    within 60 degrees of its normal
    in_view : int                   lost in full view
    """

    name: str
    seen: int
    near_tool: int
    oblique: int
    in_view: int

    @property
    def lost(self) -> int:
        """Number of all vertices that were not measured."""
        return self.near_tool + self.oblique + self.in_view


def rejections(session: Session) -> tuple[Rejections, ...]:
    """Count the vertices that could not be tracked in the pictures, by location.

    Parameters
    ----------
    session : Session               with displacements from its pictures

    Returns
    -------
    tuple of Rejections             one for every probing with pictures; none without a rig

    Raises
    ------
    RecordError, CalibrationError   the rig cannot be read, or contradicts itself
    """
    if session.rig is None:
        return ()
    rig, normals = read_rig(session.rig), unit_normals(session.mesh)
    return tuple(
        _rejections(probing, rig, normals[probing.displacement.surface.triangle])
        for probing in session.probings
        if probing.images and probing.displacement is not None
    )


def rejection_note(counts: Sequence[Rejections]) -> str:
    """Note on the number and location of lost vertices, and whether that is usual.

    Parameters
    ----------
    counts : sequence of Rejections     at least one

    Returns
    -------
    str
    """
    seen, lost = (sum(getattr(count, name) for count in counts) for name in ("seen", "lost"))
    tool, oblique, view = (
        sum(getattr(count, name) for count in counts)
        for name in ("near_tool", "oblique", "in_view")
    )
    text = (
        f"{lost} of {seen} vertices that a camera saw were not measured"
        f" ({100 * lost / max(seen, 1):.0f} %): {tool} within {TOOL_RADII:g} contact radii of the"
        f" tool, which covers them, {oblique} where fewer than two cameras look at the surface"
        f" within 60 degrees of its normal, and {view} in full view."
    )
    if view <= _USUAL * max(seen - tool - oblique, 1):
        return text + " That is as usual: what cannot be followed is left out, not guessed."
    return text + (
        " So many in full view are unusual: `palpate flow` draws which and says why; most often"
        " the speckle is too coarse, too fine or too faint, or a picture is out of focus."
    )


def _median_sigma(covariance: Float[np.ndarray, "k 3 3"], camera: Camera) -> dict[str, float]:
    """Median standard deviations perpendicular to a camera's axis and along it [m]."""
    lateral, depth = camera_sigma(covariance, camera)
    return {"lateral": known_median(lateral), "depth": known_median(depth)}


def _rejections(probing: Probing, rig: Rig, normals: Points) -> Rejections:
    field = probing.displacement
    if field is None:
        return Rejections(probing.name, 0, 0, 0, 0)
    lost = ~observed_rows(field)
    # A contact without a radius hides nothing.
    reach = TOOL_RADII * (probing.contact.radius or 0.0)
    near = np.linalg.norm(field.points - probing.contact.point, axis=1) < reach
    inclined = ~near & ~_faced(field.points, normals, rig)
    counts = [int((lost & where).sum()) for where in (near, inclined, ~near & ~inclined)]
    return Rejections(probing.name, len(lost), *counts)


def _faced(points: Points, normals: Points, rig: Rig) -> Flags:
    """Whether at least two cameras see each point within 60 degrees of its normal."""
    cosines: list[Float[np.ndarray, " n"]] = []
    for camera in rig.cameras:
        sight = camera_centre(camera) - points
        sight = sight / np.linalg.norm(sight, axis=1, keepdims=True)
        cosines.append(np.einsum("nk,nk->n", normals, sight))
    return (np.array(cosines) > OBLIQUE).sum(axis=0) >= 2
