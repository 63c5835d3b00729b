"""2-D pictures of the viewer: the likelihood with a cross, camera pictures with arrows."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.figure import Figure
from PIL import Image, ImageDraw

from palpate.errors import PalpateError
from palpate.estimation import LikelihoodMap
from palpate.figures import (
    INK,
    MIDDLE_BLUE,
    ORANGE,
    PALE_BLUE,
    figure_pixels,
    refined_likelihood,
    styled,
)
from palpate.pipeline import FittedProbing
from palpate.records import Camera, Rig, Session, camera_centre, modulus_unit
from palpate.vision import project, read_grey

# Largest side of a picture in the page [px].
_LARGEST = 640
_REGIONS = (0.5, 0.95)
# Number of arrows across a picture.
_ARROWS = 26

RGB = UInt8[np.ndarray, "_ _ 3"]


class LikelihoodPlot:
    """Plot of the likelihood regions, drawn once; a cross is drawn on copies of it.

    Parameters
    ----------
    likelihood : LikelihoodMap
    """

    def __init__(self, likelihood: LikelihoodMap) -> None:
        factor, self._unit = modulus_unit(float(np.median(likelihood.shear_modulus)))
        self._factor = factor
        self._plain, self._to_pixel = _likelihood_pixels(likelihood, factor, self._unit)

    def marked(self, poisson_ratio: float, shear_modulus: float) -> RGB:
        """The plot with a cross at a pair of constants.

        Parameters
        ----------
        poisson_ratio : float [-]
        shear_modulus : float [Pa]

        Returns
        -------
        (rows, columns, 3) uint8
        """
        picture = Image.fromarray(self._plain)
        column, row = self._to_pixel(poisson_ratio, shear_modulus / self._factor)
        draw = ImageDraw.Draw(picture)
        for dx, dy in ((9, 0), (0, 9)):
            draw.line((column - dx, row - dy, column + dx, row + dy), fill=ORANGE, width=3)
        return np.asarray(picture)


@styled
def _likelihood_pixels(
    likelihood: LikelihoodMap, factor: float, unit: str
) -> tuple[RGB, Callable[[float, float], tuple[float, float]]]:
    """The plot's pixels, and a function from a pair of constants to its pixel."""
    figure = Figure(figsize=(3.4, 2.7), layout="constrained")
    axes = figure.subplots()
    nu, modulus, deviance = refined_likelihood(likelihood)
    modulus = modulus / factor
    levels = [min(0.0, float(deviance.min())) - 1e-9, *map(likelihood.height, _REGIONS)]
    axes.contourf(nu, modulus, deviance, levels=levels, colors=[MIDDLE_BLUE, PALE_BLUE])
    axes.contour(nu, modulus, deviance, levels=levels[1:], colors=INK, linewidths=0.6)
    whole = likelihood.shear_modulus / factor
    axes.set(xlim=likelihood.poisson_ratio[[0, -1]], ylim=whole[[0, -1]])
    axes.set(xlabel="Poisson's ratio", ylabel=f"shear modulus, {unit}")
    axes.set_title("50 and 95 % regions; cross: the sliders", fontsize=8)
    pixels = figure_pixels(figure)[..., :3]
    transform, rows = axes.transData, len(pixels)

    def to_pixel(nu: float, value: float) -> tuple[float, float]:
        x, y = transform.transform((nu, value))
        return float(x), float(rows - y)

    return pixels, to_pixel


def frames(session: Session, probing: str) -> list[str]:
    """File patterns of a probing's pictures in order of time, at rest first.

    Parameters
    ----------
    session : Session
    probing : str                   name of the probing

    Returns
    -------
    list of str                     empty if it has no pictures
    """
    images = next(candidate for candidate in session.probings if candidate.name == probing).images
    return [] if images is None else [images.rest, *images.loaded]


def camera_picture(
    session: Session,
    rig: Rig,
    camera: int,
    pattern: str,
    *,
    flow: FittedProbing | None = None,
    magnification: float = 1.0,
) -> RGB | None:
    """A camera's picture, reduced for a page, with arrows of the measured displacement.

    Parameters
    ----------
    session : Session
    rig : Rig
    camera : int                    index in the rig
    pattern : str                   file pattern
    flow : FittedProbing or None    probing whose displacement is drawn; None: no arrows
    magnification : float           of the arrows

    Returns
    -------
    (rows, columns, 3) uint8 or None    None if the picture cannot be read
    """
    try:
        name = pattern.replace("{camera}", rig.cameras[camera].name)
        grey = np.clip(read_grey(session.path.parent / name), 0, 255).astype(np.uint8)
    except PalpateError:
        return None
    shrink = min(1.0, _LARGEST / max(grey.shape))
    size = (round(grey.shape[1] * shrink), round(grey.shape[0] * shrink))
    picture = Image.fromarray(grey).resize(size).convert("RGB")
    if flow is not None:
        _draw_flow(picture, rig.cameras[camera], flow, session, shrink, magnification)
    return np.asarray(picture)


def _draw_flow(
    picture: Image.Image,
    camera: Camera,
    flow: FittedProbing,
    session: Session,
    shrink: float,
    magnification: float,
) -> None:
    """Draw arrows from the points at rest along their displacements."""
    known = np.isfinite(flow.displacement).all(axis=1) & _facing(camera, flow, session)
    points, displacement = flow.points[known], flow.displacement[known]
    start = project(camera, points) * shrink
    arrows = (project(camera, points + displacement) * shrink - start) * magnification
    draw = ImageDraw.Draw(picture)
    for row in _thinned(start, max(picture.size) / _ARROWS):
        _arrow(draw, start[row], arrows[row])


def _facing(camera: Camera, flow: FittedProbing, session: Session) -> np.ndarray:
    """Whether each point is on the camera's side of the object."""
    mesh = session.mesh
    middle = 0.5 * (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0))
    return np.asarray((flow.points - middle) @ (camera_centre(camera) - middle) > 0.0)


def _thinned(positions: Float[np.ndarray, "n 2"], pitch: float) -> np.ndarray:
    """Indices of a subset with one point in each square cell."""
    known = np.flatnonzero(np.isfinite(positions).all(axis=1))
    _, first = np.unique(np.floor(positions[known] / pitch), axis=0, return_index=True)
    return known[first]


def _arrow(draw: ImageDraw.ImageDraw, start: np.ndarray, vector: np.ndarray) -> None:
    """Draw an arrow, bright with a dark outline."""
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length) or length < 1.0:
        return
    end, along = start + vector, vector / length
    across = np.array([-along[1], along[0]])
    head = [end - 5 * along + 3 * across, end, end - 5 * along - 3 * across]
    for colour, width in (("black", 3), (ORANGE, 1)):
        draw.line([*start, *end], fill=colour, width=width)
        draw.line([tuple(map(float, corner)) for corner in head], fill=colour, width=width)
